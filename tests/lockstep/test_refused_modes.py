"""Autopilots that refuse to hold, or to land as well, in the middle of a formation flight with wind."""

from __future__ import annotations

import numpy as np
import pytest

from common import ROOT
from companion.types.autopilot import AutopilotKind
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from lockstep_fleet import CommandedFlight

SCENARIO = ROOT / "config" / "scenarios" / "leaving.yaml"
HOLD_MODE = {AutopilotKind.PX4: "LOITER", AutopilotKind.ARDUPILOT: "BRAKE"}
WIND = "stand_in.wind.mean_enu_m_s=[0, 3, 0]"


def refuses(kind: AutopilotKind, *modes: str) -> str:
    return f"stand_in.refusals=[{{vehicle: 5, at_s: 12, modes: [{', '.join((HOLD_MODE[kind], *modes))}]}}]"


def flown(kind: AutopilotKind, *modes: str) -> tuple[CommandedFlight, float]:
    """A flight whose last vehicle is told to hold, and when."""
    fleet = CommandedFlight(SCENARIO, f"stand_in.autopilot={kind}", WIND, refuses(kind, *modes))
    fleet.go_on(max(0.1, 13.0 - fleet.lockstep.now_s()))
    since_s = fleet.lockstep.now_s()
    fleet.give(CommandName.HOLD, 5)
    return fleet, since_s


def drifted_m(fleet: CommandedFlight, since_s: float) -> float:
    """How far vehicle 5 came in the plane from where it was then, in truth."""
    track = next(s for s in fleet.lockstep.stand_ins if s.vehicle_id == 5).track()
    path_m = track.at(np.arange(since_s, fleet.lockstep.now_s() - 0.1, 0.1))
    return float(np.linalg.norm(path_m[:, :2] - path_m[0, :2], axis=1).max())


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_a_refused_hold_becomes_a_landing(kind: AutopilotKind) -> None:
    fleet, since_s = flown(kind)
    fleet.until(5, FlightPhase.LAND, within_s=2.0)
    fleet.until(5, FlightPhase.OBSERVE)
    assert not fleet.newest[5].autopilot.armed
    assert drifted_m(fleet, since_s) < 1.0
    assert {fleet.newest[i].phase for i in (1, 2, 3, 4)} == {FlightPhase.FORMATION}


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_a_vehicle_whose_autopilot_refuses_to_land_as_well_comes_down_level(kind: AutopilotKind) -> None:
    fleet, since_s = flown(kind, "LAND", "RTL")
    fleet.until(5, FlightPhase.OBSERVE)
    assert not fleet.newest[5].autopilot.armed
    assert drifted_m(fleet, since_s) < 1.0
    assert {fleet.newest[i].phase for i in (1, 2, 3, 4)} == {FlightPhase.FORMATION}
