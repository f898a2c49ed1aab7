"""The last section of the report: results of the study beyond the paper."""

from __future__ import annotations

from msgspec import Struct

from sitl.study.command import SHOWN, StudyReport
from sitl.study.settings import COOPERATIVE, SETTINGS, WEIGHTED, parameters_text
from sitl.study.table import cells_of

CHAINS = ("chain-4", "chain-16")
SHARPER_ALONE = next(setting for setting in SETTINGS if setting.label.startswith("a: "))


class SettingRow(Struct, frozen=True, kw_only=True):
    """One setting: label, parameters, and for each shape of `SHOWN` the settle time and the distances, as text."""

    label: str
    numbers: str
    cells: tuple[str, ...]


def growth_text(report: StudyReport) -> str:
    """How errors develop along a chain, under the paper's law and under the laws with sharper weights."""
    # Reversed: of two flights of the same case the first counts, as these have the same duration.
    worst_m = {(f.shape, f.setting): max(f.stretch_m, f.squeeze_m) for f in reversed(report.study.quiet)}
    few_m, many_m = (worst_m[shape, WEIGHTED.label] for shape in CHAINS)
    sharper_m, ours_m = (worst_m[CHAINS[1], setting.label] for setting in (SHARPER_ALONE, COOPERATIVE))
    few, many = (shape.removeprefix("chain-") for shape in CHAINS)
    return (
        f"Under the paper's law the largest deviation of a neighbour distance is {few_m:.2f} m in the chain of {few} and "
        f"{many_m:.2f} m in the chain of {many}: the errors {'grow' if many_m > few_m else 'do not grow'} along it. In the "
        f"chain of {many} it is {sharper_m:.2f} m with sharper weights alone (a) and {ours_m:.2f} m with cooperative."
    )


def setting_rows(report: StudyReport) -> list[SettingRow]:
    """One row per setting of the law, in the order of the study."""
    return [
        SettingRow(
            label=setting.label, numbers=parameters_text(setting), cells=cells_of(report.study.quiet, setting, SHOWN)
        )
        for setting in SETTINGS
    ]
