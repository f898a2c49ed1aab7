"""docs/performance.md and the terminal's lines, from the measured rows. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import floor, inf, log10
from pathlib import Path
from textwrap import fill

from tests.bench.figures import Row, Section, Target
from tests.bench.machine import Machine

WIDTH = 100
HEAD = "| figure | measured | beside it | ratio | target | met |\n|---|---|---|---|---|---|"
INTRODUCTION = """\
`make bench` measures everything on this page in one run and writes it. A figure is the median of at least five \
repeats; the smallest and the largest repeat follow in brackets. The ratio is that of the figure to the one beside it, \
or to the limit where nothing stands beside it. All repeats are in `runs/bench/bench.json`."""
OTHERS = "What processes outside the bench used stands below each table: they delay what is measured."


def page(machine: Machine, sections: Sequence[Section]) -> str:
    """The whole page."""
    parts = ["# Performance", wrapped(INTRODUCTION), wrapped(f"{machine.in_words()} {OTHERS}")]
    for section in sections:
        parts += [f"## {section.title}", *map(wrapped, section.how.split("\n\n")), table(section.rows)]
        remarks = [_bullet(f"{row.what}: {row.remark}") for row in section.rows if row.remark]
        parts.append("\n".join([*remarks, _bullet(others_in_words(section))]))
    return "\n\n".join(parts) + "\n"


def table(rows: Iterable[Row]) -> str:
    """In Markdown."""
    return "\n".join([HEAD, *(_line(row) for row in rows)])


def others_in_words(section: Section) -> str:
    """The disturbance by other processes."""
    return f"meanwhile processes outside the bench used {section.others_cores:.2f} cores"


def row_in_words(row: Row) -> str:
    """One line for the terminal."""
    beside = f"   {row.beside}: {quantity(row.beside_values, row.unit)}" if row.beside else ""
    ratio = "" if row.ratio is None else f"   ratio {digits(row.ratio)}"
    target = "" if row.target is None else f"   target {target_in_words(row.target, row.unit)}: {_met(row)}"
    remark = f"   ({row.remark})" if row.remark else ""
    return f"{row.what}: {quantity(row.values, row.unit)}{beside}{ratio}{target}{remark}"


def quantity(values: Sequence[float], unit: str) -> str:
    """Median, smallest and largest with their unit."""
    if not values:
        return "not measured"
    row = Row(what="", unit=unit, values=tuple(values))
    assert row.value is not None  # there are values
    scatter = f" ({digits(min(values))} to {digits(max(values))})" if min(values) < max(values) else ""
    return f"{digits(row.value)} {unit}{scatter}"


def digits(value: float) -> str:
    """With three significant digits, without an exponent."""
    if value == 0.0:
        return "0"
    places = 2 - floor(log10(abs(value)))
    return f"{value:,.{max(0, places)}f}" if places >= 0 else f"{round(value, places):,.0f}"


def target_in_words(target: Target, unit: str) -> str:
    suffix = "times" if target.of == "ratio" else unit
    if target.least > -inf and target.most < inf:
        return f"{target.least:g} to {target.most:g} {suffix}"
    return f"at most {target.most:g} {suffix}" if target.most < inf else f"at least {target.least:g} {suffix}"


def _line(row: Row) -> str:
    beside = f"{row.beside}: {quantity(row.beside_values, row.unit)}" if row.beside else ""
    ratio = "" if row.ratio is None else digits(row.ratio)
    target = "" if row.target is None else target_in_words(row.target, row.unit)
    return f"| {row.what} | {quantity(row.values, row.unit)} | {beside} | {ratio} | {target} | {_met(row)} |"


def _met(row: Row) -> str:
    if row.target is None:
        return ""
    return {True: "yes", False: "no", None: "not measured"}[row.is_met]


def wrapped(text: str) -> str:
    return fill(" ".join(text.split()), WIDTH, break_long_words=False, break_on_hyphens=False)


def _bullet(text: str) -> str:
    words = " ".join(text.split())
    return fill(
        words, WIDTH, initial_indent="- ", subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )


def write_between_marks(page_file: Path, name: str, text: str) -> None:
    """Between the marks `measured: NAME` of a page. Raises ValueError where it has none."""
    begin, end = marks(name)
    before, mark, rest = page_file.read_text(encoding="utf-8").partition(begin)
    _, found, after = rest.partition(end)
    if not mark or not found:
        raise ValueError(f"{page_file}: expected the lines {begin} and {end}")
    page_file.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")


def marks(name: str) -> tuple[str, str]:
    """The lines before and after a measured table."""
    return f"<!-- measured: {name} -->", f"<!-- end of {name} -->"
