"""What is said of flights: in words, in a table, in files."""

import argparse
from pathlib import Path

import msgspec
import pytest

from companion.assembly import law_of
from companion.core.formation import cooperative
from companion.wire.ground import Percentiles, Timing
from sitl.compare import Comparison, compare, in_a_table, with_law
from sitl.fly_options import FlyOptions, add_fly_arguments, fly_options
from sitl.run_options import RunOptions
from sitl.scenario import load_scenario
from sitl.summary import Summary, in_words, read_summary, summarize, write_json
from sitl.watch import FlightWatch

PLATOON = Path(__file__).parents[2] / "config" / "scenarios" / "platoon.yaml"
TIMING = Timing(49.996, 2997, 3, Percentiles(1, 2, 3), Percentiles(4, 5, 6), 5.0, 48.0)


def summary(law: str, largest_m: float, settle_s: float | None, failure: str | None = None) -> Summary:
    watch = FlightWatch([1, 2, 3, 4], [1], 0.0)
    watch.timing = dict.fromkeys((1, 2, 3, 4), TIMING)
    empty = summarize(load_scenario(PLATOON), "platoon", watch, None, None, 1.2, failure, 93.04)
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


def test_a_summary_survives_its_file(tmp_path: Path) -> None:
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


def test_a_machine_too_busy_for_real_time_is_said() -> None:
    vehicle = summary("weighted", 1.78, None).vehicles[0]
    tick = msgspec.structs.replace(vehicle.tick, missed=297)
    busy = {
        "9.0 % of the ticks missed": msgspec.structs.replace(vehicle, tick=tick),
        "28 ms from telemetry to command (p99)": msgspec.structs.replace(
            vehicle, telemetry_to_command_us=Percentiles(300, 28_000, 30_000)
        ),
    }
    for why, slow in busy.items():
        flown = msgspec.structs.replace(summary("average_22", 1.78, None), vehicles=[slow])
        assert in_words(flown).splitlines()[-1] == (
            f"  the machine was too busy for real time: {why}; distrust the figures, or fly in virtual time: sitl run"
        )
        both = in_a_table(compare([summary("weighted", 1.78, 26.1), flown])).splitlines()
        assert both[-1].startswith("the machine was too busy for real time under average_22: distrust")
    assert "busy" not in in_words(summary("weighted", 1.78, 26.1))


def test_a_flight_in_words() -> None:
    assert in_words(summary("weighted", 1.784, 26.1)).splitlines() == [
        "platoon, weighted: flown and landed in 93 s",
        "  formation         75.0 s",
        "  largest distance  1-2 1.78 m   2-3 1.50 m   3-4 1.50 m   (wanted 1.50 m)",
        "  smallest distance 1.20 m, of any two in the whole flight",
        "  settled           26.1 s to 10 cm; final error 0.012 m",
        "  control loop      50.00 Hz, 12 of 12000 ticks missed",
    ]


def test_a_flight_that_failed_before_any_formation() -> None:
    watch = FlightWatch([1, 2, 3, 4], [1], 0.0)
    failed = summarize(load_scenario(PLATOON), "platoon", watch, None, None, None, "vehicle 2: no", 12.0)
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


def test_a_comparison_survives_its_file(tmp_path: Path) -> None:
    compared = compare([summary("weighted", 1.78, 26.1), summary("average_22", 1.85, None)])
    write_json(tmp_path / "comparison.json", compared)
    assert msgspec.json.decode((tmp_path / "comparison.json").read_bytes(), type=Comparison) == compared


def test_another_law_changes_nothing_else() -> None:
    scenario = load_scenario(PLATOON)
    assert with_law(scenario, "average_26") == load_scenario(PLATOON, ["fleet.law.name=average_26"])
    assert with_law(scenario, "weighted") == scenario


def test_the_papers_laws_are_compared_with_the_same_gains_and_cooperative_has_its_own() -> None:
    scenario = load_scenario(PLATOON, ["fleet.law.gains.velocity_1_s=2", "fleet.law.exponent=3"])
    average, past = with_law(scenario, "average_22").fleet.law, with_law(scenario, "cooperative").fleet.law
    assert (average.gains.velocity_1_s, average.exponent) == (2.0, None)
    assert law_of(past) == cooperative()


# ---------------------------------------------------------------- the command line


def fly(*arguments: str) -> FlyOptions:
    parser = argparse.ArgumentParser()
    add_fly_arguments(parser)
    return fly_options(parser.parse_args(["s.yaml", *arguments]))


def options(*arguments: str) -> RunOptions:
    return fly(*arguments).run


def test_the_command_line() -> None:
    assert options().others is None
    assert options("--compare").others == ("cooperative", "weighted", "average_22", "average_26")
    assert options("--compare", "average_26").others == ["average_26"]
    both = options("--law", "average_22", "--set", "a=1", "--set", "b=2")
    assert both.overrides == ["fleet.law.name=average_22", "a=1", "b=2"]


@pytest.mark.parametrize("bad", ["-1", "x", "1.5", "50000"])
def test_a_port_offset_that_is_none(bad: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        options(f"--port-offset={bad}")
    assert "expected a whole number from 0 to 40000" in capsys.readouterr().err
