"""One palette: a vehicle has the same colour in the report, in figures of sitl and on the live page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import companion.monitor
from companion.report.plotting import COLOURS, STYLES, curve_look, marked_look, vehicle_look

PAGE = Path(companion.monitor.__file__).parent / "page"
THEME = PAGE / "css" / "theme.css"
SERIES = PAGE / "js" / "views" / "plot_series.js"


def test_the_light_page_has_the_palette_of_the_figures() -> None:
    light, _, _ = THEME.read_text(encoding="utf-8").partition("[data-theme=")
    assert tuple(re.findall(r"--vehicle-\d: (#\w{6});", light)) == tuple(colour.lower() for colour in COLOURS)


@pytest.mark.parametrize("name", ["const COLOURS = 7;", "colours[`vehicle-${((id - 1) % COLOURS) + 1}`]"])
def test_the_page_chooses_the_colour_by_the_id(name: str) -> None:
    assert len(COLOURS) == 7
    assert name in SERIES.read_text(encoding="utf-8")


def test_the_dark_page_has_a_colour_for_each_of_them_that_is_bright() -> None:
    _, _, dark = THEME.read_text(encoding="utf-8").partition("[data-theme=")
    found = re.findall(r"--vehicle-\d: #(\w{6});", dark)
    assert len(found) == len(set(found)) == len(COLOURS)
    for colour in found:
        red, green, blue = (int(colour[i : i + 2], 16) for i in (0, 2, 4))
        assert 0.2126 * red + 0.7152 * green + 0.0722 * blue > 130.0, colour


def test_a_vehicle_has_one_look_whatever_else_is_drawn() -> None:
    assert vehicle_look(3)["color"] == COLOURS[2]
    assert marked_look(2, 100)["color"] == vehicle_look(3)["color"]
    assert marked_look(2, 100)["linestyle"] == vehicle_look(3)["linestyle"]
    assert vehicle_look(3) == vehicle_look(3 + 28)  # after so many they repeat


def test_28_curves_differ_without_a_legend() -> None:
    looks = {(curve_look(i)["color"], STYLES.index(curve_look(i)["linestyle"])) for i in range(28)}
    assert len(looks) == 28
