"""The comparison of the settings of `cooperative` as a figure: settling against the smallest distance, one point each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes

from companion.config.law import feedback_law_of
from companion.report.plotting import COLOURS, DPI, GUIDE, MARKERS, dress, dress_logarithmic, titled_figure
from sitl.study.selection import CANDIDATES, LOST_ROOM_M, Score

STRIP = 1.5  # width of the strip for settings that did not settle, as a factor


def save_selection(path: Path, found: Sequence[Score], chosen: Score | None) -> None:
    """x: the longest settling time over that of a leader alone; y: the most by which it comes nearer than eq. 22."""
    figure = titled_figure(9.0, 6.2, "Settings of cooperative: the worst of all shapes and conditions")
    axes = figure.subplots()
    never = STRIP * STRIP * max((score.settling for score in found if score.settling is not None), default=1.0)
    _draw_points(axes, found, never)
    if chosen is not None and chosen.settling is not None:
        axes.plot(
            chosen.settling,
            _nearer_m(chosen),
            label=f"chosen: {chosen.setting}",
            linestyle="none",
            marker="o",
            markersize=18,
            markerfacecolor="none",
            markeredgecolor="black",
        )
    axes.axhline(LOST_ROOM_M, **GUIDE)
    axes.text(
        0.99, LOST_ROOM_M, "most allowed", transform=axes.get_yaxis_transform(), va="bottom", ha="right", fontsize=9
    )
    _dress(axes, never)
    axes.legend(fontsize=9, frameon=False)
    figure.savefig(path, dpi=DPI)


def _nearer_m(score: Score) -> float:
    """At least a centimetre, for the logarithmic axis."""
    return max(0.01, -score.room_m)


def _draw_points(axes: Axes, found: Sequence[Score], never: float) -> None:
    """One marker per ratio; the feed-forward stands beside the points of the first ratio and of the power."""
    laws = [feedback_law_of(candidate.law) for candidate in CANDIDATES]
    ratios = list(dict.fromkeys(law.weight_ratio for law in laws))
    for index, ratio in enumerate(ratios):
        rows = [(score, law) for score, law in zip(found, laws, strict=True) if law.weight_ratio == ratio]
        x = [never if score.settling is None else score.settling for score, _ in rows]
        axes.plot(
            x,
            [_nearer_m(score) for score, _ in rows],
            linestyle="none",
            marker=MARKERS[index],
            markersize=8,
            markerfacecolor=COLOURS[index],
            markeredgecolor="black",
            markeredgewidth=0.6,
            label=f"rho {ratio:g}" if ratio < 1.0 else f"alpha {rows[0][1].exponent:g}",
        )
        if index == 0 or ratio == 1.0:
            for place, (score, law) in zip(x, rows, strict=True):
                axes.annotate(
                    f"g {law.feedforward:g}", (place, _nearer_m(score)), (6, 6), textcoords="offset points", fontsize=8
                )


def _dress(axes: Axes, never: float) -> None:
    dress_logarithmic(axes)
    axes.axvspan(never / STRIP, never * STRIP, color="#eeeeee", zorder=0)
    axes.set_xlim(right=never * STRIP)
    above = axes.get_xaxis_transform()
    axes.text(never, 0.03, "did not settle\nin every flight", transform=above, ha="center", fontsize=9)
    axes.yaxis.set_major_formatter("{x:g}")
    x_label = "longest settling time to 10 cm, in settling times of a leader alone [-]"
    dress(axes, x_label, "nearer than under eq. 22, at most in any flight [m]")
