"""The look of the figures: one palette, marks that can be read, and axes that show what matters."""

from __future__ import annotations

import json
import re
from datetime import UTC
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.figure import Figure

from companion.monitor.server import PAGE, page_files
from companion.report.curve_figures import draw_errors
from companion.report.plotting import (
    COLOURS,
    STYLES,
    TimeAxis,
    curve_look,
    dress_time,
    finish,
    mark_labels,
    marked_look,
    marked_pair_look,
    new_figure,
    vehicle_look,
)
from companion.report.track_figures import draw_tracks
from companion.types import vehicle_looks
from companion.types.vehicle_looks import contrast
from made_flights import flight_of, records_of

LIGHT, DARK = page_files()["css/theme.css"].body.decode().split("[data-theme=")
SENT = re.search(r'id="vehicle-looks">(.*?)</script>', page_files()["index.html"].body.decode())


def of_vehicles(style: str, of: str = "") -> list[str]:
    return re.findall(rf"--{of}vehicle-\d: (#\w{{6}});", style)


def test_the_page_is_served_the_looks_of_the_figures() -> None:
    assert of_vehicles(LIGHT) == list(COLOURS) == [vehicle_look(n)["color"] for n in range(1, 8)]
    assert of_vehicles(DARK) == [colour.on_dark for colour in vehicle_looks.COLOURS]
    assert SENT
    sent = json.loads(SENT[1])
    assert sent["colours"] == len(COLOURS)
    assert [(0, tuple(dash)) if dash else "-" for dash in sent["dashes"]] == list(STYLES)


@pytest.mark.parametrize(("style", "map_colour"), [(LIGHT, "#f7f9fa"), (DARK, "#0e1318")])
def test_vehicles_are_seen_on_the_map_and_their_numbers_on_them(style: str, map_colour: str) -> None:
    assert f"--map: {map_colour};" in style
    least = {"#f7f9fa": 2.0, "#0e1318": 4.5}[map_colour]  # a symbol has its number, and a shape of 20 pixels
    assert min(contrast(colour, map_colour) for colour in of_vehicles(style)) > least
    on = zip(of_vehicles(style), of_vehicles(style, "on-"), strict=True)
    assert min(contrast(colour, ink) for colour, ink in on) > 4.5


def test_no_colour_of_a_vehicle_stands_in_a_file_of_its_own() -> None:
    for file in sorted(
        path for path in PAGE.rglob("*.*") if path.suffix in (".js", ".css") and "vendor" not in path.parts
    ):
        text = file.read_text(encoding="utf-8").lower()
        assert not [colour for colour in COLOURS if colour in text], file.name


def test_a_pair_has_the_colours_of_its_vehicles() -> None:
    look = marked_pair_look((2, 4), 0, 100)
    assert (look["color"], look["gapcolor"]) == (vehicle_look(2)["color"], vehicle_look(4)["color"])
    assert (look["markerfacecolor"], look["markerfacecoloralt"]) == (look["color"], look["gapcolor"])


def test_a_vehicle_has_one_look_whatever_else_is_drawn() -> None:
    assert vehicle_look(3)["color"] == COLOURS[2]
    assert marked_look(2, 100)["color"] == vehicle_look(3)["color"]
    assert marked_look(2, 100)["linestyle"] == vehicle_look(3)["linestyle"]
    assert vehicle_look(3) == vehicle_look(3 + 28)  # after so many they repeat


def test_28_curves_differ_without_a_legend() -> None:
    looks = {(curve_look(i)["color"], STYLES.index(curve_look(i)["linestyle"])) for i in range(28)}
    assert len(looks) == 28


@pytest.mark.parametrize("left_in", [0.62, 2.0])
def test_numbers_of_findings_do_not_overlap(left_in: float) -> None:
    """Twenty findings, the first ones less than a second apart."""
    marks = tuple((5.0 + 0.12 * n**2.2, str(n + 1)) for n in range(20))
    figure = new_figure(1.0)
    axes = figure.subplots()
    dress_time([axes], TimeAxis(100.0, 1_764_000_000.0, UTC, marks))
    finish(figure, [axes], left_in)
    figure.savefig("/dev/null", format="svg")
    boxes = sorted((text.get_window_extent() for text in axes.texts), key=lambda box: box.x0)
    assert len(boxes) > 5
    assert all(left.x1 + 2.0 < right.x0 for left, right in pairwise(boxes))


def test_findings_of_one_moment_share_a_label_with_ranges() -> None:
    marks = [(10.0, "2"), (10.1, "3"), (10.2, "12"), (10.0, "4"), (60.0, "1"), (60.1, "5")]
    assert [label for _, label in mark_labels(marks, 20.0)] == ["2–4,12", "1,5"]
    assert [round(time_s, 6) for time_s, _ in mark_labels(marks, 20.0)] == [10.1, 60.05]
    assert [label for _, label in mark_labels(marks, 0.01)] == ["2,4", "3", "12", "1", "5"]


def test_the_axis_of_errors_is_that_of_the_formation(drawn: list[Figure]) -> None:
    """The errors of climb and landing are of metres; a tenth of one must not be a flat line."""
    flight = flight_of(records_of(3, 30.0))
    errors_m = {
        one.vehicle_id: np.where(one.ticks.phase == "formation", 0.1 * one.vehicle_id, 7.0) for one in flight.vehicles
    }
    draw_errors(flight, errors_m, TimeAxis(flight.ends_s, None, UTC))
    assert drawn[0].axes[0].get_ylim() == pytest.approx((0.0, 1.05 * 0.3))


def test_numbers_on_an_axis_keep_their_digits(drawn: list[Figure]) -> None:
    """Coordinates of a picture are rounded, what is read in it is not."""
    flight = flight_of(records_of(1, 30.0))
    body = draw_errors(flight, {1: np.full(flight.vehicles[0].ticks.time_s.size, 0.18)}, TimeAxis(30.0, None, UTC)).body
    ticks = drawn[0].axes[0].yaxis.get_major_ticks()
    shown = {tick.label1.get_text() for tick in ticks if tick.get_loc() <= 0.18}
    assert "0.025" in shown
    assert shown <= set(re.findall(r">([\d.]+)</text>", body))


def test_errors_without_a_formation_have_an_axis_of_their_own(drawn: list[Figure]) -> None:
    flight = flight_of(records_of(1, 30.0))
    errors_m = {1: np.where(flight.vehicles[0].ticks.phase == "formation", np.nan, 7.0)}
    draw_errors(flight, errors_m, TimeAxis(flight.ends_s, None, UTC))
    assert drawn[0].axes[0].get_ylim()[1] > 7.0


def test_the_tracks_show_the_reference_in_formation(drawn: list[Figure]) -> None:
    flight = flight_of(records_of(2, 40.0))
    draw_tracks(flight, [])
    [axes] = drawn[0].axes
    assert "reference" in [text.get_text() for text in drawn[0].legends[0].get_texts()]
    [line] = [line for line in axes.lines if line.get_label() == "_" and np.size(line.get_xdata()) > 100]
    reference_m = np.column_stack(line.get_data())
    known = reference_m[~np.isnan(reference_m[:, 0])]
    # A circle of 10 m about (0, 10), of which 22 s of 60 s are flown.
    assert np.hypot(known[:, 0], known[:, 1] - 10.0) == pytest.approx(10.0, abs=1e-6)
    assert known[0] == pytest.approx((0.0, 0.0), abs=0.1)
    assert known[-1] == pytest.approx(
        (10.0 * np.sin(2.2 * np.pi / 3.0), 10.0 - 10.0 * np.cos(2.2 * np.pi / 3.0)), abs=0.1
    )
