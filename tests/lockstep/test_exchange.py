"""Exchanges of slots: straight paths meet, vehicles pass each other. True distances and the time into the slots."""

from __future__ import annotations

from math import cos, pi, sin
from pathlib import Path

import pytest

from common import ROOT
from companion.ground.changes import change_to
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from companion.types.values import Vector3
from lockstep_fleet import EnteringFleet, scenario_of
from sitl.flight.scenario import load_scenario
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.report.progress import FlightProgress

SEPARATION_M = 2.5
PAIR: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (-3.0, 0.0, 0.0)}
SQUARE: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (0.0, -3.0, 0.0), 3: (-3.0, -3.0, 0.0), 4: (-3.0, 0.0, 0.0)}
RING: dict[int, Vector3] = {i + 1: (3.0 * cos(i * pi / 3.0), 3.0 * sin(i * pi / 3.0), 0.0) for i in range(6)}
REACHED_M = 0.5
REST: dict[str, object] = {"kind": "point", "point_enu_m": [0.0, 0.0, 5.0]}


def opposite(slots: dict[int, Vector3]) -> dict[int, Vector3]:
    """Each vehicle in the slot of the one half way around."""
    n = len(slots)
    return {i: slots[(i - 1 + n // 2) % n + 1] for i in slots}


def fleet_of(
    folder: Path, slots: dict[int, Vector3], starts: dict[int, Vector3], law: str, *overrides: str
) -> EnteringFleet:
    settings = (f"fleet.law.name={law}", f"fleet.separation_m={SEPARATION_M}", *overrides)
    return EnteringFleet(scenario_of(folder, slots, starts, REST, *settings))


def reached_s(fleet: EnteringFleet, lasts_s: float) -> float:
    """Fly on for this long; the time after which all vehicles stay within REACHED_M of their slots."""
    began_s, late_s = fleet.lockstep.now_s(), 0.0
    while fleet.lockstep.now_s() - began_s < lasts_s:
        fleet.go_on(0.2)
        if max(fleet.errors_m().values()) > REACHED_M:
            late_s = fleet.lockstep.now_s() - began_s
    return late_s


def exchange(fleet: EnteringFleet, slots: dict[int, Vector3]) -> float:
    """Exchange slots in formation; the time to reach them, as a share of the duration of the change."""
    assert fleet.accepted(CommandName.FORM)
    fleet.go_on(4.0)
    change = change_to(opposite(slots), list(fleet.newest.values()), 1.0)
    replies = fleet.give(CommandName.FORMATION, content=change)
    for reply in replies.values():
        assert reply is not None
        assert (reply.accepted, reply.code) == (True, Code.FORMATION_ACCEPTED)
        assert "within 0.00 m" in reply.reason
    late_s = reached_s(fleet, 2.0 * change.lasts_s + 1.0)
    assert fleet.phases() == {FlightPhase.FORMATION}
    return late_s / change.lasts_s


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
@pytest.mark.parametrize("law", ["cooperative", "weighted"])
@pytest.mark.parametrize(("sensors", "share"), [pytest.param("ideal", 1.0, marks=pytest.mark.long), ("default", 0.8)])
def test_four_exchange_slots_crosswise(tmp_path: Path, law: str, autopilot: str, sensors: str, share: float) -> None:
    fleet = fleet_of(tmp_path, SQUARE, SQUARE, law, f"stand_in.sensors={sensors}", f"stand_in.autopilot={autopilot}")
    took = exchange(fleet, SQUARE)
    print(f"{law}, {autopilot}, {sensors}: {took:.2f} of the duration, smallest distance {fleet.smallest_m():.2f} m")
    assert took < 2.0
    assert fleet.smallest_m() >= share * SEPARATION_M


@pytest.mark.parametrize(
    ("law", "slots"),
    [
        ("cooperative", PAIR),
        ("weighted", PAIR),
        ("cooperative", RING),
        pytest.param("weighted", RING, marks=pytest.mark.long),
    ],
    ids=["cooperative-pair", "weighted-pair", "cooperative-ring", "weighted-ring"],
)
def test_slots_are_exchanged_with_the_opposite_vehicle(tmp_path: Path, law: str, slots: dict[int, Vector3]) -> None:
    fleet = fleet_of(tmp_path, slots, slots, law)
    took = exchange(fleet, slots)
    print(f"{len(slots)}, {law}: {took:.2f} of the duration, smallest distance {fleet.smallest_m():.2f} m")
    assert took < 2.0
    assert fleet.smallest_m() >= SEPARATION_M


@pytest.mark.parametrize("slots", [PAIR, SQUARE, RING], ids=["pair", "square", "ring"])
def test_vehicles_that_form_pass_each_other_with_a_warning(tmp_path: Path, slots: dict[int, Vector3]) -> None:
    fleet = fleet_of(tmp_path, slots, opposite(slots), "cooperative")
    replies = fleet.give(CommandName.FORM)
    assert all(reply and reply.accepted for reply in replies.values())
    assert {reply and reply.code for reply in replies.values()} == {Code.PATHS_CROSS}
    assert reached_s(fleet, 18.0) < 16.0
    assert fleet.phases() == {FlightPhase.FORMATION}
    assert fleet.smallest_m() >= SEPARATION_M


def test_a_vehicle_in_hold_is_in_the_way_of_an_exchange(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, SQUARE, SQUARE, "cooperative")
    assert fleet.accepted(CommandName.FORM, 1, 2, 3)
    fleet.go_on(2.0)
    change = change_to(opposite(SQUARE), list(fleet.newest.values()), 1.0)
    reply = fleet.give(CommandName.FORMATION, content=change)[1]
    assert reply is not None
    assert (reply.accepted, reply.code) == (False, Code.VEHICLE_IN_THE_WAY)


@pytest.mark.long  # in `make test` the tests of true tracks fly it
def test_the_shipped_exchange_is_flown() -> None:
    scenario = load_scenario(ROOT / "config" / "scenarios" / "exchange.yaml", ["stand_in.sensors=ideal"])
    flight = fly_in_virtual_time(scenario, FlightProgress("test", True, 0.0))
    assert flight.failure is None
    end = {i: flight.watch.slots()[i].position_enu_m[-1] for i in flight.tracks()}
    assert {i: (round(float(p[0])), round(float(p[1]))) for i, p in end.items()} == {
        1: (-3, -3),
        2: (-3, 0),
        3: (0, 0),
        4: (0, -3),
    }
