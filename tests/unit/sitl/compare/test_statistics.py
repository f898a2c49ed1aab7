"""Figures of a flight, medians with intervals, winners, checks, and the folder."""

import csv
import re
from dataclasses import replace
from itertools import pairwise
from math import inf
from pathlib import Path

import msgspec
import numpy as np
import pytest

import companion.laws.cooperative as cooperative_law
from companion.config.law import LawSection
from lockstep_fleet import platoon
from sitl.compare.command import FlownCells, write_folder
from sitl.compare.figures import NOTHING, Figures, FlownFormation, closest_m, failed, figures_of, packet_bytes
from sitl.compare.flights import connected
from sitl.compare.options import CompareOptions
from sitl.compare.plan import Plan, law_of_text, plan_of
from sitl.compare.plots import figures_of as drawn_figures
from sitl.compare.report import compared, failures_text, report_text, rows_of
from sitl.compare.statistics import FEWEST_SEEDS, FlownFlight, Winner, by_cell, checks, interval, summaries, winners

SEEDS = 6
PLAN = plan_of(
    CompareOptions(
        laws=["weighted", "cooperative"],
        graphs=["chain", "grid"],
        conditions=["ideal", "noise"],
        vehicles=[4],
        seeds=SEEDS,
    ),
    lambda _share: None,
)


def figures(**changed: float | None) -> Figures:
    usual = {"settle_s": 5.0, "overshoot_m": 0.1, "smallest_distance_m": 1.4, "rms_m": 0.05, "final_error_m": 0.02}
    given = dict.fromkeys(Figures.__struct_fields__) | usual | {"effort_m_s2": 0.3, "bytes_per_s": 14000.0} | changed
    return Figures(**given)


def flown(plan: Plan = PLAN, **by_law: Figures) -> list[FlownFlight]:
    return [FlownFlight(flight, by_law.get(flight.cell.law, figures())) for flight in plan.flights]


def winner(found: list[Winner], figure: str = "settle_s") -> Winner | None:
    return next((one for one in found if one.figure == figure), None)


# ---------------------------------------------------------------- figures


def test_figures_of_a_step() -> None:
    """Two vehicles go 1 m along x to their slots; the second goes 0.2 m too far and comes back."""
    times_s = np.arange(0.0, 10.001, 0.02)
    first = np.minimum(times_s / 2.0, 1.0)
    second = np.where(times_s < 3.0, np.minimum(times_s * 0.4, 1.2), 1.0)
    zero = np.zeros_like(times_s)
    slots = np.array([[0.0, 0.0, 0.0], [-1.5, 0.0, 0.0]])
    positions = np.stack([np.stack([x, zero, zero], axis=1) for x in (first, second - 1.5)], axis=1)
    commanded = np.stack([zero + 0.3, zero + 0.4], axis=1)
    goal = np.tile([1.0, 0.0, 0.0], (times_s.size, 1))
    one = figures_of(FlownFormation(times_s, positions, goal, slots, commanded, None), platoon(), hop_gains=False)
    assert one.settle_s == pytest.approx(3.0, abs=0.021)
    assert one.overshoot_m == pytest.approx(0.2, abs=0.01)
    assert one.smallest_distance_m == pytest.approx(1.3, abs=0.01)
    assert one.rms_m == one.final_error_m == 0.0
    assert one.effort_m_s2 == pytest.approx(np.sqrt((0.09 + 0.16) / 2.0), abs=1e-4)
    assert one.gain_per_hop is None and one.connected_share is None
    moving = goal + 0.1 * times_s[:, None]
    one = figures_of(FlownFormation(times_s, positions, moving, slots, commanded, None), platoon(), hop_gains=False)
    assert one.overshoot_m is None and one.settle_s is None
    positions[400:] = np.nan
    failed = FlownFormation(times_s, positions, goal, slots, commanded, None)
    assert figures_of(failed, platoon(), hop_gains=False).failure is not None


def test_the_closest_pair_is_found_and_one_vehicle_has_none() -> None:
    assert closest_m(np.array([[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 4.0, 0.0]]])) == 3.0
    assert closest_m(np.zeros((5, 1, 3))) is None


def test_published_values_cost_bytes(tmp_path: Path) -> None:
    cooperative = Path(cooperative_law.__file__).read_text(encoding="utf-8")
    publishing = cooperative.replace("Weighted, frozen=True):", "Weighted, frozen=True):\n    publishes = 2", 1)
    publishing += "\n    def publish(self, own, neighbours, reference):\n        return ((0.0, 0.0, 0.0),) * 2\n"
    (tmp_path / "publishing.py").write_text(publishing, encoding="utf-8")
    plain = packet_bytes(LawSection())
    assert 200 < plain < 400
    _, section = law_of_text(str(tmp_path / "publishing.py"), LawSection())
    assert packet_bytes(section) == plain + 2 * (1 + 3 * 9)  # two arrays of three numbers


def test_vehicles_without_a_path_to_a_leader_are_not_connected() -> None:
    uses = np.zeros((2, 3, 3), dtype=bool)
    uses[:, 1, 0] = uses[0, 2, 1] = True  # at the second time vehicle 3 has no neighbour
    uses[1, 1, 2] = True
    assert connected(uses, np.array([True, False, False])).tolist() == [1.0, 0.0]


# ---------------------------------------------------------------- statistics


def test_an_interval_is_of_the_median_and_repeats() -> None:
    values = np.arange(21.0)
    one = interval(values)
    assert one.median == 10.0 and one.low is not None and one.high is not None
    assert 5.0 <= one.low < 10.0 < one.high <= 15.0
    assert interval(values) == one
    same = interval(np.full(5, 2.0))
    assert (same.low, same.median, same.high) == (2.0, 2.0, 2.0)


def test_an_unsettled_flight_counts_as_later_than_all_settled_ones() -> None:
    assert interval(np.array([5.0, inf, 3.0, inf, inf])).median is None
    some = interval(np.array([1.0, 2.0, 2.5, 3.0, inf]))
    assert some.median == 2.5 and some.high is None


def test_a_cell_counts_settled_flights_and_leaves_out_what_it_has_not() -> None:
    (one, *_) = summaries(by_cell(flown(weighted=figures(settle_s=None))))
    assert (one.law, one.place, one.flights, one.settled_share) == ("weighted", "chain 4, ideal", SEEDS, 0.0)
    assert one.figures["settle_s"].median is None
    assert "gain_per_hop" not in one.figures


def test_the_best_law_is_found_by_pairs_and_more_distance_is_better() -> None:
    """In each seed cooperative is 1 s sooner, although the seeds differ by more."""
    rows = [
        FlownFlight(
            f,
            figures(
                settle_s=10.0 * f.seed + (0.0 if f.cell.law == "cooperative" else 1.0),
                smallest_distance_m=1.0 + (f.cell.law == "weighted"),
            ),
        )
        for f in PLAN.flights
    ]
    found = winners(by_cell(rows))
    soonest = winner(found)
    assert soonest is not None and soonest.clear
    assert (soonest.law, soonest.next_law, soonest.ahead.median) == ("cooperative", "weighted", 1.0)
    farthest = winner(found, "smallest_distance_m")
    assert farthest is not None and (farthest.law, farthest.ahead.median) == ("weighted", 1.0)
    assert winner(found, "rms_m") is None, "a tie has no winner"


def test_a_law_that_is_better_in_half_of_the_seeds_is_not_clear() -> None:
    rows = [
        FlownFlight(f, figures(settle_s=5.0 if f.cell.law == "weighted" else (4.0 if f.seed % 2 else 5.9)))
        for f in PLAN.flights
    ]
    one = winner(winners(by_cell(rows)))
    assert one is not None and not one.clear


def test_few_seeds_have_no_clear_winner() -> None:
    rows = [one for one in flown(weighted=figures(settle_s=9.0)) if one.flight.seed < FEWEST_SEEDS]
    one = winner(winners(by_cell(rows)))
    assert one is not None and not one.clear


def test_a_law_that_alone_settles_is_clearly_the_best_and_none_is_where_none_settles() -> None:
    one = winner(winners(by_cell(flown(weighted=figures(settle_s=None)))))
    assert one is not None and one.clear and one.ahead.median is None
    assert winner(winners(by_cell(flown(weighted=figures(settle_s=None), cooperative=figures(settle_s=None))))) is None


# ---------------------------------------------------------------- checks


@pytest.mark.parametrize(
    ("agents", "agrees"),
    [({"settle_s": 5.2}, True), ({"settle_s": 5.5}, False), ({"settle_s": None}, False), ({"rms_m": 0.058}, True)],
)
def test_agents_agree_within_5_percent(agents: dict[str, float | None], agrees: bool) -> None:
    rows = flown()
    found = checks(by_cell(rows), [FlownFlight(rows[0].flight, figures(**agents))])
    assert len(found) == 5 and not any(one.random for one in found)
    assert all(one.agrees for one in found) is agrees


def test_with_random_errors_agents_agree_within_the_seeds() -> None:
    rows = [FlownFlight(f, figures(rms_m=0.1 * f.seed)) for f in PLAN.flights]
    noisy = next(one.flight for one in rows if one.flight.cell.place.condition == "noise")
    quiet = rows[0].flight

    def agree(flight: object, rms_m: float) -> bool:
        found = checks(by_cell(rows), [FlownFlight(flight, figures(rms_m=rms_m))])  # type: ignore[arg-type]
        return next(one.agrees for one in found if one.figure == "rms_m")

    assert agree(noisy, 0.45) and agree(noisy, 1.05) and not agree(noisy, 1.2)
    assert not agree(quiet, 0.45)


# ---------------------------------------------------------------- the folder


def test_the_folder_has_page_figures_and_rows(tmp_path: Path) -> None:
    rows = flown(weighted=figures(settle_s=None, gain_per_hop=1.2))
    rows[1] = FlownFlight(rows[1].flight, figures(settle_s=None, gain_per_hop=1.2, rms_m=0.09))
    plan = replace(PLAN, settings=["links.peer_loss=0.05"])
    result = compared("sitl compare", plan, rows, [FlownFlight(rows[0].flight, figures(settle_s=9.0))])
    assert report_text(result, by_cell(rows)).startswith(
        "48 flights of 4 vehicles, 30 s each, all with links.peer_loss=0.05;"
    )
    write_folder(tmp_path, plan, FlownCells(rows, []), result)
    for name in ("settling", "by_graph", "distance"):
        assert (tmp_path / f"{name}.pdf").read_bytes().startswith(b"%PDF")
    first, *_, last = csv.DictReader((tmp_path / "compare.csv").open())
    assert (first["law"], first["seed"], first["settle_s"], first["gain_per_hop"]) == ("weighted", "1", "", "1.2")
    assert (last["law"], last["graph"], last["condition"], last["flown_by"]) == (
        "cooperative",
        "grid",
        "noise",
        "batch",
    )
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert not re.search(r"""(src|href)=["']?(https?:)?//""", page)
    assert "seeds 1 to 6, all with links.peer_loss=0.05." in page
    assert page.count("<svg") == 3 and "chain 4, noise" in page and "never" in page
    assert "no landing" in page, "what the batch leaves out"
    assert "its interval of 95 % stands below it" in page and "0.050<small>0.050–0.070</small>" in page
    assert "✗" in page[page.index('id="check"') :]
    content = msgspec.json.decode((tmp_path / "compare.json").read_bytes())
    assert content["laws"] == {"weighted": None, "cooperative": None} and content["command"] == "sitl compare"


@pytest.mark.parametrize("seconds", [20.0, 30.0, 75.0, 200.0, 500.0])
def test_no_time_on_an_axis_touches_the_word_never(seconds: float) -> None:
    plan = replace(PLAN, seconds=seconds)
    rows = flown(plan)
    figure = drawn_figures(plan, by_cell(rows), compared("sitl compare", plan, rows, []))["distance"].figure
    figure.savefig("/dev/null", format="svg")
    labels = [label for label in figure.axes[0].get_xticklabels() if label.get_text()]
    assert labels[-1].get_text() == "never"
    boxes = [label.get_window_extent() for label in labels]
    assert all(left.x1 + 3.0 < right.x0 for left, right in pairwise(boxes))


def test_the_text_says_what_is_missing() -> None:
    rows = flown()[:5]
    result = compared("sitl compare", PLAN, rows, [])
    assert not result.complete
    text = report_text(result, by_cell(rows))
    assert text.startswith("5 flights of 4 vehicles, 30 s each; stopped before the end, 48 were planned")
    assert "what a batch leaves out:" in text


def test_a_law_of_which_a_flight_has_failed_is_the_best_nowhere() -> None:
    rows = flown(cooperative=failed("line 3: ZeroDivisionError"))
    cells = by_cell(rows)
    assert winners(cells) == []  # a law alone wins nothing
    lost = [one for one in summaries(cells) if one.failed]
    assert {(one.law, one.failed, len(one.figures)) for one in lost} == {("cooperative", SEEDS, 0)}
    lines = list(failures_text(cells))
    assert len(lines) == 4  # places
    assert lines[0].endswith(f"{SEEDS} of {SEEDS} flights: line 3: ZeroDivisionError")
    assert {row["failure"] for row in rows_of(rows)} == {None, "line 3: ZeroDivisionError"}


def test_a_flight_without_formation_never_settled() -> None:
    rows = flown(weighted=NOTHING)
    one = winner(winners(by_cell(rows)))
    assert one is not None and (one.law, one.clear) == ("cooperative", True)
    assert rows_of(rows)[0]["settle_s"] is None
