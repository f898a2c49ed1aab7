"""Agents of a fleet whose heights count from the take-off end in a hold and start again: one with what it kept, one without."""

from __future__ import annotations

from pathlib import Path

from companion.types.commands import CommandName
from companion.types.flight import FLAG_TEXTS, FlightPhase, HealthFlag, Role
from companion.types.status import Status
from lockstep_fleet import EnteringFleet, agent_of, scenario_of

LEADER, FOLLOWER = 1, 2
SLOTS = {LEADER: (0.0, 0.0, 0.0), FOLLOWER: (-3.0, 0.0, 0.0)}
POINT = {"kind": "point", "point_enu_m": [0.0, 0.0, 5.0]}
GROUND_M = 2.0  # above the origin
ENDS_S = 12.0


class Watched(EnteringFleet):
    """A pair in hold; `reports` has every status of the agents that started again."""

    def __init__(self, folder: Path) -> None:
        starts = {i: (x, y, GROUND_M) for i, (x, y, _) in SLOTS.items()}
        end = f"{{vehicle: {FOLLOWER}, at_s: {ENDS_S}, restarts_after_s: 0.5}}"
        self.scenario = scenario_of(
            folder,
            SLOTS,
            starts,
            POINT,
            "fleet.altitude_source=takeoff",
            "fleet.takeoff_height_m=2",
            f"agent_ends=[{end}]",
        )
        super().__init__(self.scenario)
        self.reports: dict[int, list[Status]] = {LEADER: [], FOLLOWER: []}

    def until_s(self, time_s: float) -> None:
        while self.lockstep.now_s() < time_s:
            self.go_on(0.1)
            for vehicle_id, reports in self.reports.items():
                if self.newest[vehicle_id].agent.session == 2:
                    reports.append(self.newest[vehicle_id])


def test_one_knows_its_height_and_the_other_says_that_it_must_land(tmp_path: Path) -> None:
    fleet = Watched(tmp_path)
    assert fleet.lockstep.now_s() < ENDS_S
    fleet.until_s(ENDS_S)
    before_m = fleet.newest[FOLLOWER].motion.position_enu_m[2]
    assert abs(before_m - 2.0) < 0.3  # above its own ground
    fleet.lockstep.vehicles[LEADER].agent = agent_of(fleet.scenario, LEADER, session=2)  # nothing is left of its disk
    fleet.until_s(ENDS_S + 3.0)
    known, lost = fleet.newest[FOLLOWER], fleet.newest[LEADER]
    assert abs(known.motion.position_enu_m[2] - before_m) < 0.3
    assert (known.phase, known.safety.flags) == (FlightPhase.OBSERVE, (HealthFlag.LEADER_LOST,))
    assert {status.leadership.role for status in fleet.reports[LEADER] if status.autopilot.armed} == {Role.FOLLOWER}
    assert not any(status.motion.is_known for status in fleet.reports[LEADER])
    assert HealthFlag.GROUND_UNKNOWN in lost.safety.flags
    assert (LEADER, FLAG_TEXTS[HealthFlag.GROUND_UNKNOWN]) in fleet.events
    assert not fleet.accepted(CommandName.FORM, LEADER)
    assert fleet.accepted(CommandName.LAND, LEADER)
    fleet.until_s(ENDS_S + 11.0)
    landed = fleet.newest[LEADER]
    assert (landed.autopilot.armed, landed.phase) == (False, FlightPhase.OBSERVE)
    assert abs(landed.motion.position_enu_m[2]) < 0.3
    assert HealthFlag.GROUND_UNKNOWN not in landed.safety.flags
    assert fleet.newest[FOLLOWER].autopilot.armed
