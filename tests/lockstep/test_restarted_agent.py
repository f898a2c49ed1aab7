"""The leader's agent ends in formation and starts again 3 s later, with the sensors of PX4's own simulation."""

from __future__ import annotations

from functools import cache

import pytest

from common import ROOT
from companion.ground.changes import reference_change
from companion.types.autopilot import Arm, AutopilotKind, AutopilotRequest, RequestOrigin, RequestParameter
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, Role
from companion.types.status import Status
from lockstep_fleet import CommandedFlight
from sitl.gauntlet.flight import SENSOR_FACTOR

LEAVING = ROOT / "config" / "scenarios" / "leaving.yaml"
ENDS_S, RESTARTS_AFTER_S = 24.0, 3.0
BEFORE_S = 2.5  # the reference begins to move about 1 s later
FRESH_S = 0.3  # peers.max_age_s
OTHERS = (2, 3, 4, 5)
PARAMETERS = {AutopilotKind.PX4: "COM_OBL_RC_ACT: 5", AutopilotKind.ARDUPILOT: "GUID_OPTIONS: 8, GUID_TIMEOUT: 1"}
MAKES = pytest.mark.parametrize("make", list(AutopilotKind))


class RestartedLeader(CommandedFlight):
    """A column of five, 2 m apart. Where it moves, it flies along itself, through the place where the leader remains.

    `requests` are those of vehicle 1 since its agent started again.
    """

    def __init__(self, make: AutopilotKind, moves: bool = True) -> None:
        end = f"{{vehicle: 1, at_s: {ENDS_S}, restarts_after_s: {RESTARTS_AFTER_S}}}"
        super().__init__(
            LEAVING,
            "stand_in.sensors=px4_sih",
            f"stand_in.autopilot={make}",
            f"stand_in.parameters={{{PARAMETERS[make]}}}",
            "fleet.when_one_leaves=keep_gap",
            f"agent_ends=[{end}]",
        )
        assert self.lockstep.now_s() < ENDS_S - BEFORE_S
        self.statuses: list[tuple[float, Status]] = []
        self.requests: list[AutopilotRequest] = []
        self.until_s(ENDS_S - BEFORE_S)
        path = {"kind": "waypoints", "points_enu_m": [[0.0, 0.0, 2.0], [12.0, 0.0, 2.0]]}
        if moves:
            self.give(CommandName.REFERENCE, 1, 2, content=reference_change(path, list(self.newest.values())))
        self.until_s(ENDS_S + RESTARTS_AFTER_S)
        link = self.lockstep.vehicles[1].link
        follow = link.request

        def request(asked: AutopilotRequest, now_s: float) -> None:
            self.requests.append(asked)
            follow(asked, now_s)

        link.request = request  # type: ignore[method-assign]

    def until_s(self, time_s: float) -> None:
        """Go on until this time of the flight, and keep every status with the time of its report."""
        while self.lockstep.now_s() < time_s - 0.001:
            self.lockstep.sleep(0.02)
            for report in self.lockstep.drain():
                self.newest[report.status.agent.vehicle_id] = report.status
                self.statuses.append((self.lockstep.now_s(), report.status))

    def commanded_after_s(self) -> float:
        """When vehicle 1 sent its last setpoint, after the end of its agent."""
        return self.targets[1][-1][0] - ENDS_S


@cache
def observed(make: AutopilotKind) -> RestartedLeader:
    """8 s after the end, without a command."""
    flight = RestartedLeader(make)
    flight.until_s(ENDS_S + 8.0)
    return flight


@MAKES
def test_the_successor_stays_leader(make: AutopilotKind) -> None:
    flight = observed(make)
    assert {(s.leadership.role, s.leadership.epoch, s.phase) for s in flight.newest.values()} == {
        (Role.LEADER, 1, FlightPhase.FORMATION),
        (Role.FOLLOWER, 1, FlightPhase.FORMATION),
        (Role.FOLLOWER, 1, FlightPhase.OBSERVE),
    }
    led = [
        (at_s, s.agent.vehicle_id)
        for at_s, s in flight.statuses
        if s.leadership.role is Role.LEADER and s.leadership.epoch == 1
    ]
    assert {vehicle_id for _, vehicle_id in led} == {2}
    assert min(led)[0] - ENDS_S < 1.0
    stale = [s for _, s in flight.statuses if s.agent.session == 2 and s.leadership.role is Role.LEADER]
    assert len(stale) <= 2  # the role of its file, until it has fresh peers
    assert all(s.phase is FlightPhase.OBSERVE for s in stale)
    beacons = [
        p.leader.beacon
        for p in flight.packets
        if p.sender.vehicle_id != 1 and p.motion.sent_s > ENDS_S + RESTARTS_AFTER_S
    ]
    assert {beacon.leader_id for beacon in beacons if beacon} == {2}


@MAKES
def test_the_restarted_agent_observes(make: AutopilotKind) -> None:
    flight = observed(make)
    own = [s for _, s in flight.statuses if s.agent.session == 2]
    assert {s.phase for s in own} == {FlightPhase.OBSERVE}
    assert own[-1].autopilot.armed
    assert flight.commanded_after_s() <= 0.0
    assert {type(request) for request in flight.requests} <= {RequestOrigin, RequestParameter}


@MAKES
def test_the_others_use_its_position_at_once_and_nothing_else(make: AutopilotKind) -> None:
    flight = observed(make)
    first_s = min(p.motion.sent_s for p in flight.packets if p.sender.vehicle_id == 1 and p.sender.session == 2)
    assert first_s - ENDS_S - RESTARTS_AFTER_S < 1.2  # the origin follows a HEARTBEAT, which comes once a second
    for vehicle_id in OTHERS:
        after = [s for at_s, s in flight.statuses if s.agent.vehicle_id == vehicle_id and at_s > first_s + FRESH_S]
        assert all(1 in s.neighbourhood.peers and 1 not in s.neighbourhood.neighbours for s in after)
        assert not any("PEER_ID_TWICE" in code for code in after[-1].rejected)


@MAKES
def test_it_lands_by_command_and_the_others_pass_it(make: AutopilotKind) -> None:
    flight = RestartedLeader(make)
    flight.until_s(ENDS_S + 5.0)
    flight.give(CommandName.LAND, 1)
    flight.until_s(ENDS_S + 20.0)
    assert not flight.newest[1].autopilot.armed
    assert flight.newest[1].phase is FlightPhase.OBSERVE
    assert {flight.newest[i].phase for i in OTHERS} == {FlightPhase.FORMATION}
    assert flight.commanded_after_s() <= 0.0
    assert not any(isinstance(request, Arm) for request in flight.requests)
    assert flight.smallest_m(ENDS_S) >= SENSOR_FACTOR["px4_sih"] * flight.scenario.fleet.separation_m


@MAKES
def test_it_holds_and_forms_by_command_as_a_follower(make: AutopilotKind) -> None:
    flight = RestartedLeader(make, moves=False)
    flight.until_s(ENDS_S + 5.0)
    flight.give(CommandName.HOLD, 1)
    flight.until(1, FlightPhase.HOLD)
    while flight.newest[
        1
    ].safety.flags:  # until the next HEARTBEAT PX4 seems to be in the failsafe that the hold has ended
        flight.go_on(0.02)
    flight.give(CommandName.FORM, 1)
    flight.until(1, FlightPhase.FORMATION)
    flight.go_on(6.0)
    assert {i: (s.leadership.role, s.leadership.epoch) for i, s in flight.newest.items()} == {
        i: (Role.LEADER if i == 2 else Role.FOLLOWER, 1) for i in (1, *OTHERS)
    }
    assert flight.errors_m()[1] < 1.0
    assert flight.smallest_m(ENDS_S) >= SENSOR_FACTOR["px4_sih"] * flight.scenario.fleet.separation_m
