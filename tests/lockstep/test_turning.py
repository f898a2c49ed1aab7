"""Formations that turn with the course of the RFT: the slot of a vehicle is at r + R(heading) d_i0."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from math import degrees, remainder, sqrt, tau

import numpy as np
import pytest

from common import ROOT
from companion.analysis.interaction import FloatArray
from companion.core.reference.heading import JERK_1_S
from companion.geometry.formations import turn_limits
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, Role
from companion.types.status import Status
from lockstep_fleet import JUMP_M, CommandedFlight, Decisions, FlownScenario
from sitl.flight.scenario import load_scenario, reference_of
from sitl.report.metrics import SAMPLE_S, errors_m, reference_positions_m, smallest_distance_m

SCENARIOS = ROOT / "config" / "scenarios"
RING, COLUMN = "ring_figure_8.yaml", "turning_column.yaml"
SOON = tuple(f"timeline[{step}].for_s=8" for step in range(4, 9))  # leaders change twice as often as in the scenario
FIXED = (*SOON, "fleet.law.name=cooperative")
COURSE = (*FIXED, "fleet.formation_heading=course")
LATE = ("links.peer_delay_s=0.1", "stand_in.sensors=default")
SETTLED_S = 20.0  # after the start of the formation: vehicles are at their slots, and the heading is the course


class Flown(FlownScenario):
    def __init__(self, file: str, *overrides: str) -> None:
        super().__init__(load_scenario(SCENARIOS / file, overrides))
        self.times_s = np.arange(self.formation.start_s + SETTLED_S, self.formation.end_s, SAMPLE_S)

    def record(self) -> None:
        self.decisions = Decisions(self.lockstep)

    def led(self) -> list[tuple[float, Status]]:
        """Reports of leaders in formation, in order."""
        return [
            (at_s, s)
            for at_s, s in self.watch.reports
            if s.leadership.role is Role.LEADER and s.phase is FlightPhase.FORMATION
        ]

    def headings_rad(self) -> FloatArray:
        """Headings of the leaders over time."""
        angles = np.unwrap([s.formation.heading.angle_rad for _, s in self.led()])
        return np.interp(self.times_s, [at_s for at_s, _ in self.led()], angles)

    def errors_m(self) -> dict[int, FloatArray]:
        """Distance of each vehicle to its slot; slots are in the frame of the formation, as reported."""
        r_m = reference_positions_m(reference_of(self.scenario), self.formation.reference_start_s, self.times_s)
        c, s = np.cos(self.headings_rad()), np.sin(self.headings_rad())
        errors = {}
        for i, track in self.tracks.items():
            recorded = [
                (at_s, status.formation.slot.position_enu_m)
                for at_s, status in self.watch.reports
                if status.agent.vehicle_id == i
            ]
            x, y, z = (
                np.interp(self.times_s, [at for at, _ in recorded], [d[k] for _, d in recorded]) for k in range(3)
            )
            place_m = r_m + np.stack([c * x - s * y, s * x + c * y, z], axis=1)
            errors[i] = np.linalg.norm(track.at(self.times_s) - place_m, axis=1)
        return errors


@cache
def flown(file: str, *overrides: str) -> Flown:
    flight = Flown(file, *overrides)
    assert flight.failures == []
    return flight


def test_the_formation_points_along_the_figure_8() -> None:
    flight = flown(RING, *COURSE)
    reference = reference_of(flight.scenario)
    velocities = [reference(t - flight.formation.reference_start_s).velocity_enu_m_s for t in flight.times_s.tolist()]
    courses_rad = np.unwrap([np.arctan2(vy, vx) for vx, vy, _ in velocities])
    off_rad = np.remainder(flight.headings_rad() - courses_rad + np.pi, 2 * np.pi) - np.pi
    assert degrees(np.abs(off_rad).max()) < 15.0
    assert np.ptp(flight.headings_rad()) > np.pi  # it did turn


@pytest.mark.parametrize(
    ("late", "most_m", "nearest_m"), [((), 0.12, 1.9), pytest.param(LATE, 0.7, 1.6, marks=pytest.mark.long)]
)
def test_slots_are_kept_while_turning_with_five_leader_changes(
    late: tuple[str, ...], most_m: float, nearest_m: float
) -> None:
    """Turning is known in advance, so the errors equal those of the same flight with a fixed heading."""
    flight, fixed = flown(RING, *COURSE, *late), flown(RING, *FIXED, *late)
    assert sum("follower -> leader" in event.event for event in flight.watch.events) == 5
    worst_m, worst_fixed_m = (max(e.max() for e in f.errors_m().values()) for f in (flight, fixed))
    assert worst_m < most_m
    assert worst_m < worst_fixed_m + 0.08
    assert flight.smallest_m(SETTLED_S) > nearest_m
    assert not any(any(status.rejected) for _, status in flight.watch.reports)


@pytest.mark.parametrize("late", [(), pytest.param(LATE, marks=pytest.mark.long)])
def test_slots_references_and_heading_have_no_step_at_leader_changes(late: tuple[str, ...]) -> None:
    flight = flown(RING, *COURSE, *late)
    assert flight.decisions.jump_m() < JUMP_M
    most_rad_s2 = turn_limits(sqrt(2.0), flight.scenario.fleet.slot_speed_m_s).acceleration_rad_s2
    for decisions in flight.decisions.of_vehicle.values():
        sent = [decided for decided in decisions if decided.setpoint.target]
        in_formation = [(d.now_s, d.guidance.heading) for d in sent if d.now_s < flight.formation.end_s]
        for (a_s, a), (b_s, b) in pairwise(in_formation):
            assert remainder(b.angle_rad - a.angle_rad - a.rate_rad_s * (b_s - a_s), tau) == pytest.approx(
                0.0, abs=1e-3
            )
            assert abs(b.rate_rad_s - a.rate_rad_s) <= 1.01 * most_rad_s2 * (b_s - a_s)
            assert abs(b.acceleration_rad_s2 - a.acceleration_rad_s2) <= 1.01 * JERK_1_S * most_rad_s2 * (b_s - a_s)


@pytest.mark.long
def test_a_column_changes_to_a_line_while_turning_on_a_circle() -> None:
    flight = flown(COLUMN, "stand_in.sensors=ideal")
    assert max(e.max() for e in flight.errors_m().values()) < 0.4
    assert flight.smallest_m(SETTLED_S) > 1.3  # slots that are 2 m apart keep 1.41 m or more during the change
    assert flight.decisions.jump_m() < JUMP_M
    end = {i: status.formation.slot for i in flight.tracks if (status := flight.watch.status(i))}
    assert sorted(round(slot.position_enu_m[1], 6) for slot in end.values()) == [-3.0, -1.0, 1.0, 3.0]
    assert all(slot.formation == 1 and slot.position_enu_m[0] == pytest.approx(0.0) for slot in end.values())


@pytest.mark.long
def test_the_column_keeps_the_separation_with_noise() -> None:
    flight = flown(COLUMN)
    assert flight.smallest_m(SETTLED_S) > flight.scenario.fleet.separation_m


def test_a_vehicle_rejoins_a_turning_formation() -> None:
    circle = "{kind: circle, centre_enu_m: [-8, 0, 2], radius_m: 8, period_s: 60}"
    turning = ("fleet.formation_heading=course", "fleet.slot_speed_m_s=1.5", "stand_in.sensors=ideal")
    flight = flown("leaving.yaml", *turning, f"timeline[6].reference={circle}", "timeline[10].for_s=20")
    joined_s = next(e.time_s for e in flight.watch.events if e.vehicle == 3 and e.event.startswith("has joined"))
    assert (
        max(abs(s.formation.heading.rate_rad_s) for at_s, s in flight.led() if at_s > joined_s) > 0.08
    )  # 2 pi / 60 are 0.1
    assert flight.decisions.jump_m() < JUMP_M
    smallest_m = smallest_distance_m(flight.tracks)
    assert smallest_m is not None
    assert smallest_m > 1.0
    times_s = np.arange(joined_s, flight.formation.end_s, SAMPLE_S)
    zero_s = flight.formation.reference_start_s
    r_m = reference_positions_m(flight.watch.reported_reference(), zero_s, times_s)
    error_m = errors_m(flight.tracks[3], flight.watch.slots()[3], r_m, times_s)
    assert error_m.max() < 0.5


def test_a_vehicle_in_hold_turns_to_the_heading_of_a_new_leader() -> None:
    """A leader that landed restarts with heading east. Vehicles in hold must not turn at the limited rate, for ten seconds."""
    fleet = CommandedFlight(
        SCENARIOS / COLUMN, "fleet.separation_m=0.5"
    )  # straight paths between two headings are narrow
    fleet.go_on(6.0)
    assert all(status.formation.heading.angle_rad > 1.5 for status in fleet.newest.values())
    fleet.land(1)
    fleet.take_off_again(1)
    fleet.go_on(0.5)
    fleet.give(CommandName.FORM)
    for _ in range(10):
        fleet.go_on(0.3)
        angles_rad = [status.formation.heading.angle_rad for status in fleet.newest.values()]
        assert max(angles_rad) - min(angles_rad) < 0.05
