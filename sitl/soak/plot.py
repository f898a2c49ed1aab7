"""Curves of a soak over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from sitl.soak.samples import Sample

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
