"""Formations that turn with the RFT's course, judged by where the leader points: a vehicle's place is r + R(heading) d_i0."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from math import degrees, remainder, sqrt, tau
from pathlib import Path

import numpy as np
import pytest
from commanded_flight import Flight

from companion.core.arrays import FloatArray
from companion.core.heading import JERK_1_S
from companion.geometry.turning import turn_limits
from companion.types import CommandName, FlightPhase, Heading, Role, Status
from companion.wire.ground import StatusReport
from sitl.director import Director
from sitl.fleet import ids_of
from sitl.lockstep import Lockstep
from sitl.metrics import SAMPLE_S, errors_m, pairs_of, reference_positions_m, smallest_distance_m
from sitl.progress import Progress
from sitl.scenario import Scenario, load_scenario, reference_of
from sitl.watch import FlightWatch

SCENARIOS = Path(__file__).parents[2] / "config" / "scenarios"
RING, COLUMN = "ring_figure_8.yaml", "turning_column.yaml"
COURSE = ("fleet.formation_heading=course", "fleet.law.name=cooperative")
LATE = ("links.peer_delay_s=0.1", "stand_in.sensors=default")
SETTLED_S = 20.0  # after the formation began: it has gone to its places, and has the course


class Recorder(FlightWatch):
    def __init__(self, scenario: Scenario) -> None:
        super().__init__(ids_of(scenario), [1], 0.0)
        self.heard: list[tuple[float, Status]] = []

    def hear(self, report: StatusReport, now_s: float) -> None:
        super().hear(report, now_s)
        self.heard.append((now_s, report.status))


class Flown:
    def __init__(self, file: str, *overrides: str) -> None:
        self.scenario = load_scenario(SCENARIOS / file, overrides)
        lockstep, self.watch = Lockstep(self.scenario), Recorder(self.scenario)
        self.headings: dict[int, list[tuple[float, Heading]]] = {}  # of every vehicle at every setpoint
        for vehicle_id, vehicle in lockstep._vehicles.items():
            told, follow, agent = self.headings.setdefault(vehicle_id, []), vehicle.link.command, vehicle._agent

            def command(target, now_s, told=told, follow=follow, agent=agent):  # type: ignore[no-untyped-def]
                told.append((now_s, agent._formation.heading.flown))
                follow(target, now_s)

            vehicle.link.command = command  # type: ignore[method-assign]
        director = Director(lockstep, self.watch, Progress("test", True, 0.0), lambda: None, tuple, lockstep)
        self.failures = director.fly_and_land(self.scenario.timeline)
        self.tracks = {s.vehicle_id: s.track() for s in lockstep.stand_ins}
        assert self.watch.formation is not None
        self.formation = self.watch.formation
        self.times_s = np.arange(self.formation.start_s + SETTLED_S, self.formation.end_s, SAMPLE_S)

    def led(self) -> list[tuple[float, Status]]:
        """What those said that led in formation, in order."""
        return [(at_s, s) for at_s, s in self.watch.heard if s.role is Role.LEADER and s.phase is FlightPhase.FORMATION]

    def headings_rad(self) -> FloatArray:
        """The leaders', by time."""
        angles = np.unwrap([s.heading.angle_rad for _, s in self.led()])
        return np.interp(self.times_s, [at_s for at_s, _ in self.led()], angles)

    def errors_m(self) -> dict[int, FloatArray]:
        """Each vehicle's distance to its place; its slot is that of the formation's own frame, as it said."""
        r_m = reference_positions_m(reference_of(self.scenario), self.formation.reference_start_s, self.times_s)
        c, s = np.cos(self.headings_rad()), np.sin(self.headings_rad())
        errors = {}
        for i, track in self.tracks.items():
            told = [(at_s, status.slot.position_enu_m) for at_s, status in self.watch.heard if status.vehicle_id == i]
            x, y, z = (np.interp(self.times_s, [at for at, _ in told], [d[k] for _, d in told]) for k in range(3))
            place_m = r_m + np.stack([c * x - s * y, s * x + c * y, z], axis=1)
            errors[i] = np.linalg.norm(track.at(self.times_s) - place_m, axis=1)
        return errors

    def smallest_m(self) -> float:
        at = {i: track.at(self.times_s) for i, track in self.tracks.items()}
        return min(float(np.linalg.norm(at[i] - at[j], axis=1).min()) for i, j in pairs_of(at))


@cache
def flown(file: str, *overrides: str) -> Flown:
    flight = Flown(file, *overrides)
    assert flight.failures == []
    return flight


def test_on_a_figure_8_it_points_where_it_goes() -> None:
    flight = flown(RING, *COURSE)
    reference = reference_of(flight.scenario)
    velocities = [reference(t - flight.formation.reference_start_s).velocity_enu_m_s for t in flight.times_s.tolist()]
    courses_rad = np.unwrap([np.arctan2(vy, vx) for vx, vy, _ in velocities])
    off_rad = np.remainder(flight.headings_rad() - courses_rad + np.pi, 2 * np.pi) - np.pi
    assert degrees(np.abs(off_rad).max()) < 15.0
    assert np.ptp(flight.headings_rad()) > np.pi  # it did turn


@pytest.mark.parametrize(("late", "most_m", "nearest_m"), [((), 0.12, 1.9), (LATE, 0.7, 1.6)])
def test_places_are_kept_while_it_turns_and_the_lead_changes_five_times(
    late: tuple[str, ...], most_m: float, nearest_m: float
) -> None:
    """Fixed, the same flight has the same errors: what turning adds is known beforehand."""
    flight, fixed = flown(RING, *COURSE, *late), flown(RING, "fleet.law.name=cooperative", *late)
    assert sum("follower -> leader" in event.event for event in flight.watch.events) == 5
    worst_m, worst_fixed_m = (max(e.max() for e in f.errors_m().values()) for f in (flight, fixed))
    assert worst_m < most_m
    assert worst_m < worst_fixed_m + 0.08
    assert flight.smallest_m() > nearest_m
    assert not any(any(status.rejected) for _, status in flight.watch.heard)


@pytest.mark.parametrize("late", [(), LATE])
def test_neither_attitudes_nor_the_heading_step_when_the_lead_changes(late: tuple[str, ...]) -> None:
    flight = flown(RING, *COURSE, *late)
    assert max(flight.watch.largest_step_deg.values()) < 5.0
    most_rad_s2 = turn_limits(sqrt(2.0), flight.scenario.fleet.slot_speed_m_s).acceleration_rad_s2
    for told in flight.headings.values():
        for (a_s, a), (b_s, b) in pairwise(told):
            assert remainder(b.angle_rad - a.angle_rad - a.rate_rad_s * (b_s - a_s), tau) == pytest.approx(
                0.0, abs=1e-3
            )
            assert abs(b.rate_rad_s - a.rate_rad_s) <= 1.01 * most_rad_s2 * (b_s - a_s)
            assert abs(b.acceleration_rad_s2 - a.acceleration_rad_s2) <= 1.01 * JERK_1_S * most_rad_s2 * (b_s - a_s)


def test_a_column_becomes_a_line_while_it_turns_on_a_circle() -> None:
    flight = flown(COLUMN, "stand_in.sensors=ideal")
    assert max(e.max() for e in flight.errors_m().values()) < 0.4
    assert flight.smallest_m() > 1.3  # slots that are 2 m apart come no nearer than 1.41 m on the way
    assert max(flight.watch.largest_step_deg.values()) < 5.0
    end = {i: status.slot for i in flight.tracks if (status := flight.watch.status(i))}
    assert sorted(round(slot.position_enu_m[1], 6) for slot in end.values()) == [-3.0, -1.0, 1.0, 3.0]
    assert all(slot.formation == 1 and slot.position_enu_m[0] == pytest.approx(0.0) for slot in end.values())


def test_with_noise_nobody_in_the_column_comes_within_the_separation() -> None:
    flight = flown(COLUMN)
    assert flight.smallest_m() > flight.scenario.fleet.separation_m


def test_who_left_joins_a_formation_that_goes_round() -> None:
    circle = "{kind: circle, centre_enu_m: [-8, 0, 2], radius_m: 8, period_s: 60}"
    turning = ("fleet.formation_heading=course", "fleet.slot_speed_m_s=1.5", "stand_in.sensors=ideal")
    flight = flown("leaving.yaml", *turning, f"timeline[6].reference={circle}", "timeline[10].for_s=20")
    joined_s = next(e.time_s for e in flight.watch.events if e.vehicle == 3 and e.event.startswith("has joined"))
    assert max(abs(s.heading.rate_rad_s) for at_s, s in flight.led() if at_s > joined_s) > 0.08  # 2 pi / 60 are 0.1
    assert max(flight.watch.largest_step_deg.values()) < 5.0
    smallest_m = smallest_distance_m(flight.tracks)
    assert smallest_m is not None
    assert smallest_m > 1.0
    times_s = np.arange(joined_s, flight.formation.end_s, SAMPLE_S)
    zero_s = flight.formation.reference_start_s
    r_m = reference_positions_m(flight.watch.told_reference(), zero_s, times_s)
    error_m = errors_m(flight.tracks[3], flight.watch.slots()[3], r_m, times_s)
    assert error_m.max() < 0.5


def test_who_holds_turns_at_once_to_the_heading_that_a_leader_begins_with() -> None:
    """A leader that landed begins to the east. Turning there as in flight would take those in hold ten seconds."""
    fleet = Flight(
        SCENARIOS / COLUMN, "fleet.separation_m=0.5"
    )  # straight ways from one heading to the other are narrow
    fleet.go_on(6.0)
    assert all(status.heading.angle_rad > 1.5 for status in fleet.newest.values())
    fleet.land(1)
    fleet.take_off_again(1)
    fleet.go_on(0.5)
    fleet.give(CommandName.FORM)
    for _ in range(10):
        fleet.go_on(0.3)
        angles_rad = [status.heading.angle_rad for status in fleet.newest.values()]
        assert max(angles_rad) - min(angles_rad) < 0.05
