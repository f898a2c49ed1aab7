"""Plot of a switching study: share of connected formations over time, and distribution of the smallest lambda_min."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from companion.report.plotting import COLOURS, DPI, MARKERS, STYLES, dress, put_legend_below, titled_figure
from sitl.switching.topology import Topology

MARKED = 0.12  # distance of markers, as a share of the diagonal; the laws stay distinct in greyscale


def save_switching(path: Path, topologies: Sequence[Topology], duration_s: float, title: str) -> None:
    """Left: share of starts in which all vehicles were connected so far. Right: distribution of the smallest lambda_min."""
    figure = titled_figure(11.0, 5.2, title)
    left, right = figure.subplots(1, 2)
    laws = list(dict.fromkeys(t.law for t in topologies))
    hystereses_m = sorted({t.hysteresis_m for t in topologies})
    for colour, marker, law in zip(COLOURS, MARKERS, laws, strict=False):
        for style, hysteresis_m in zip(STYLES, hystereses_m, strict=False):
            group = [t for t in topologies if t.law == law and t.hysteresis_m == hysteresis_m]
            label = f"{law}, {hysteresis_m:g} m"
            look = {"color": colour, "linestyle": style, "marker": marker, "markevery": MARKED, "label": label}
            _draw_connected(left, group, duration_s, look)
            _draw_spread(right, group, look)
    dress(left, "time since the start of the formation [s]", "connected so far [% of the starts]")
    dress(right, "smallest lambda_min of the flight while connected [-]", "starts below this value [%]")
    for axes in (left, right):
        axes.set_ylim(0, 102)
    put_legend_below(figure, left, len(laws), "law, hysteresis")
    figure.savefig(path, dpi=DPI)


def _draw_connected(axes: Axes, group: Sequence[Topology], duration_s: float, look: dict[str, object]) -> None:
    cuts_s = np.sort([t.cut_off_s for t in group if t.cut_off_s is not None])
    left = 100.0 * (1.0 - np.arange(len(cuts_s) + 1) / len(group))
    times_s = np.concatenate(([0.0], cuts_s, [duration_s]))
    axes.plot(times_s, np.concatenate((left, left[-1:])), drawstyle="steps-post", **look)  # type: ignore[arg-type]


def _draw_spread(axes: Axes, group: Sequence[Topology], look: dict[str, object]) -> None:
    values = np.sort([t.lambda_min or 0.0 for t in group])
    axes.plot(values, 100.0 * (np.arange(len(values)) + 1) / len(values), **look)  # type: ignore[arg-type]
