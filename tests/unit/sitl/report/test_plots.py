"""Figures are written as PNG, with titles, units and legends."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from companion.core.reference.blend import point
from companion.geometry.airspace import Airspace, Cylinder, Fence
from companion.report.plotting import COLOURS, MARKERS, STYLES
from sitl.flight.watch import FlightWatch
from sitl.report.metrics import Formation, FormationFlight, Track, stand_at
from sitl.report.plan_view import save_plan_view
from sitl.report.plots import save_comparison, save_figure_5, save_figure_6

PNG = b"\x89PNG\r\n\x1a\n"


def flight(law: str, vehicles: int = 4) -> FormationFlight:
    """A flight whose vehicles reach their slots within some seconds."""
    times_s = np.linspace(100.0, 140.0, 2001)
    closing = 1.0 - np.exp(-np.maximum(0.0, times_s - 110.0) / 3.0)
    slots = {i + 1: (-1.5 * i, 0.0, 0.0) for i in range(vehicles)}
    tracks = {
        i: Track(times_s, np.stack([slot[0] + closing, 0.1 * np.sin(times_s + i), np.ones_like(times_s)], axis=1))
        for i, slot in slots.items()
    }
    pairs = [pair for pair in combinations(slots, 2) if pair[1] - pair[0] == 1]
    return FormationFlight(law, tracks, stand_at(slots), pairs, point((1.0, 0.0, 1.0)), Formation(110.0, 135.0, 109.9))


def legend_of(figure: Figure) -> list[str]:
    return [text.get_text() for axes in figure.axes if axes.legend_ for text in axes.legend_.get_texts()]


def is_png(path: Path) -> bool:
    return path.read_bytes().startswith(PNG) and path.stat().st_size > 10_000


def test_figure_5_has_every_vehicle_with_units_and_slots(tmp_path: Path, drawn: list[Figure]) -> None:
    save_figure_5(tmp_path / "f.png", flight("weighted"), "platoon")
    assert is_png(tmp_path / "f.png")
    assert legend_of(drawn[0]) == ["vehicle 1", "vehicle 2", "vehicle 3", "vehicle 4", "its slot"]
    assert [axes.get_ylabel() for axes in drawn[0].axes] == ["x, east [m]", "y, north [m]"]
    assert drawn[0].axes[1].get_xlabel().endswith("[s]")
    assert "platoon" in drawn[0].get_suptitle()
    assert "weighted" in drawn[0].axes[0].get_title()


def test_figure_6_has_the_pairs_and_the_wanted_distance(tmp_path: Path, drawn: list[Figure]) -> None:
    save_figure_6(tmp_path / "f.png", flight("average_22"), "platoon")
    assert is_png(tmp_path / "f.png")
    # All vehicles move alike in x; in y two neighbours are at most 0.2 m sin(1/2) apart: sqrt(1.5^2 + 0.096^2) = 1.503.
    assert legend_of(drawn[0]) == [
        *(f"{pair}, largest 1.50 m" for pair in ("1-2", "2-3", "3-4")),
        "wanted, 1.50 m",
    ]
    assert drawn[0].axes[0].get_ylabel() == "distance [m]"


def test_distances_that_look_alike_are_named_once(tmp_path: Path, drawn: list[Figure]) -> None:
    slots = {1: (0.0, 0.0, 0.0), 2: (-1.5, 0.0, 0.0), 3: (-3.001, 0.0, 0.0), 4: (-4.501, 0.0, 0.0)}
    save_figure_6(tmp_path / "f.png", replace(flight("average_22"), slots=stand_at(slots)), "platoon")
    assert [entry for entry in legend_of(drawn[0]) if "wanted" in entry] == ["wanted, 1.50 m"]


def test_wanted_distances_that_differ_stand_at_their_pairs(tmp_path: Path, drawn: list[Figure]) -> None:
    slots = {1: (0.0, 0.0, 0.0), 2: (-1.5, 0.0, 0.0), 3: (-4.5, 0.0, 0.0), 4: (-6.0, 0.0, 0.0)}
    save_figure_6(tmp_path / "f.png", replace(flight("average_22"), slots=stand_at(slots)), "platoon")
    wanted = ["1-2, largest 1.50 m, wanted at the end 1.50 m", "2-3, largest 1.50 m, wanted at the end 3.00 m"]
    assert legend_of(drawn[0])[:2] == wanted
    assert [text.get_text() for text in drawn[0].axes[0].texts] == ["1-2", "2-3", "3-4"]


def test_a_comparison_has_a_column_for_each_law(tmp_path: Path, drawn: list[Figure]) -> None:
    save_comparison(tmp_path / "c.png", [flight("weighted"), flight("average_22"), flight("average_26")], "platoon")
    assert is_png(tmp_path / "c.png")
    assert len(drawn[0].axes) == 9
    titles = [axes.get_title() for axes in drawn[0].axes[:3]]
    assert [title.split(",")[-1] for title in titles] == [" eq. 14", " eq. 22", " eq. 26"]
    limits = {axes.get_ylim() for axes in drawn[0].axes[6:]}
    assert len(limits) == 1  # one scale for all laws


@pytest.mark.parametrize("vehicles", [4, 16])
def test_the_legend_of_distances_is_outside_its_panel(tmp_path: Path, drawn: list[Figure], vehicles: int) -> None:
    save_comparison(tmp_path / "c.png", [flight("weighted", vehicles), flight("cooperative", vehicles)], "chain")
    for axes in drawn[0].axes[4:]:
        assert axes.legend_
        legend, panel = axes.legend_.get_window_extent(), axes.get_window_extent()
        assert legend.y1 < panel.y0
        assert panel.height > drawn[0].bbox.height / 6


@pytest.mark.parametrize("vehicles", [1, 16])
def test_one_vehicle_and_many_are_drawn(tmp_path: Path, vehicles: int) -> None:
    save_figure_5(tmp_path / "5.png", flight("weighted", vehicles), "swarm")
    save_figure_6(tmp_path / "6.png", flight("weighted", vehicles), "swarm")
    assert is_png(tmp_path / "5.png")
    assert is_png(tmp_path / "6.png")


@pytest.mark.parametrize("obstacles", [(), (Cylinder((1.0, 2.0), 0.5, 0.0, 3.0),)])
def test_one_panel_from_above_has_its_whole_legend(
    tmp_path: Path, drawn: list[Figure], obstacles: tuple[Cylinder, ...]
) -> None:
    """The legend of an empty airspace, and the longest one."""
    corners = ((-9.0, -3.0), (9.0, -3.0), (0.0, 4.0)) if obstacles else ()
    airspace = Airspace(Fence((-50.0, -50.0, 0.0), (50.0, 50.0, 9.0), corners), obstacles)
    watch = FlightWatch([1, 2, 3, 4], [1], 100.0)
    watch.formations = [Formation(110.0, 135.0, 109.9)]
    save_plan_view(tmp_path / "p.png", flight("weighted"), watch, "platoon", airspace)
    [legend], page = drawn[0].legends, drawn[0].bbox
    (x0, y0), (x1, y1) = legend.get_window_extent().get_points()
    assert 0.0 < x0 < x1 < page.width
    assert 0.0 < y0 < y1 < drawn[0].axes[0].get_window_extent().y0
    assert len(legend.get_texts()) == (8 if obstacles else 6)


def test_curves_differ_without_colour() -> None:
    looks = {(str(STYLES[i % len(STYLES)]), MARKERS[i % len(MARKERS)]) for i in range(16)}
    assert len(looks) == 16
    assert len(COLOURS) == len(MARKERS)
