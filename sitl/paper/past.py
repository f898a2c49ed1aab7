"""The report's last chapter: what lies past the paper, from the study."""

from __future__ import annotations

from msgspec import Struct

from sitl.study.command import SHOWN, PastThePaper
from sitl.study.settings import SETTINGS, in_short
from sitl.study.table import cells_of


class PastRow(Struct, frozen=True, kw_only=True):
    """One setting: its label and numbers, and for each of `SHOWN` the time to settle and the distances, as text."""

    label: str
    numbers: str
    cells: tuple[str, ...]


def past_rows(found: PastThePaper) -> list[PastRow]:
    """One for each setting of the law, in the study's order."""
    return [
        PastRow(label=setting.label, numbers=in_short(setting), cells=cells_of(found.study.quiet, setting, SHOWN))
        for setting in SETTINGS
    ]
