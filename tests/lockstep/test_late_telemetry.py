"""Telemetry at its full rate that arrives late, as from a full serial buffer."""

from __future__ import annotations

import pytest

from common import ROOT
from companion.types.autopilot import AutopilotKind
from companion.types.errors import CompanionError
from companion.types.flight import FlightPhase, HealthFlag
from lockstep_fleet import CommandedFlight

SCENARIO = ROOT / "config" / "scenarios" / "leaving.yaml"
PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT


def test_a_vehicle_whose_telemetry_is_always_late_is_not_prepared() -> None:
    with pytest.raises(CompanionError, match="POSITION_STALE"):
        CommandedFlight(SCENARIO, "links.telemetry_delay_s=0.2")


@pytest.mark.parametrize(
    ("kind", "delay_s"),
    [
        (ARDUPILOT, 0.15),
        (PX4, 1.0),
        *(
            pytest.param(*one, marks=pytest.mark.long)
            for one in [(PX4, 0.15), (PX4, 0.4), (ARDUPILOT, 0.4), (ARDUPILOT, 1.0)]
        ),
    ],
)
def test_a_vehicle_whose_telemetry_becomes_late_sends_no_setpoint_and_leaves(
    kind: AutopilotKind, delay_s: float
) -> None:
    late = f"{{vehicle: 3, from_s: 30, until_s: 40, delay_s: {delay_s}}}"
    fleet = CommandedFlight(SCENARIO, f"stand_in.autopilot={kind}", f"links.late_telemetry=[{late}]")
    assert fleet.lockstep.now_s() < 29.5
    fleet.go_on(30.0 - fleet.lockstep.now_s())
    since_s = fleet.lockstep.now_s()
    fleet.go_on(delay_s + 0.2)
    assert HealthFlag.POSITION_STALE in fleet.newest[3].safety.flags
    fleet.go_on(6.0)
    assert fleet.newest[3].phase is not FlightPhase.FORMATION
    assert fleet.smallest_m(since_s) > 1.5  # separation_m is 1, the slots are 2 m apart
    assert {fleet.newest[i].phase for i in (1, 2, 4, 5)} == {FlightPhase.FORMATION}
    fleet.go_on(6.0)
    assert HealthFlag.POSITION_STALE not in fleet.newest[3].safety.flags
    assert any(number == 3 and "s late" in text for number, text in fleet.events)


@pytest.mark.parametrize("percent", [pytest.param(-2.0, marks=pytest.mark.long), 2.0])
def test_a_clock_that_runs_slow_or_fast_is_no_delay(percent: float) -> None:
    fleet = CommandedFlight(SCENARIO, f"stand_in.clock_slow_percent={percent}")
    fleet.go_on(20.0)
    assert all(report.safety.flags == () for report in fleet.newest.values())
    assert {report.phase for report in fleet.newest.values()} == {FlightPhase.FORMATION}
