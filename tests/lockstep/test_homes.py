"""Returns end where the autopilots' homes are, which a ground station may have set, or at rally points."""

from __future__ import annotations

from math import dist

import pytest

from common import ROOT
from companion.types.autopilot import AutopilotKind
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from lockstep_fleet import CommandedFlight

C, P = CommandName, FlightPhase
BOTH = pytest.mark.parametrize(
    "kind", [AutopilotKind.PX4, pytest.param(AutopilotKind.ARDUPILOT, marks=pytest.mark.long)]
)
LINE = ROOT / "config" / "scenarios" / "four_in_line.yaml"
SOON_S = 12.0  # armed by then


def in_hold(kind: AutopilotKind, *overrides: str) -> CommandedFlight:
    fleet = CommandedFlight(LINE, f"stand_in.autopilot={kind}", *overrides)
    fleet.go_on(max(SOON_S + 2.0 - fleet.lockstep.now_s(), 1.0))
    fleet.give(C.HOLD)
    for vehicle_id in (1, 2, 3, 4):
        fleet.until(vehicle_id, P.HOLD)
    return fleet


def refusals(fleet: CommandedFlight, *ids: int) -> dict[int, Code | None]:
    """Code of the refusal of `return`; None where it was accepted."""
    replies = fleet.answers(C.RETURN, *ids)
    return {i: None if reply is None or reply.accepted else reply.code for i, reply in replies.items()}


def homes(*places: tuple[int, float, float]) -> str:
    items = ", ".join(f"{{vehicle: {i}, at_s: {SOON_S}, position_enu_m: [{x}, {y}, 0]}}" for i, x, y in places)
    return f"stand_in.homes=[{items}]"


@BOTH
def test_vehicles_with_one_home_do_not_return(kind: AutopilotKind) -> None:
    fleet = in_hold(kind, homes(*((i, -4.5, 6.0) for i in (1, 2, 3, 4))))
    assert set(refusals(fleet).values()) == {Code.HOME_SHARED}
    assert {status.phase for status in fleet.newest.values()} == {P.HOLD}


@BOTH
def test_a_vehicle_returns_to_the_home_that_a_ground_station_has_set(kind: AutopilotKind) -> None:
    """Also vehicle 4 may, whose home is still where it took off; vehicle 2 would fly over vehicle 3's place."""
    fleet = in_hold(kind, homes((1, 8.0, 9.0), (2, -9.0, 0.3)))
    assert refusals(fleet, 2) == {2: Code.HOME_SHARED}
    assert refusals(fleet, 1) == {1: None}
    fleet.until(1, P.OBSERVE, within_s=90.0)
    assert dist(fleet.newest[1].motion.position_enu_m[:2], (8.0, 9.0)) < 0.5


@BOTH
def test_a_vehicle_with_rally_points_does_not_return(kind: AutopilotKind) -> None:
    fleet = in_hold(kind, "stand_in.rally_points=[{vehicle: 3, position_enu_m: [-6, 9, 0]}]")
    assert refusals(fleet, 3, 4) == {3: Code.RETURNS_ELSEWHERE, 4: None}


@BOTH
def test_a_low_battery_lands_a_vehicle_that_must_not_return(kind: AutopilotKind) -> None:
    battery = "stand_in.batteries=[{vehicle: 4, at_s: 54, percent: 20}]"
    action = ("fleet.low_battery_action=return", "fleet.leave_below_percent=30")
    fleet = CommandedFlight(LINE, f"stand_in.autopilot={kind}", homes((4, -6.0, 0.0)), battery, *action)
    fleet.until(4, P.LAND, within_s=30.0)
    assert any("no return: home: the autopilots of vehicles 4 and 3" in text for _, text in fleet.events)
