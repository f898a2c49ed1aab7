"""The look of every figure of the report and of sitl: one palette, readable in grey and for the colour-blind.

A vehicle has the colour, line style and marker of its id in all figures, and on the live page (`vehicle_looks.py`); a pair
has the colours of its two vehicles. Helpers for title, units and legend come first, then the figures of the report's page,
which share one time axis and are drawn into the page itself.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, tzinfo
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator, NullFormatter

from companion.geometry.airspace import Obstacle
from companion.report.flight import Floats
from companion.types import vehicle_looks

COLOURS = tuple(colour.on_light for colour in vehicle_looks.COLOURS)
STYLES: tuple[Any, ...] = tuple((0, dash) if dash else "-" for dash in vehicle_looks.DASHES)
PAIR_STYLES = ((0, (6, 6)), (0, (3, 3)), (0, (9, 4)), (0, (4, 9)))  # first colour, second colour
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
GREY, SOFT, GRID = "#808080", "#444444", "#dddddd"
LIMIT: dict[str, Any] = {"color": "#a3201d", "linewidth": 1.2, "linestyle": (0, (4, 2)), "zorder": 3}
GUIDE: dict[str, Any] = {"color": GREY, "linewidth": 1.1, "linestyle": (0, (1, 1.8)), "zorder": 1.5}
FENCE: dict[str, Any] = {"fill": False, "edgecolor": "#a3201d", "linewidth": 1.3, "linestyle": (0, (6, 3)), "zorder": 2}
OBSTACLE: dict[str, Any] = {
    "facecolor": GRID,
    "edgecolor": "#555555",
    "hatch": "///",
    "linewidth": 0.8,
    "zorder": 1.5,
}
MARKERS_PER_CURVE = 12
DPI = 130


def pale(colour: str) -> str:
    """A tint of a colour #RRGGBB on which black text is read."""
    parts = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return "#" + "".join(f"{round(255 - 0.35 * (255 - part)):02x}" for part in parts)


def curve_look(index: int) -> dict[str, Any]:
    """Style of one of several curves."""
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": STYLES[index % len(STYLES)], "linewidth": 1.4}


def vehicle_look(vehicle_id: int) -> dict[str, Any]:
    """Style of the curve of a vehicle, the same in every figure."""
    return curve_look(vehicle_id - 1)


def pair_look(pair: tuple[int, int], index: int) -> dict[str, Any]:
    """Style of a curve of two vehicles: dashes in the colour of the one, gaps in that of the other."""
    first, second = (vehicle_look(vehicle_id)["color"] for vehicle_id in pair)
    return {
        "color": first,
        "gapcolor": second,
        "linestyle": PAIR_STYLES[index % len(PAIR_STYLES)],
        "linewidth": 1.4,
        "dash_capstyle": "butt",
    }


def marked_pair_look(pair: tuple[int, int], index: int, samples: int) -> dict[str, Any]:
    """As `pair_look`, with markers in both colours; those of different curves are at different times."""
    look, every = pair_look(pair, index), max(1, samples // MARKERS_PER_CURVE)
    return look | {
        "marker": MARKERS[index % len(MARKERS)],
        "markersize": 6.5,
        "fillstyle": "left",
        "markerfacecolor": look["color"],
        "markerfacecoloralt": look["gapcolor"],
        "markeredgecolor": "white",
        "markeredgewidth": 0.8,
        "markevery": (index * every // 4 % every, every),
    }


def marker_look(index: int) -> dict[str, Any]:
    """Open markers in the colour of `curve_look`."""
    return {
        "color": COLOURS[index % len(COLOURS)],
        "marker": MARKERS[index % len(MARKERS)],
        "markersize": 5,
        "markerfacecolor": "white",
        "markeredgewidth": 1.2,
    }


def marked_look(index: int, samples: int) -> dict[str, Any]:
    """Style of a curve with markers; those of different curves are at different times."""
    every = max(1, samples // MARKERS_PER_CURVE)
    return curve_look(index) | marker_look(index) | {"markevery": (index * every // 4 % every, every)}


# ------------------------------------------------------------ title, units, legend


def titled_figure(width_in: float, height_in: float, title: str) -> Figure:
    """An empty figure with its title, for a file of its own."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    figure.suptitle(title, fontsize=13, fontweight="bold")
    return figure


def dress(axes: Axes, x_label: str = "", y_label: str = "", size: float = 9) -> None:
    """Grid, quiet frame, and labels, which have the unit in brackets. An empty label changes nothing."""
    if x_label:
        axes.set_xlabel(x_label, fontsize=size)
    if y_label:
        axes.set_ylabel(y_label, fontsize=size)
    axes.grid(visible=True, which="major", color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=size)


def dress_plan(axes: Axes, x_label: str = "", y_label: str = "") -> None:
    """As `dress`, for a view from above: both axes have one scale."""
    axes.set_aspect("equal", adjustable="box")
    dress(axes, x_label, y_label)


def dress_logarithmic(axes: Axes) -> None:
    """Both axes logarithmic, with plain numbers along x."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(LogLocator(10.0, subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())


def put_legend_beside(axes: Axes) -> None:
    """To the right of the axes."""
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=9, frameon=False, handlelength=3.5)


def put_legend_below(figure: Figure, axes: Axes, columns: int, title: str | None = None) -> None:
    """What `axes` shows, below all panels of a `titled_figure`."""
    handles, labels = axes.get_legend_handles_labels()
    style: dict[str, Any] = {"ncols": columns, "fontsize": 9, "frameon": False, "handlelength": 4, "title": title}
    figure.legend(handles, labels, loc="outside lower center", **style)


def label_once(axes: Axes, label: str) -> str:
    """The label, or none where the legend of these axes already has it."""
    return "_" if label in axes.get_legend_handles_labels()[1] else label


def draw_fence(axes: Axes, corners_enu_m: Sequence[tuple[float, float]]) -> None:
    """A fence from above; nothing without corners."""
    if corners_enu_m:
        axes.add_patch(Polygon(corners_enu_m, label="fence", **FENCE))


def draw_obstacles(axes: Axes, obstacles: Iterable[Obstacle]) -> None:
    """Obstacles from above, hatched, with one entry in the legend."""
    for obstacle in obstacles:
        axes.add_patch(Polygon(obstacle.outline_enu_m, label=label_once(axes, "obstacle"), **OBSTACLE))


# ------------------------------------------------------------ figures of the report's page

WIDTH_IN = 7.3  # the width of A4 between margins of 12 mm
COLUMNS = 500  # a curve is drawn in so many columns, with two values in each
TIME_LABEL = "time since the first record [s]"
LEFT_IN, RIGHT_IN, TOP_IN, BOTTOM_IN = 0.62, 0.14, 0.2, 0.44  # margins; the right one has half a label of the time
CLOCK_IN = 0.38  # upper margin with the time of day
LEGEND_ROW_IN = 0.165
LABEL_IN = 0.5  # from the values of an axis to its label
SIZE = 8.0  # text size in points
STEPS_S = (0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200)
MOST_STEPS = 12
MARK_SIZE = 6.5  # of the numbers of findings, in points
NARROWEST_IN = 5.0  # width of a time axis beside the longest names


@dataclass(frozen=True, slots=True)
class TimeAxis:
    """The time axis of all figures: from 0 s to the end, its local time of day, and the findings to be marked on it.

    `begin_unix_s` None: a flight without a date.
    """

    ends_s: float
    begin_unix_s: float | None
    zone: tzinfo
    marks: tuple[tuple[float, str], ...] = ()

    def clock(self, time_s: float, digits: int = 0) -> str:
        """The local time of day; empty without a date."""
        if self.begin_unix_s is None:
            return ""
        at = datetime.fromtimestamp(round(self.begin_unix_s + time_s, digits), self.zone)
        return f"{at:%H:%M:%S}" + (f".{at.microsecond // 10 ** (6 - digits):0{digits}d}" if digits else "")


def new_figure(panels_in: float) -> Figure:
    """An empty figure of the width of the page, with this height for its panels.

    `finish` adds fixed margins and the legend, so the time axes of all figures are of one width.
    """
    return Figure(figsize=(WIDTH_IN, panels_in))


def thin_out(time_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Smallest and largest value of each of COLUMNS parts of the time: what is drawn keeps every peak. NaN breaks the curve."""
    if time_s.size <= 3 * COLUMNS:
        return time_s, values
    length = -(-time_s.size // COLUMNS)
    padded = np.full(length * COLUMNS, np.nan)
    padded[: values.size] = values
    parts = padded.reshape(COLUMNS, length)
    missing = np.isnan(parts)
    picks = (
        np.argmin(np.where(missing, np.inf, parts), axis=1),
        np.argmax(np.where(missing, -np.inf, parts), axis=1),
        np.argmax(missing, axis=1),  # the first NaN, else the first value
    )
    rows = np.unique(np.concatenate([np.arange(COLUMNS) * length + pick for pick in picks]))
    rows = rows[rows < values.size]
    return time_s[rows], values[rows]


def plot(axes: Axes, time_s: Floats, values: Floats, label: str, **style: Any) -> None:
    """One curve over time, thinned."""
    axes.plot(*thin_out(time_s, values), label=label, **style)


def dress_panel(axes: Axes, x_label: str, y_label: str, columns: int = 1) -> None:
    """As `dress`, with the labels of y in one line over all figures. `columns`: of panels beside each other."""
    dress(axes, x_label, y_label, SIZE)
    axes.yaxis.set_label_coords(-LABEL_IN / (WIDTH_IN - LEFT_IN - RIGHT_IN) * columns, 0.5)


def dress_time(panels: Sequence[Axes], axis: TimeAxis) -> None:
    """The time below the last panel, the local time of day above the first, and numbered marks of findings."""
    for axes in panels:
        axes.set_xlim(0.0, max(axis.ends_s, 1.0))
        for time_s, _ in axis.marks:
            axes.axvline(time_s, color="#555555", linewidth=0.7, linestyle=(0, (1, 1.5)), zorder=1)
    step_s = next((step_s for step_s in STEPS_S if axis.ends_s / step_s <= MOST_STEPS), axis.ends_s / MOST_STEPS)
    panels[-1].set_xlabel(TIME_LABEL, fontsize=SIZE + 0.5)
    for one in (panels[0], panels[-1]):
        one.xaxis.set_major_locator(MultipleLocator(step_s))
    if axis.begin_unix_s is not None:
        _add_clock(panels[0], axis, step_s)
    _number_marks(panels[0], axis)


def _add_clock(axes: Axes, axis: TimeAxis, step_s: float) -> None:
    """The local time of day above the panel."""
    above = axes.secondary_xaxis("top")
    above.xaxis.set_major_locator(MultipleLocator(step_s))
    # A label at the right end would leave the picture.
    above.xaxis.set_major_formatter(
        FuncFormatter(lambda time_s, _: axis.clock(time_s) if time_s < 0.96 * axis.ends_s else "")
    )
    above.tick_params(labelsize=7, colors="#666666", length=0, pad=11)
    above.spines["top"].set_visible(False)


def _number_marks(axes: Axes, axis: TimeAxis) -> None:
    """The numbers of the findings above the upper edge."""
    box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "#555555", "linewidth": 0.5}
    where: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "ha": "center", "va": "bottom", "zorder": 6}
    for time_s, label in mark_labels(axis.marks, max(axis.ends_s, 1.0) / NARROWEST_IN):
        axes.text(time_s, 1.02, label, fontsize=MARK_SIZE, color="#333333", bbox=box, **where)


def mark_labels(marks: Iterable[tuple[float, str]], s_per_in: float) -> list[tuple[float, str]]:
    """(time of its middle, numbers) of labels that do not overlap; marks too near to each other share one."""
    groups: list[list[tuple[float, int]]] = []
    for time_s, number in sorted((time_s, int(number)) for time_s, number in marks):
        groups.append([(time_s, number)])
        # A label that has grown may touch the one before it.
        while len(groups) > 1 and _middle_s(groups[-1]) - _middle_s(groups[-2]) < s_per_in * (
            (_width_in(groups[-1]) + _width_in(groups[-2])) / 2.0
        ):
            groups[-2:] = [groups[-2] + groups[-1]]
    return [(_middle_s(group), _numbers(group)) for group in groups]


def _middle_s(group: Sequence[tuple[float, int]]) -> float:
    return (group[0][0] + group[-1][0]) / 2.0


def _width_in(group: Sequence[tuple[float, int]]) -> float:
    """Of the label with its frame and a gap."""
    return (0.66 * MARK_SIZE * len(_numbers(group)) + 5.0) / 72.0


def _numbers(group: Sequence[tuple[float, int]]) -> str:
    """ "1–3,7": in order, what follows each other as a range."""
    parts: list[list[int]] = []
    for number in sorted(number for _, number in group):
        if parts and number == parts[-1][-1] + 1:
            parts[-1].append(number)
        else:
            parts.append([number])
    return ",".join(f"{part[0]}–{part[-1]}" if len(part) > 2 else ",".join(map(str, part)) for part in parts)


def finish(figure: Figure, panels: Sequence[Axes], left_in: float = LEFT_IN) -> None:
    """Margins of fixed size, and one legend below all panels in as many columns as fit, each label once."""
    found: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    columns, rows = 1, 0
    if found:
        columns = min(len(found), max(1, int((WIDTH_IN - 0.2) / (0.68 + 0.066 * max(map(len, found))))))
        rows = -(-len(found) // columns)
    legend_in = LEGEND_ROW_IN * rows + (0.08 if rows else 0.0)
    top_in = CLOCK_IN if any(axes.child_axes for axes in panels) else TOP_IN
    height_in = figure.get_figheight() + top_in + BOTTOM_IN + legend_in
    figure.set_figheight(height_in)
    figure.subplots_adjust(
        left=left_in / WIDTH_IN,
        right=1.0 - RIGHT_IN / WIDTH_IN,
        top=1.0 - top_in / height_in,
        bottom=(BOTTOM_IN + legend_in) / height_in,
        hspace=0.16,
    )
    if found:
        figure.legend(
            found.values(),
            found.keys(),
            loc="lower center",
            bbox_to_anchor=(0.5, 0.0),
            ncols=columns,
            fontsize=7.5,
            frameon=False,
            handlelength=3.2,
            borderaxespad=0.1,
        )


LARGE_SVG_BYTES = 150_000  # above this a PNG may be smaller
PNG_DPI = 170  # sharp on A4
# Text stays text: it can be searched, and a page of many figures stays small.
RC: Any = {"svg.fonttype": "none", "svg.hashsalt": "report", "font.sans-serif": ["DejaVu Sans"]}
FONT = "'DejaVu Sans'"  # what matplotlib draws with and measures by; the others are not wider
FONTS = f"{FONT}, Arial, Helvetica, sans-serif"
NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


@dataclass(frozen=True, slots=True)
class DrawnFigure:
    """One figure of the page. `body` is an `svg` or an `img` element."""

    id: str
    title: str
    caption: str
    body: str


def render(figure: Figure, id_: str, title: str, caption: str) -> DrawnFigure:
    """Draws the figure. The title is that of the page's caption, and the picture's accessible name."""
    svg = _svg(figure, id_, title)
    if len(svg) > LARGE_SVG_BYTES:
        png = _png(figure, title)
        svg = min(svg, png, key=len)
    return DrawnFigure(id_, title, caption, svg)


def _svg(figure: Figure, id_: str, title: str) -> str:
    buffer = io.StringIO()
    with matplotlib.rc_context(RC):
        figure.savefig(buffer, format="svg", metadata=NO_METADATA)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r' xmlns(:\w+)?="[^"]*"', "", text)  # HTML needs none, and a page without addresses is easy to check
    text = text.replace("xlink:href", "href").replace(FONT, FONTS)
    # Ids are unique in one figure only.
    text = re.sub(r'\bid="', f'id="{id_}-', text)
    text = re.sub(r"url\(#", f"url(#{id_}-", text)
    text = re.sub(r'href="#', f'href="#{id_}-', text)
    # Coordinates to a hundredth of a point; not numbers that are read, such as 0.025 on an axis.
    text = re.sub(r"<[^>]+>", lambda tag: re.sub(r"(\d+\.\d\d)\d+", r"\1", tag[0]), text)
    return text.replace("<svg ", f'<svg role="img" aria-label="{_attribute(title)}" ', 1)


def _png(figure: Figure, title: str) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=PNG_DPI, pil_kwargs={"optimize": True})
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<img alt="{_attribute(title)}" src="data:image/png;base64,{data}">'


def _attribute(text: str) -> str:
    return text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
