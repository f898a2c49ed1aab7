"""A failsafe of the autopilot itself, whose action there is to warn: the fleet's low_battery_action follows."""

from __future__ import annotations

import pytest

from common import ROOT
from companion.types.autopilot import AutopilotKind
from companion.types.flight import FlightPhase, HealthFlag
from lockstep_fleet import CommandedFlight

SCENARIO = ROOT / "config" / "scenarios" / "leaving.yaml"


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (AutopilotKind.PX4, "MAV_STATE_CRITICAL"),
        (AutopilotKind.ARDUPILOT, "Battery Failsafe"),
    ],  # PX4 sends an agent no texts
)
def test_a_vehicle_whose_autopilot_reports_a_failsafe_lands(kind: AutopilotKind, words: str) -> None:
    failsafe = "{vehicle: 3, at_s: 30, until_s: 50}"
    fleet = CommandedFlight(SCENARIO, f"stand_in.autopilot={kind}", f"stand_in.failsafes=[{failsafe}]")
    fleet.go_on(30.5 - fleet.lockstep.now_s())
    assert HealthFlag.FAILSAFE_ACTIVE in fleet.newest[3].safety.flags
    assert any(number == 3 and words in event for number, event in fleet.events)
    fleet.go_on(2.0)
    assert fleet.newest[3].phase is FlightPhase.FORMATION
    fleet.until(3, FlightPhase.LAND, within_s=6.0)
    assert {fleet.newest[i].phase for i in (1, 2, 4, 5)} == {FlightPhase.FORMATION}


def test_a_failsafe_is_reported_by_heartbeat_alone() -> None:
    failsafe = "{vehicle: 3, at_s: 30, text: no word of it}"
    fleet = CommandedFlight(SCENARIO, f"stand_in.failsafes=[{failsafe}]")
    fleet.go_on(31.5 - fleet.lockstep.now_s())
    assert HealthFlag.FAILSAFE_ACTIVE in fleet.newest[3].safety.flags
