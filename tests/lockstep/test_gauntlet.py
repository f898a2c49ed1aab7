"""Random flights in virtual time: reproducible, measured, and replayable from their scenario files."""

from __future__ import annotations

import argparse
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from common import ROOT
from companion.types.autopilot import AutopilotKind
from companion.types.commands import CommandName
from companion.types.errors import EXIT_DONE, UnusableError
from companion.types.flight import FlightPhase
from sitl.cli.studies import GAUNTLET
from sitl.flight.flights import FlightEnd, result_of
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import Scenario, load_scenario
from sitl.flight.virtual_flight import fly_in_virtual_time, fly_without_landing
from sitl.gauntlet.drawing import FAULTS_FROM, draw_flight, family_of, has_runaway, numbers_of
from sitl.gauntlet.families import FAMILIES
from sitl.gauntlet.faults import ALL_FAMILIES, FAULTS
from sitl.gauntlet.flight import UNDISTURBED_EVERY, Job, distances, fly
from sitl.gauntlet.liars import LIARS, NUMBERS, VECTORS_MOST
from sitl.gauntlet.real import draw_real, outcome_of
from sitl.gauntlet.search import read_search
from sitl.gauntlet.summary import write_worst
from sitl.report.metrics import Track
from sitl.report.progress import FlightProgress

FLEET = """
name: four
origin: indoor
law: {name: cooperative}
separation_m: 1.0
vehicles:
  - {id: 3, role: leader, slot_enu_m: [0, 0, 0]}
  - {id: 5, role: follower, slot_enu_m: [-2, 0, 0], may_lead: true}
  - {id: 8, role: follower, slot_enu_m: [-4, 0, 0]}
  - {id: 9, role: follower, slot_enu_m: [-6, 0, 0]}
neighbours: {kind: edges, edges: [[3, 5], [5, 8], [8, 9], [3, 8], [5, 9]]}
"""


def arguments(*given: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    GAUNTLET.add_arguments(parser)
    return parser.parse_args([*given, "--quiet"])


@pytest.mark.parametrize("number", list(islice(numbers_of(ALL_FAMILIES), len(ALL_FAMILIES))))
def test_seed_and_number_give_the_same_scenario(number: int) -> None:
    first, second = draw_flight(3, number), draw_flight(3, number)
    assert first == second
    assert first.scenario != draw_flight(4, number).scenario
    assert first.family == family_of(number)
    assert 4 <= len(first.scenario.fleet.vehicles) <= 12


def test_each_family_without_liars_has_runaways() -> None:
    numbers = islice(numbers_of(ALL_FAMILIES), 10 * len(ALL_FAMILIES))
    assert {family_of(number) for number in numbers if has_runaway(number)} == ALL_FAMILIES.keys() - LIARS.keys()
    flight = draw_flight(1, 9)
    assert [pilot.vehicle for pilot in flight.scenario.stand_in.pilots] == [flight.runaway]


def test_only_the_named_families_are_flown() -> None:
    numbers = numbers_of(("joining", "exchange"))
    assert {family_of(next(numbers)) for _ in range(6)} == {"joining", "exchange"}


def test_flights_without_faults_have_the_numbers_that_they_always_had() -> None:
    assert [family_of(number) for number in range(40)] == [list(FAMILIES)[number % 17] for number in range(40)]
    first = islice(numbers_of(ALL_FAMILIES), 2 * len(ALL_FAMILIES))
    assert sorted(number for number in first if number < FAULTS_FROM) == list(range(34))


def test_something_fails_in_each_flight_with_faults() -> None:
    for number in islice(numbers_of(FAULTS), 5 * len(FAULTS)):
        flight = draw_flight(1, number)
        stand_in, links, fleet = flight.scenario.stand_in, flight.scenario.links, flight.scenario.fleet
        leaves = [s for s in flight.scenario.timeline if s.command in ("hold", "land", "return") and s.vehicles]
        left = stand_in.pilots or stand_in.batteries or leaves
        found = {
            "hold_in_motion": left,
            "split_in_exchange": links.partitions,
            "short_split": links.partitions,
            "late_telemetry": links.late_telemetry,
            "lost_gps": stand_in.position_losses,
            "shared_home": stand_in.homes,
            "settings_at_bounds": fleet != draw_flight(1, number + len(FAULTS)).scenario.fleet,
        }
        assert found[flight.family], flight.scenario
        assert flight.handed_over or flight.family == "settings_at_bounds"


def test_liars_say_false_things_of_all_kinds_and_distances_to_them_do_not_count() -> None:
    flights = [draw_flight(1, number) for number in islice(numbers_of(LIARS), 200)]
    for flight in flights:
        liars = {lie.vehicle for lie in flight.scenario.links.lies}
        assert len(liars) == (1 if flight.family == "liar" else 2)
    lies = [lie for flight in flights for lie in flight.scenario.links.lies]
    others = {"position", "phase", "leader", "disarmed", "lost"}
    assert {lie.says for lie in lies} == others | NUMBERS.keys() | VECTORS_MOST.keys()
    assert {lie.kind for lie in lies} == {"constant", "drift", "jump", "swing", "mirror", "chase", "frozen"}


def test_ended_agents_start_again_but_those_of_some_px4() -> None:
    without = set()
    for number in islice(numbers_of(("leader_dies",)), 20):
        scenario = draw_flight(3, number).scenario
        (end,) = scenario.agent_ends
        if end.restarts_after_s is None:
            without.add(scenario.stand_in.autopilot)
        else:
            assert 2.0 <= end.restarts_after_s <= 6.0
    assert without == {AutopilotKind.PX4}


def test_a_flight_is_the_same_bit_for_bit_and_from_its_file(tmp_path: Path) -> None:
    small = (n for n in numbers_of(("leader_leaves",)) if len(draw_flight(5, n).scenario.fleet.vehicles) == 4)
    number = next(small)
    flown = fly(Job(5, number, "ideal"))
    assert not flown.exception
    assert flown.ratio is not None
    write_worst(tmp_path, [flown], "ideal", None)
    scenario = load_scenario(tmp_path / f"leader_leaves_{number}.yaml")
    again = distances(fly_without_landing(scenario, FlightProgress("test", True, 0.0)).stand_ins)
    assert again == flown.distances


def smallest_flight(family: str) -> int:
    """The flight without a runaway, and flown once, that takes least of the first numbers of a family."""
    numbers = (n for n in numbers_of((family,)) if n % UNDISTURBED_EVERY and not has_runaway(n))

    def ticks(number: int) -> float:
        flight = draw_flight(1, number, "ideal")
        return len(flight.scenario.fleet.vehicles) * flight.ends_s

    return min(islice(numbers, 6), key=ticks)


# Of each kind of disturbance one; `make test-long` flies the others.
IN_MAKE_TEST = {"form_crossing", "exchange", "leader_dies", "split_in_exchange", "hold_in_motion", "late_telemetry"}


@pytest.mark.parametrize(
    "family",
    [family if family in IN_MAKE_TEST else pytest.param(family, marks=pytest.mark.long) for family in ALL_FAMILIES],
)
def test_a_flight_of_each_family_violates_no_separation_and_ends_in_formation(family: str) -> None:
    outcome = fly(Job(1, smallest_flight(family), "ideal"))
    assert outcome.family == family
    assert (outcome.exception, outcome.failure) == ("", "")
    assert outcome.ratio is not None
    assert not outcome.violation, outcome.distances
    assert outcome.arrivals is not None
    assert bool(outcome.arrivals.expected) is (family not in LIARS)
    assert outcome.arrivals.not_in_formation == []


def test_the_command_flies_a_users_fleet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "fleet.yaml").write_text(FLEET)
    given = ["--fleet", str(tmp_path / "fleet.yaml"), "--out", str(tmp_path / "out"), "--flights", "2", "--jobs", "2"]
    code = GAUNTLET.run(arguments(*given, "--families", "form_near,reference_step", "--sensors", "ideal"))
    assert code == EXIT_DONE  # no violation and no exception
    assert (tmp_path / "out" / "gauntlet.json").exists()
    shown = capsys.readouterr().out
    assert "form_near" in shown
    assert "reference_step" in shown


@pytest.mark.long
def test_a_search_goes_on_and_keeps_the_worst_flights(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sitl.gauntlet.search.POPULATION", 2)
    monkeypatch.setattr("sitl.gauntlet.adversarial.KEPT", 1)
    given = ["--adversarial", "--families", "form_near", "--sensors", "ideal", "--seed", "5"]
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert GAUNTLET.run(arguments(*given, "--flights", "4", "--out", str(whole))) == EXIT_DONE
    assert GAUNTLET.run(arguments(*given, "--flights", "2", "--out", str(parts))) == EXIT_DONE
    resumed = arguments("--adversarial", "--seed", "5", "--flights", "4", "--resume", str(parts))
    assert GAUNTLET.run(resumed) == EXIT_DONE
    searches = [read_search(folder) for folder in (whole, parts)]
    found = [[point.score for point in search.worst(9)] for search in searches]
    assert found[0] == found[1] and searches[0].generation == 2
    shown = capsys.readouterr().out
    assert "4 flights in 2 generations" in shown
    (file,) = whole.glob("*.yaml")
    assert f"sitl run {file}" in shown
    assert [path.name for path in parts.glob("*.yaml")] == ["worst_1.yaml"]  # that of the first run was replaced
    ratio = searches[0].worst(1)[0].outcome.ratio
    flown = distances(fly_without_landing(load_scenario(file), FlightProgress("test", True, 0.0)).stand_ins)
    assert flown.commanded is not None and ratio is not None
    separation_m = load_scenario(file).fleet.separation_m
    assert flown.commanded.distance_m / separation_m == pytest.approx(ratio, abs=0.02 + 1e-3)


def test_an_unknown_family_is_refused() -> None:
    with pytest.raises(UnusableError, match="expected some of formation_change, form_near"):
        GAUNTLET.run(arguments("--families", "forming"))


@pytest.mark.parametrize(
    ("given", "refused"),
    [
        (("--adversarial", "--fleet", "fleet.yaml"), "--fleet: has no effect with --adversarial"),
        (("--rare", "all", "--families", "joining"), "--families: has no effect with --rare"),
        (("--resume", "runs/x", "--sensors", "ideal"), "--sensors: has no effect with --resume"),
        (("--rare", "platoons"), "--rare: 'platoons', expected some of platoon, exchange"),
    ],
)
def test_an_option_without_effect_is_refused(given: tuple[str, ...], refused: str) -> None:
    with pytest.raises(UnusableError, match=f"^{refused}"):
        GAUNTLET.run(arguments(*given))


def test_an_exception_in_an_agent_is_an_outcome(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError("in a tick")

    monkeypatch.setattr("sitl.gauntlet.flight.fly_without_landing", fails)
    outcome = fly(Job(1, 0))
    assert "ZeroDivisionError: in a tick" in outcome.exception
    assert outcome.ratio is None


def stand_in(vehicle_id: int, x_m: list[float], commanded: bool) -> SimpleNamespace:
    positions = np.array([[x, 0.0, 2.0] for x in x_m])
    flags = np.full(len(x_m), commanded)
    track = Track(0.02 * np.arange(len(x_m)), positions)
    flies = np.full(len(x_m), True)
    return SimpleNamespace(vehicle_id=vehicle_id, track=lambda: track, commanded=lambda: flags, flies=lambda: flies)


def test_pairs_count_where_an_agent_commands_at_least_one() -> None:
    stand_ins = [stand_in(1, [0.0, 0.0], True), stand_in(2, [3.0, 2.0], False), stand_in(3, [4.0, 2.5], False)]
    found = distances(stand_ins)  # type: ignore[arg-type]
    assert found.commanded is not None
    assert (found.commanded.vehicles, found.commanded.distance_m, found.commanded.time_s) == ((1, 2), 2.0, 0.02)
    assert found.automatic is not None
    assert (found.automatic.vehicles, found.automatic.distance_m) == ((2, 3), 0.5)


# ---------------------------------------------------------------- what scenarios can contain


def leaving(*overrides: str) -> Scenario:
    return load_scenario(ROOT / "config" / "scenarios" / "leaving.yaml", ["stand_in.sensors=ideal", *overrides])


STEPS = "{command: prepare}, {command: arm}, {command: takeoff}"


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_pilot_flies_one_vehicle_straight_on(autopilot: str) -> None:
    scenario = leaving(
        f"stand_in.autopilot={autopilot}",
        "stand_in.pilots=[{vehicle: 3, at_s: 14, velocity_enu_m_s: [0, 2, 0]}]",
        f"timeline=[{STEPS}, {{command: form, vehicles: [1], may_fail: true, at_s: 12, for_s: 7}}]",
    )
    flown = fly_without_landing(scenario, FlightProgress("test", True, 0.0))
    assert flown.failure is None
    track = flown.tracks()[3]
    (at_16, at_18) = track.at(np.array([16.0, 18.0]))
    assert np.allclose((at_18 - at_16) / 2.0, (0.0, 2.0, 0.0), atol=0.1)
    status = flown.watch.status(3)
    assert status is not None
    assert status.phase is FlightPhase.OBSERVE
    assert not flown.stand_ins[2].commanded().any()
    assert flown.stand_ins[0].commanded().any()


def test_a_partition_cuts_the_network_and_heals() -> None:
    scenario = leaving("links.partitions=[{vehicles: [4, 5], from_s: 3, until_s: 4}]", f"timeline=[{STEPS}]")
    lockstep = Lockstep(scenario)
    peers = {}
    for until_s in (2.9, 3.9, 4.9):
        lockstep.sleep(until_s - lockstep.now_s())
        newest = {report.status.agent.vehicle_id: report.status for report in lockstep.drain()}
        peers[until_s] = {i: status.neighbourhood.peers for i, status in newest.items()}
    assert peers[2.9] == peers[4.9] == {i: tuple(j for j in range(1, 6) if j != i) for i in range(1, 6)}
    assert peers[3.9] == {1: (2, 3), 2: (1, 3), 3: (1, 2), 4: (5,), 5: (4,)}


def test_an_agent_that_ends_reports_nothing() -> None:
    lockstep = Lockstep(leaving("agent_ends=[{vehicle: 2, at_s: 1}]", f"timeline=[{STEPS}]"))
    lockstep.sleep(1.0)
    assert 2 in {report.status.agent.vehicle_id for report in lockstep.drain()}
    lockstep.sleep(1.0)
    assert {report.status.agent.vehicle_id for report in lockstep.drain()} == {1, 3, 4, 5}


def test_a_restarted_agent_has_a_new_session_and_nothing_that_came_before() -> None:
    ends = "{vehicle: 2, at_s: 1, restarts_after_s: 0.5}, {vehicle: 2, at_s: 2, restarts_after_s: 0.5}"
    lockstep = Lockstep(leaving(f"agent_ends=[{ends}]", f"timeline=[{STEPS}]"))
    received = {}
    for at_s in (1.0, 1.5, 2.0, 2.5, 3.0):
        lockstep.sleep(at_s - lockstep.now_s())
        statuses = [report.status for report in lockstep.drain() if report.status.agent.vehicle_id == 2]
        received[at_s] = {status.agent.session for status in statuses}
        if at_s == 1.5:
            answer = lockstep.ask([2], CommandName.PREPARE, 0.01)[2]  # to the session that has ended
            assert answer is None
    assert received == {1.0: {1}, 1.5: set(), 2.0: {2}, 2.5: set(), 3.0: {3}}
    lockstep.sleep(1.0)  # a HEARTBEAT comes once a second
    answer = lockstep.ask([2], CommandName.PREPARE, 0.5)[2]
    assert answer is not None
    assert answer.reply.accepted
    statuses = [report.status for report in lockstep.drain() if report.status.agent.vehicle_id == 2]
    assert statuses[-1].neighbourhood.peers == (1, 3, 4, 5)
    assert statuses[-1].rejected == {}  # packets of the time without a process would be refused as late


def test_a_refused_step_that_may_fail_does_not_end_the_flight() -> None:
    crossing = "slots_enu_m: {1: [0, 0, 0], 2: [-8, 0, 0], 3: [-4, 0, 0], 4: [-6, 0, 0], 5: [-2, 0, 0]}"
    scenario = leaving(
        f"timeline=[{STEPS}, {{command: form, for_s: 3}},"
        f" {{command: formation, formation: {{{crossing}, speed_m_s: 20}}, may_fail: true, for_s: 1}}]"
    )
    flown = fly_without_landing(scenario, FlightProgress("test", True, 0.0))
    assert flown.failure is None
    assert {refusal.vehicle for refusal in flown.refusals} == {1, 2, 3, 4, 5}
    assert all(refusal.code for refusal in flown.refusals)


def test_a_reference_is_commanded_to_vehicles_that_may_lead() -> None:
    there = "{kind: point, point_enu_m: [1, 0, 2]}"
    scenario = leaving(
        f"timeline=[{STEPS}, {{command: form, for_s: 2}},"
        f" {{command: reference, reference: {there}, may_fail: true, for_s: 1}}]"
    )
    flown = fly_without_landing(scenario, FlightProgress("test", True, 0.0))
    assert flown.failure is None
    assert flown.refusals == []
    assert flown.watch.commands[-1].vehicles == [1, 2]


@pytest.mark.long
def test_a_flight_for_real_autopilots_takes_its_times_from_take_off() -> None:
    flight = next(draw_real(AutopilotKind.PX4, 1, ("formation_change",)))
    flown = fly_in_virtual_time(flight.scenario, FlightProgress("real", True, 0.0))
    end = FlightEnd(failure=flown.failure, flight_s=flown.flight_s)
    outcome = outcome_of(1, flight, result_of(flight.scenario, "real", flown.watch, flown.tracks(), end))
    assert (outcome.failure, outcome.violation) == ("", False)
    assert outcome.arrivals is not None and None not in outcome.arrivals.reached_s.values()
