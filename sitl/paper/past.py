"""The report's last chapter: what lies past the paper, from the study."""

from __future__ import annotations

from msgspec import Struct

from sitl.study.command import SHOWN, PastThePaper
from sitl.study.settings import COOPERATIVE, SETTINGS, WEIGHTED, in_short
from sitl.study.table import cells_of

CHAINS = ("chain-4", "chain-16")
SHARPER_ALONE = next(setting for setting in SETTINGS if setting.label.startswith("a: "))


class PastRow(Struct, frozen=True, kw_only=True):
    """One setting: its label and numbers, and for each of `SHOWN` the time to settle and the distances, as text."""

    label: str
    numbers: str
    cells: tuple[str, ...]


def past_words(found: PastThePaper) -> str:
    """What the errors do along a chain, under the paper's law and under those that sharpen its weights."""
    worst_m = {
        (f.shape, f.setting): max(f.stretch_m, f.squeeze_m) for f in reversed(found.study.quiet)
    }  # of two of the same, the first: all are as long
    few_m, many_m = (worst_m[shape, WEIGHTED.label] for shape in CHAINS)
    sharper_m, ours_m = (worst_m[CHAINS[1], setting.label] for setting in (SHARPER_ALONE, COOPERATIVE))
    few, many = (shape.removeprefix("chain-") for shape in CHAINS)
    return (
        f"Under the paper's law the worst deviation of a neighbour's distance is {few_m:.2f} m in the chain of {few} and "
        f"{many_m:.2f} m in the chain of {many}: the errors {'grow' if many_m > few_m else 'do not grow'} along it. In the "
        f"chain of {many} it is {sharper_m:.2f} m with a sharper exponent alone (a) and {ours_m:.2f} m with cooperative."
    )


def past_rows(found: PastThePaper) -> list[PastRow]:
    """One for each setting of the law, in the study's order."""
    return [
        PastRow(label=setting.label, numbers=in_short(setting), cells=cells_of(found.study.quiet, setting, SHOWN))
        for setting in SETTINGS
    ]
