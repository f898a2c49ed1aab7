"""A short run of the hostile input: the long one is `make hostile`."""

from collections import Counter
from random import Random
from typing import get_args

import pytest

from common import with_fields
from companion.config.fleet import EdgeNeighbours
from companion.mavlink.translator import Translator
from companion.types.autopilot import (
    AttitudeTarget,
    AutopilotKind,
    AutopilotMode,
    GroundSample,
    LandedState,
    PoseSample,
    Telemetry,
)
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from tests.fuzz import run
from tests.fuzz.decoders import decoders, fuzz
from tests.fuzz.episode import Outcome, fly
from tests.fuzz.fleet import Hostile, HostileFleet, fleet_config
from tests.fuzz.mavlink import HostileTelemetry, mavlink_packets
from tests.fuzz.plant import Plant
from tests.fuzz.run import EPISODE_TICKS, run_hostile

pytestmark = pytest.mark.long


@pytest.mark.parametrize("name", decoders())
def test_decoders_refuse_damaged_input_with_their_own_error(name: str) -> None:
    result = fuzz(name, 5000, seed=0)
    assert result.failures == []
    assert 0 < result.passed <= 5000


@pytest.mark.parametrize(
    ("seed", "vehicles", "besides"),
    [
        (0, 3, set()),
        (1, 3, {"command"}),
        (2, 6, {"telemetry"}),
        (3, 3, {"command", "telemetry"}),
        (5, 6, {"command"}),
    ],
)
def test_agents_withstand_hostile_input_of_every_kind(seed: int, vehicles: int, besides: set[str]) -> None:
    outcome = fly(seed)
    assert outcome.failures == []
    assert outcome.vehicles == vehicles
    assert outcome.passed["packet"] > 500
    assert set(outcome.passed) == {"packet", "target", "traffic"} | besides


def test_in_a_wide_chain_vehicles_are_received_at_5_hz_until_something_hostile_comes() -> None:
    fleet = HostileFleet(Random(5), is_chain=True, is_wide=True)
    for _ in range(10):
        fleet.tick()
    for name in (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF, CommandName.FORM):
        assert all(reply.accepted for reply in fleet.command(name).values())
        for _ in range(200 if name is CommandName.FORM else 80):
            fleet.tick()
    at_full_rate = {1, *fleet.config.successors}
    for i in fleet.agents:
        assert set(fleet.distant[i]) == fleet.agents.keys() - at_full_rate - {i - 1, i, i + 1}
    hold = with_fields(fleet.packets[5], sequence=fleet.packets[5].sender.sequence + 1, phase=FlightPhase.HOLD)
    for _ in range(11):  # the choice is made every 0.2 s
        fleet.tick(
            {i: Hostile([with_fields(hold, sequence=fleet.packets[5].sender.sequence + 1)]) for i in fleet.agents}
        )
    assert all(5 not in ids for i, ids in fleet.distant.items() if i != 5)


def test_a_chain_has_neighbours_beside_each_other_only() -> None:
    neighbours = fleet_config(Random(0), is_chain=True).neighbours
    assert isinstance(neighbours, EdgeNeighbours)
    assert neighbours.edges == ((1, 2), (2, 3), (3, 4), (4, 5), (5, 6))


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_every_sample_that_an_autopilot_can_send_is_among_the_packets(kind: AutopilotKind) -> None:
    translator = Translator(1, kind)
    samples = {type(sample) for packet in mavlink_packets() for sample in translator.telemetry(packet, 100.0)}
    assert samples == set(get_args(Telemetry)) - {GroundSample, PoseSample}  # which come from elsewhere


def test_hostile_telemetry_keeps_to_the_ids_that_an_agent_reads() -> None:
    plant, telemetry = Plant((1.0, 2.0, 3.0)), HostileTelemetry(Random(0), vehicle_id=3)
    samples = {type(sample) for _ in range(2000) for sample in telemetry.next(plant, 100.0)}
    assert samples == set(get_args(Telemetry))
    assert telemetry.refused["telemetry"] > 400  # of wrong ids, and invalid


def test_a_silent_agent_leaves_the_plant_to_its_failsafe() -> None:
    plant = Plant((0.0, 0.0, 3.0))
    plant.mode, plant.armed, plant.landed = AutopilotMode.OFFBOARD, True, LandedState.IN_AIR
    plant.move(AttitudeTarget(0.1, 0.0, 0.0, 0.5))
    for _ in range(49):
        plant.move(None)
    assert plant.mode is AutopilotMode.OFFBOARD
    for _ in range(2):
        plant.move(None)
    assert plant.mode is AutopilotMode.HOLD


def outcome_with(longest_tick_s: float, longest_tick: str) -> Outcome:
    return Outcome(
        seed=7,
        ticks=1,
        refused=Counter(),
        passed=Counter(),
        phases=Counter(),
        failures=[],
        vehicles=3,
        longest_tick_s=longest_tick_s,
        longest_tick=longest_tick,
        tick_seconds=longest_tick_s,
        most_objects=10,
    )


def test_a_tick_that_takes_too_long_is_a_finding_of_the_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    outcome = outcome_with(0.021, "vehicle 2 in hold")
    monkeypatch.setattr(run, "all_results", lambda *_: [[outcome]])
    assert run_hostile(inputs=0, ticks=0, seed=0, out=None) == 1
    assert "seed 7: a tick took 21.0 ms of CPU time: vehicle 2 in hold" in capsys.readouterr().out
    outcome.longest_tick_s = 0.019
    assert run_hostile(inputs=0, ticks=0, seed=0, out=None) == 0


@pytest.mark.parametrize(("seconds", "expected_s"), [([0.05, 0.004], 0.004), ([0.05, 0.04], 0.04), ([0.01], 0.01)])
def test_a_slow_machine_is_no_finding(monkeypatch: pytest.MonkeyPatch, seconds: list[float], expected_s: float) -> None:
    flown = [outcome_with(s, "") for s in seconds]
    monkeypatch.setattr(run, "fly", lambda _seed: flown.pop(0))
    (outcome,) = run.work(("", 7, 1))
    assert isinstance(outcome, Outcome)
    assert outcome.longest_tick_s == expected_s
    assert flown == []


def test_another_seed_flies_other_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    flown: list[list[int]] = []

    def collect(_workers: object, _work: object, jobs: list[run.Job], _show: object) -> list[object]:
        flown.append([seed for name, seed, _count in jobs if not name])
        return []

    monkeypatch.setattr(run, "all_results", collect)
    for seed in (0, 100):
        run_hostile(inputs=0, ticks=9 * EPISODE_TICKS, seed=seed, out=None)
    assert flown == [[0, 4, 8], [100, 104, 108]]
