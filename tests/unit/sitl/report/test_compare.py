"""Summary of a flight and comparison of laws: as text, table and file."""

import argparse
from pathlib import Path

import msgspec
import pytest

from common import ROOT, with_fields
from companion.config.law import law_of
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot
from companion.types.status import SeparationReport
from companion.wire.messages import Percentiles, StatusReport, Timing
from ground_fleet import leader, reported
from sitl.cli.flights import FLY, flight_options
from sitl.flight.flights import FlightEnd, FlightOptions, summarize
from sitl.flight.scenario import load_scenario, with_law
from sitl.flight.watch import FlightWatch
from sitl.report.compare import Comparison, compare, in_a_table
from sitl.report.summary import RunSummary, in_words, read_summary, write_json
from tests.helpers.laws import cooperative

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
TIMING = Timing(49.996, 2997, 3, Percentiles(1, 2, 3), Percentiles(4, 5, 6), 5.0, 48.0)


def summary(
    law: str, largest_m: float, settle_s: float | None, failure: str | None = None, timing: Timing = TIMING
) -> RunSummary:
    watch = FlightWatch([1, 2, 3, 4], [1], 0.0)
    watch.timing = watch.newest_timing = dict.fromkeys((1, 2, 3, 4), timing)
    end = FlightEnd(failure=failure, flight_s=93.04)
    empty = summarize(load_scenario(PLATOON), "platoon", watch, end, smallest_m=1.2)
    wanted = {"1-2": 1.5, "2-3": 1.5, "3-4": 1.5, "1-4": 4.5}
    return msgspec.structs.replace(
        empty,
        law=law,
        duration_s=75.0,
        wanted_distance_m=wanted,
        max_distance_m={**wanted, "1-2": largest_m},
        settle_s=settle_s,
        final_error_m=0.012,
    )


def test_a_summary_is_read_back_unchanged(tmp_path: Path) -> None:
    before = summary("weighted", 1.78, 26.1)
    write_json(tmp_path / "summary.json", before)
    assert read_summary(tmp_path / "summary.json") == before
    content = msgspec.json.decode((tmp_path / "summary.json").read_bytes())
    assert content["schema"] == 1
    assert content["vehicles"][0]["tick"] == {
        "rate_hz": 49.996,
        "ticks": 2997,
        "missed": 3,
        "late_us": {"p50": 1, "p99": 2, "max": 3},
    }


@pytest.mark.parametrize(
    ("timing", "found"),
    [
        (msgspec.structs.replace(TIMING, missed=297), "9.0 % of the ticks missed (limit 0.5 %)"),
        (
            msgspec.structs.replace(TIMING, telemetry_to_command_us=Percentiles(300, 28_000, 30_000)),
            "28.0 ms from telemetry to command (p99, limit 5 ms)",
        ),
    ],
)
def test_an_overloaded_machine_is_reported(timing: Timing, found: str) -> None:
    flown = summary("average_22", 1.78, None, timing=timing)
    assert in_words(flown).splitlines()[-1] == (
        f"  the machine was too busy for real time: {found}; distrust the figures, or fly in virtual time: sitl run"
    )
    both = in_a_table(compare([summary("weighted", 1.78, 26.1), flown])).splitlines()
    assert both[-1].startswith("the machine was too busy for real time under average_22: distrust")


def test_an_idle_machine_is_not_reported() -> None:
    assert "busy" not in in_words(summary("weighted", 1.78, 26.1))


def test_the_largest_error_is_reported_when_the_reference_moves() -> None:
    moving = {"reference_moves": True, "largest_error_m": 0.24}
    line = (
        "  settled           never to 10 cm about a moving reference; at most 0.240 m off in the second half; "
        "final error 0.012 m"
    )
    flown = [msgspec.structs.replace(summary(law, 1.78, None), **moving) for law in ("weighted", "average_22")]
    assert line in in_words(flown[0]).splitlines()
    rows = {row.figure: row.values for row in compare(flown).rows}
    assert rows["largest error"] == {"weighted": 0.24, "average_22": 0.24}
    assert "settled to 10 cm" not in rows


@pytest.mark.parametrize(
    ("sensors", "text"),
    [("ideal", "never to 10 cm;"), ("default", "never to 10 cm, with the errors of the sensors (default);")],
)
def test_noise_is_named_where_a_flight_never_settles(sensors: str, text: str) -> None:
    flown = msgspec.structs.replace(summary("weighted", 1.78, None), sensors=sensors)
    assert f"  settled           {text} final error" in in_words(flown)


def test_a_flight_whose_slots_still_moved_has_not_arrived() -> None:
    watch = FlightWatch([1, 2], [1], 0.0)
    slot = FlownSlot((1.0, 0.0, 0.0), moves_for_s=43.2)
    nearly = FlownSlot((2.0, 0.0, 0.0), moves_for_s=0.05)
    for status in (with_fields(leader(), slot=slot), reported(2, slot=nearly)):
        watch.receive(StatusReport(status, TIMING), 50.0)
    watch.begin_formation()
    watch.end_formation(60.0)
    assert watch.under_way_s == {1: 43.2}
    lines = in_words(msgspec.structs.replace(summary("weighted", 1.78, 26.1), under_way_s={1: 43.2, 2: 8.0}))
    assert lines.splitlines() == [
        "platoon, weighted: did not arrive, landed in 93 s",
        "  formation         75.0 s",
        "  largest distance  1-2 1.78 m   2-3 1.50 m   3-4 1.50 m   (slots still on their way)",
        "  smallest distance 1.20 m, of any two in the whole flight",
        "  settled           never: the slots of vehicles 1, 2 were still on their way, for another 43 s; "
        "final error 0.012 m, to the slots on their way",
        "  control loop      50.00 Hz, 12 of 12000 ticks missed",
    ]


def test_wanted_distances_that_differ_are_in_the_order_of_their_pairs() -> None:
    wanted = {"1-2": 3.75, "2-3": 2.64, "3-4": 2.95, "1-4": 4.85}
    flown = msgspec.structs.replace(summary("weighted", 3.78, 26.1), wanted_distance_m=wanted)
    (line,) = [line for line in in_words(flown).splitlines() if "largest distance" in line]
    assert line.endswith("   (wanted 3.75, 2.64, 2.95 m)")


def test_a_long_chain_has_its_largest_distance_in_a_line_and_the_wanted_one_of_that_pair() -> None:
    pairs = {f"{i}-{i + 1}": 10.0 if i == 3 else 2.0 for i in range(1, 16)}
    flown = msgspec.structs.replace(
        summary("weighted", 1.78, 26.1), pairs=list(pairs), wanted_distance_m=pairs, max_distance_m=pairs
    )
    assert "  largest distance  at most 10.00 m, 3-4   (wanted 10.00 m)" in in_words(flown).splitlines()


@pytest.mark.parametrize(("factor", "times"), [(153.4, "153"), (4.23, "4.2"), (0.034, "0.034")])
def test_virtual_time_may_be_slower_than_real_time(factor: float, times: str) -> None:
    flown = msgspec.structs.replace(summary("weighted", 1.78, 26.1), real_time_factor=factor)
    assert in_words(flown).splitlines()[-1] == f"  virtual time      {times} times as fast as real time"


def test_the_summary_of_a_flight_is_printed_in_lines() -> None:
    assert in_words(summary("weighted", 1.784, 26.1)).splitlines() == [
        "platoon, weighted: flown and landed in 93 s",
        "  formation         75.0 s",
        "  largest distance  1-2 1.78 m   2-3 1.50 m   3-4 1.50 m   (wanted 1.50 m)",
        "  smallest distance 1.20 m, of any two in the whole flight",
        "  settled           26.1 s to 10 cm; final error 0.012 m",
        "  control loop      50.00 Hz, 12 of 12000 ticks missed",
    ]


def test_a_summary_says_on_whom_the_separation_filter_acted_and_how_long() -> None:
    """In formation alone: in a landing no law is judged. Without an action there is no line."""
    watch = FlightWatch([1, 2, 3], [1], 0.0)
    for number in range(20):
        changed = SeparationReport(None, 0.3 if 5 <= number < 12 else 0.01)
        phase = FlightPhase.FORMATION if number < 10 else FlightPhase.LAND
        for status in (leader(), reported(2, separation=changed, phase=phase), reported(3)):
            watch.receive(StatusReport(status, TIMING), 50.0 + 0.2 * number)
    assert watch.filter_acted_s == pytest.approx({2: 1.0})
    flown = summary("weighted", 1.78, 26.1)
    assert "separation filter" not in in_words(flown)
    vehicles = [msgspec.structs.replace(one, filter_acted_s=watch.filter_acted_s.get(one.id)) for one in flown.vehicles]
    lines = in_words(msgspec.structs.replace(flown, vehicles=vehicles)).splitlines()
    assert "  separation filter 2 1.0 s   (it changed what the law commanded)" in lines


def test_a_flight_that_failed_before_formation_is_one_line() -> None:
    watch = FlightWatch([1, 2, 3, 4], [1], 0.0)
    end = FlightEnd(failure="vehicle 2: no", flight_s=12.0)
    failed = summarize(load_scenario(PLATOON), "platoon", watch, end)
    assert in_words(failed) == "platoon, weighted: vehicle 2: no"
    assert failed.duration_s is None
    assert [vehicle.tick for vehicle in failed.vehicles] == [None] * 4


def test_the_best_of_each_row_is_marked() -> None:
    compared = compare([summary("weighted", 1.78, 26.1), summary("average_22", 1.85, None)])
    assert in_a_table(compared).splitlines() == [
        "platoon                       weighted    average_22",
        "largest distance 1-2 [m]       1.780 *       1.850",
        "largest distance 2-3 [m]       1.500 *       1.500 *",
        "largest distance 3-4 [m]       1.500 *       1.500 *",
        "smallest distance [m]          1.200 *       1.200 *",
        "settled to 10 cm [s]            26.1 *       never",
        "final error [m]                0.012 *       0.012 *",
        "* best",
    ]


def test_larger_is_better_for_the_smallest_distance() -> None:
    near = msgspec.structs.replace(summary("weighted", 1.78, 26.1), smallest_distance_m=0.9)
    rows = {row.figure: row for row in compare([near, summary("average_22", 1.85, None)]).rows}
    assert rows["smallest distance"].best == ["average_22"]


def test_a_comparison_is_read_back_unchanged(tmp_path: Path) -> None:
    compared = compare([summary("weighted", 1.78, 26.1), summary("average_22", 1.85, None)])
    write_json(tmp_path / "comparison.json", compared)
    assert msgspec.json.decode((tmp_path / "comparison.json").read_bytes(), type=Comparison) == compared


def test_another_law_changes_nothing_else() -> None:
    scenario = load_scenario(PLATOON)
    assert with_law(scenario, "average_26") == load_scenario(PLATOON, ["fleet.law.name=average_26"])
    assert with_law(scenario, "weighted") == scenario


def test_the_papers_laws_are_compared_with_the_same_gains_and_cooperative_has_its_own() -> None:
    scenario = load_scenario(PLATOON, ["fleet.law.parameters.velocity_gain_1_s=2", "fleet.law.parameters.exponent=3"])
    average, past = with_law(scenario, "average_22").fleet.law, with_law(scenario, "cooperative").fleet.law
    assert average.parameters == {"velocity_gain_1_s": 2}
    assert law_of(past) == cooperative()


# ---------------------------------------------------------------- the command line


def options(*arguments: str) -> FlightOptions:
    parser = argparse.ArgumentParser()
    FLY.add_arguments(parser)
    return flight_options(parser.parse_args(["s.yaml", *arguments]))


def test_the_command_line() -> None:
    assert options().others is None
    assert options("--compare").others == ("cooperative", "weighted", "average_22", "average_26")
    assert options("--compare", "average_26").others == ["average_26"]
    both = options("--law", "average_22", "--set", "a=1", "--set", "b=2")
    assert both.overrides == ["--law=average_22", "a=1", "b=2"]


@pytest.mark.parametrize("bad", ["-1", "x", "1.5", "50000"])
def test_an_invalid_port_offset_is_refused(bad: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        options(f"--port-offset={bad}")
    assert "expected a whole number from 0 to 40000" in capsys.readouterr().err
