"""The words of the report (`words.toml`), and how numbers are put into them: claims, errata, headings of figures."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from math import inf
from pathlib import Path

import msgspec
from msgspec import Struct

from sitl.report.claim import Claim, ClaimVerdict, Erratum

WORDS_FILE = Path(__file__).with_name("words.toml")


class ClaimWords(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Of one claim; the head of the file explains the fields."""

    where: str
    claim: str
    paper: str
    ideal: str
    full: str = "-"
    remark: str = ""


class ErratumWords(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Of one erratum; only `shown` has numbers."""

    printed: str
    right: str
    shown: str = ""


class FigureWords(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Of one figure. The claims of these ids are shown below it."""

    heading: str
    shows: str
    claims: tuple[str, ...]


class Words(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The whole file: claims by id, errata by place, figures by file."""

    claims: dict[str, ClaimWords]
    errata: dict[str, ErratumWords]
    figures: dict[str, FigureWords]


@cache
def words() -> Words:
    """The file. Raises msgspec.ValidationError where it is wrong."""
    return msgspec.toml.decode(WORDS_FILE.read_bytes(), type=Words)


def claim_of(id_: str, verdict: ClaimVerdict, measured: dict[str, float], **values: object) -> Claim:
    """A claim in its words, with these values and those measured in them. Raises KeyError for an unknown id or value."""
    own, values = words().claims[id_], measured | values
    texts = {name: getattr(own, name).format(**values) for name in own.__struct_fields__}
    return Claim(id=id_, verdict=verdict, measured={name: float(value) for name, value in measured.items()}, **texts)


def erratum_of(place: str, **values: object) -> Erratum:
    """An erratum in its words, with these values in them. Raises KeyError."""
    own = words().errata[place]
    return Erratum(place=place, printed=own.printed, right=own.right, shown=own.shown.format(**values))


def verdict_of(to_the_letter: bool, with_a_condition: bool = False) -> ClaimVerdict:
    """HOLDS where the claim holds to the letter, else CONDITION or FAILS by `with_a_condition`."""
    if to_the_letter:
        return ClaimVerdict.HOLDS
    return ClaimVerdict.CONDITION if with_a_condition else ClaimVerdict.FAILS


def seconds(value_s: float, digits: int = 1) -> str:
    return "never" if value_s == inf else f"{value_s:.{digits}f} s"


def metres(values_m: Iterable[float], digits: int = 2) -> str:
    """ "1.75, 1.78 and 1.66 m"."""
    return join_words(f"{value_m:.{digits}f}" for value_m in values_m) + " m"


def join_words(parts: Iterable[str]) -> str:
    """ "a, b and c"; empty for nothing."""
    *most, last = list(parts) or [""]
    return f"{', '.join(most)} and {last}" if most else last
