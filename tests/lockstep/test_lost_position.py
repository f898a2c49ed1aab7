"""A vehicle of a column loses GPS and dead-reckons towards the one in front of it."""

from __future__ import annotations

import pytest

from common import ROOT
from companion.types.autopilot import AutopilotKind
from companion.types.flight import FlightPhase, HealthFlag
from lockstep_fleet import CommandedFlight

SCENARIO = ROOT / "config" / "scenarios" / "leaving.yaml"


@pytest.mark.parametrize(
    ("kind", "receiver"),
    [
        (AutopilotKind.PX4, "silent"),
        pytest.param(AutopilotKind.ARDUPILOT, "silent", marks=pytest.mark.long),
        (AutopilotKind.ARDUPILOT, "jammed"),
    ],
)
def test_a_vehicle_that_loses_gps_lands_before_it_has_drifted_far(kind: AutopilotKind, receiver: str) -> None:
    lost = f"{{vehicle: 3, at_s: 30, drift_enu_m_s2: [-0.05, 0, 0], receiver: {receiver}}}"
    fleet = CommandedFlight(SCENARIO, f"stand_in.autopilot={kind}", f"stand_in.position_losses=[{lost}]")
    assert fleet.lockstep.now_s() < 29.5
    fleet.go_on(30.0 - fleet.lockstep.now_s())
    since_s = fleet.lockstep.now_s()
    fleet.go_on(1.0)
    assert HealthFlag.POSITION_UNAIDED in fleet.newest[3].safety.flags
    fleet.until(3, FlightPhase.LAND, within_s=2.0)
    fleet.go_on(4.0)
    error = fleet.newest[3].motion.position_error
    assert error and error.horizontal_m > 1.0
    assert fleet.smallest_m(since_s) > 1.5  # separation_m is 1, the slots are 2 m apart
    assert {fleet.newest[i].phase for i in (1, 2, 4, 5)} == {FlightPhase.FORMATION}
