"""Figures of the study: settling against the worst inter-distance for every setting, and lambda_min against size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.axes import Axes

from companion.report.plotting import (
    COLOURS,
    DPI,
    GUIDE,
    MARKERS,
    curve_look,
    dress,
    dress_logarithmic,
    put_legend_below,
    titled_figure,
)
from sitl.study.cases import Figures
from sitl.study.settings import COOPERATIVE, SETTINGS, Setting
from sitl.study.shapes import SPACING_M

NEVER_LABEL = "not settled"


def save_trade_off(path: Path, flights: Sequence[Figures], shapes: Sequence[str]) -> None:
    """One panel per shape: x is the settle time, y the largest deviation of a neighbour distance from the desired one."""
    figure = titled_figure(13.0, 6.4, "Settle time and worst inter-distance, full quadrotor model, step of 1 m")
    panels = figure.subplots(1, len(shapes), squeeze=False)[0]
    for axes, shape in zip(panels, shapes, strict=True):
        _draw_trade_off(axes, [f for f in flights if f.shape == shape])
        axes.set_title(shape)
    panels[0].set_ylabel("largest deviation of a neighbour distance\nfrom the desired one [m]")
    put_legend_below(figure, panels[0], 4)
    figure.savefig(path, dpi=DPI)


def _draw_trade_off(axes: Axes, flights: Sequence[Figures]) -> None:
    flown = {f.setting: f for f in reversed(flights)}  # the first flight of each setting: these have the same duration
    duration_s = flights[0].duration_s
    never_s, right_s = duration_s * 1.6, duration_s * 2.56  # middle and right end of the strip, as wide as its label
    for setting in SETTINGS:
        if setting.label in flown:
            _draw_setting(axes, setting, flown[setting.label], never_s)
    dress_logarithmic(axes)
    axes.axhline(SPACING_M, **GUIDE)
    axes.text(
        0.02,
        SPACING_M,
        " one spacing: neighbours may collide",
        transform=axes.get_yaxis_transform(),
        va="bottom",
        fontsize=9,
    )
    axes.axvspan(duration_s, right_s, color="#eeeeee", zorder=0)
    axes.text(
        never_s,
        0.985,
        f"{NEVER_LABEL}\nin {duration_s:.0f} s",
        transform=axes.get_xaxis_transform(),
        ha="center",
        va="top",
        fontsize=9,
    )
    axes.set_xlim(right=right_s)
    bottom, top = axes.get_ylim()
    axes.set_ylim(top=top * (top / bottom) ** 0.12)  # room above every marker for the label of the grey strip
    dress(axes, "settled to 10 cm after [s]")


def _draw_setting(axes: Axes, setting: Setting, flown: Figures, never_s: float) -> None:
    colour, marker = _look(setting)
    chosen = setting is COOPERATIVE
    axes.plot(
        flown.settle_s if flown.settle_s is not None else never_s,
        max(flown.stretch_m, flown.squeeze_m),
        linestyle="none",
        marker="*" if chosen else marker,
        markersize=17 if chosen else 8,
        markerfacecolor=colour,
        markeredgecolor="black",
        markeredgewidth=0.7,
        label=setting.label,
        zorder=2.5 if chosen else 3,  # the largest marker below the others, so that it hides none
    )


def _look(setting: Setting) -> tuple[str, str]:
    """Fill colour and marker. The fill shows the family: paper's laws, single parts of cooperative, combinations, variants."""
    index = SETTINGS.index(setting)
    if setting.law.name != "cooperative" and not setting.is_part and "+" not in setting.label:
        return "#ffffff", MARKERS[index % len(MARKERS)]
    if setting.law.name == "weighted":
        return COLOURS[5 if setting.is_part else 6], MARKERS[index % len(MARKERS)]
    return COLOURS[0], MARKERS[index % len(MARKERS)]


def save_spectra(path: Path, spectra: Mapping[str, Mapping[str, Sequence[tuple[int, float]]]]) -> None:
    """lambda_min over the number of vehicles. `spectra`: kind of shape -> law -> (vehicles, lambda_min)."""
    figure = titled_figure(13.0, 5.0, "Smallest eigenvalue of the interaction matrix for up to 10,000 vehicles")
    panels = figure.subplots(1, len(spectra), squeeze=False, sharey=True)[0]
    for axes, (kind, laws) in zip(panels, spectra.items(), strict=True):
        for index, (law, points) in enumerate(laws.items()):
            axes.loglog(*zip(*points, strict=True), label=law, marker=MARKERS[index], **curve_look(index))
        axes.set_title(kind)
        dress(axes, "vehicles")
    panels[0].set_ylabel("lambda_min of G [-]")
    put_legend_below(figure, panels[0], len(next(iter(spectra.values()))))
    figure.savefig(path, dpi=DPI)
