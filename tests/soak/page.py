"""docs/soak.md: the verdict, the samples and the plot of a soak. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from tests.bench.machine import Machine
from tests.bench.page import wrapped
from tests.soak.samples import (
    COLUMNS,
    LEAST_MEAN_RATE_HZ,
    LEAST_RATE_HZ,
    MOST_GROWTH_MB,
    MOST_GROWTH_MB_H,
    MOST_LATER,
    MOST_SLOW,
    WARM_UP,
    Finding,
    Sample,
    cells,
    shown,
)

INTRODUCTION = """\
`make soak` flies eight vehicles as real processes for an hour: agents with their recordings, stand-in autopilots, \
Zenoh and MAVLink over loopback. They fly a figure 8 in two columns, with neighbours by range. It writes this page, \
`runs/soak/soak.csv` and the plot."""
WHAT_COUNTS = f"""\
Each figure is the worst of all eight agents. The first {WARM_UP:.0%} of the time do not count: caches fill, and the \
formation settles. Memory is constant where its trend is at most {MOST_GROWTH_MB_H:g} MB in an hour, or \
{MOST_GROWTH_MB:g} MB in the run; files and threads where the last tenth comes down to what the first half had; the tick \
rate where both halves have a mean of at least {LEAST_MEAN_RATE_HZ:g} Hz and at most {MOST_SLOW:.0%} of the samples are \
below {LEAST_RATE_HZ:g} Hz; telemetry to command where the 99 % of the second half are at most {MOST_LATER:g} times those \
of the first. `missed` is the sum of all agents since the row before."""


def page(machine: Machine, samples: Sequence[Sample], verdict: Sequence[Finding], failures: Sequence[str]) -> str:
    """The whole page. `failures` are those of the flight."""
    parts = ["# Soak", wrapped(INTRODUCTION), wrapped(machine.in_words()), wrapped(WHAT_COUNTS)]
    parts.append(_table(("figure", "verdict", "measured"), [_verdict(finding) for finding in verdict]))
    parts += [f"The flight failed: {failure}." for failure in failures]
    parts.append(_table(COLUMNS, [cells(sample) for sample in shown(samples)]))
    parts.append("![Memory, files, threads, tick rate and telemetry to command over the hour](images/soak.png)")
    return "\n\n".join(parts) + "\n"


def _verdict(finding: Finding) -> tuple[str, str, str]:
    return finding.name, "constant" if finding.constant else "**changes**", finding.text


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


PANELS = (
    ("memory_mb", "memory [MB]"),
    ("files", "open files"),
    ("threads", "threads"),
    ("rate_hz", "ticks [Hz]"),
    ("command_p99_us", "telemetry to\ncommand, p99 [us]"),
)


def save_plot(path: Path, samples: Sequence[Sample]) -> None:
    """One panel for each figure, the worst of all agents."""
    figure = Figure(figsize=(8.0, 9.0), layout="constrained")
    axes = figure.subplots(len(PANELS), 1, sharex=True)
    minutes = [sample.time_s / 60.0 for sample in samples]
    for axis, (name, label) in zip(axes, PANELS, strict=True):
        axis.plot(minutes, [getattr(sample, name) for sample in samples], color="#0072B2")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("time [min]")
    figure.suptitle("worst of all agents")
    figure.savefig(path, dpi=110)
