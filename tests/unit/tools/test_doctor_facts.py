"""What the doctor passes on to the audit from the vehicle file."""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from types import SimpleNamespace

import pytest
from msgspec.structs import replace

from companion.config.fleet import GeodeticOrigin
from companion.config.vehicle import AgentConfig
from companion.core.safety.audit import Verdict
from companion.tools.doctor import DoctorSession
from companion.types.autopilot import AutopilotKind, VehicleState
from companion.types.notices import Code
from recordings import config

ORIGIN = GeodeticOrigin(latitude_deg=47.3977, longitude_deg=8.5456, altitude_amsl_m=488.0)
SLOT_IN_DEGREES = (47.397755, 8.545594, 0.0)
SINKS, FALLS = 0.0, 7.0  # of COM_OBL_RC_ACT: position mode without a pilot, disarm


class Parameters:
    """Of an autopilot that does this when setpoints end."""

    def __init__(self, loss_action: float) -> None:
        self._loss_action = loss_action

    async def read_all(self, names: Collection[str]) -> dict[str, float | None]:
        return {name: self._loss_action if name == "COM_OBL_RC_ACT" else None for name in names}


@pytest.mark.parametrize(
    ("loss_action", "accepts", "verdict"),
    [
        (SINKS, False, Verdict.REFUSAL),
        (SINKS, True, Verdict.WARNING),
        (FALLS, True, Verdict.REFUSAL),
    ],
)
def test_a_vehicle_file_that_accepts_an_uncontrolled_descent_makes_its_refusal_a_warning(
    loss_action: float, accepts: bool, verdict: Verdict, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("companion.tools.doctor.WINDOW_S", 0.0)
    monkeypatch.setattr("companion.tools.doctor.LISTEN_PERIOD_S", 0.0)
    agent, session = config(), DoctorSession.__new__(DoctorSession)  # without its sockets
    vehicle = replace(agent.vehicle, accept_uncontrolled_descent=accepts)
    fleet = replace(agent.fleet, vehicles=(replace(agent.member, slot_enu_m=SLOT_IN_DEGREES),), origin=ORIGIN)
    session.config = AgentConfig(vehicle, fleet, agent.member)
    session.link = SimpleNamespace(round_trip_s=0.001)  # type: ignore[assignment]
    session.tracker = SimpleNamespace(state=VehicleState(autopilot=AutopilotKind.PX4))  # type: ignore[assignment]
    session.parameters = Parameters(loss_action)  # type: ignore[assignment]
    diagnosis = asyncio.run(session.diagnose())
    (found,) = [finding for finding in diagnosis.findings if finding.subject == "COM_OBL_RC_ACT"]
    assert found.verdict is verdict
    (in_degrees,) = [finding for finding in diagnosis.findings if finding.code is Code.LOOKS_LIKE_DEGREES]
    assert (in_degrees.subject, in_degrees.verdict) == ("fleet file", Verdict.WARNING)
    assert in_degrees.found == "vehicles[0].slot_enu_m: [47.397755, 8.545594, 0.0] looks like latitude and longitude"
