"""The common frame: different origins, new origins in flight, estimator resets, and refused fleets."""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import acos, degrees

import numpy as np
import pytest

from common import ROOT
from companion.geometry.frames import geodetic_from_enu, quaternion_from_euler
from companion.types.flight import Role
from companion.types.values import Vector3
from lockstep_fleet import director_of
from sitl.autopilots.autopilot import Autopilot
from sitl.flight.files import ids_of
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import Scenario, load_scenario, reference_of
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.flight.watch import FlightWatch
from sitl.report.metrics import formation_figures, stand_at
from sitl.report.progress import FlightProgress

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
COOPERATIVE = "fleet.law={name: cooperative}"
SHORT = "timeline[3].for_s=25"
APART = "origins_enu_m={1: [50, 0, 2], 2: [0, 50, -2], 3: [-50, 0, 1], 4: [0, -50, 0]}"
IN_FORMATION_S = 28.0
WIGGLE_DEG = 0.05  # of attitudes commanded in a formation that has settled


@dataclass
class Observed:
    """A whole flight: commands at 50 Hz, and true distances of the vehicles to their slots."""

    scenario: Scenario
    lockstep: Lockstep
    watch: FlightWatch
    times_s: list[float] = field(default_factory=list)
    wanted_euler_rad: list[list[Vector3]] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)

    def largest_step_deg(self, from_s: float, to_s: float) -> float:
        """Largest attitude step between consecutive commands of any vehicle."""
        return max(
            turn_deg(a, b)
            for time_s, before, now in zip(
                self.times_s[1:], self.wanted_euler_rad, self.wanted_euler_rad[1:], strict=False
            )
            if from_s <= time_s < to_s
            for a, b in zip(before, now, strict=True)
        )

    def final_error_m(self) -> float:
        assert self.watch.formation is not None
        slots_enu_m = {member.id: member.slot_enu_m for member in self.scenario.fleet.vehicles}
        tracks = {stand_in.vehicle_id: stand_in.track() for stand_in in self.lockstep.stand_ins}
        return formation_figures(
            tracks, stand_at(slots_enu_m), reference_of(self.scenario), self.watch.formation
        ).final_error_m

    def events_text(self) -> str:
        return "; ".join(event.event for event in self.watch.events)


def turn_deg(one: Vector3, other: Vector3) -> float:
    along = sum(a * b for a, b in zip(quaternion_from_euler(*one), quaternion_from_euler(*other), strict=True))
    return degrees(2.0 * acos(min(1.0, abs(along))))


def flown(*overrides: str, at_s: float = np.inf, do: Callable[[list[Autopilot]], None] | None = None) -> Observed:
    """Fly the platoon; `at_s` is the time of an intervention in its autopilots."""
    scenario = load_scenario(PLATOON, (COOPERATIVE, SHORT, *overrides))
    lockstep = Lockstep(scenario)
    leaders = [member.id for member in scenario.fleet.vehicles if member.role is Role.LEADER]
    observed = Observed(scenario, lockstep, FlightWatch(ids_of(scenario), leaders, lockstep.now_s()))
    autopilots = [stand_in.autopilot for stand_in in lockstep.stand_ins]
    done = False

    def look() -> None:
        nonlocal done
        if do and not done and lockstep.now_s() >= at_s:
            done = True
            do(autopilots)
        observed.times_s.append(lockstep.now_s())
        observed.wanted_euler_rad.append([autopilot.wanted_euler_rad() for autopilot in autopilots])

    director = director_of(lockstep, observed.watch, look)
    observed.failures = director.fly_and_land(scenario.timeline)
    assert done or do is None
    return observed


# ---------------------------------------------------------------- origins


@pytest.mark.parametrize(
    "more",
    [("fleet.altitude_source=origin",), ("fleet.altitude_source=takeoff",), ("stand_in.autopilot=ardupilot",)],
)
def test_origins_50_m_apart_give_the_same_formation(more: tuple[str, ...]) -> None:
    flight = flown(APART, *more)
    assert flight.failures == []
    assert flight.final_error_m() < 0.005


def test_errors_with_noisy_estimators_are_those_of_the_estimators() -> None:
    """The bound is 10 cm plus three sigma of the estimator error."""
    flight = flown(APART, "stand_in.sensors=default")
    assert flight.failures == []
    assert flight.final_error_m() < 0.10 + 3.0 * 0.08


def test_new_origins_in_flight_do_not_move_the_vehicles() -> None:
    def rebase(autopilots: list[Autopilot]) -> None:
        for index, autopilot in enumerate(autopilots):
            place = (40.0 - 30.0 * index, 25.0, 3.0 - index)
            autopilot.set_origin(geodetic_from_enu(place, autopilot.quad.world_origin))

    flight = flown(at_s=IN_FORMATION_S, do=rebase)
    assert flight.failures == []
    assert flight.largest_step_deg(IN_FORMATION_S - 1.0, IN_FORMATION_S + 10.0) < 0.3  # 1e-7 degrees are a centimetre
    assert flight.final_error_m() < 0.02
    assert "jumped" not in flight.events_text()


def test_an_origin_reported_late_does_not_move_the_vehicles() -> None:
    """PX4's message with the new origin may be lost. The agent then requests it when the position has jumped."""

    def rebase(autopilots: list[Autopilot]) -> None:
        autopilot = autopilots[1]
        changes = autopilot.origin_changes
        autopilot.set_origin(geodetic_from_enu((40.0, 25.0, 3.0), autopilot.quad.world_origin))
        autopilot.origin_changes = changes  # no message is sent

    flight = flown(at_s=IN_FORMATION_S, do=rebase)
    assert flight.failures == []
    assert flight.largest_step_deg(IN_FORMATION_S - 1.0, IN_FORMATION_S + 10.0) < 0.3
    assert flight.final_error_m() < 0.02
    assert "jumped" in flight.events_text()


# ---------------------------------------------------------------- resets


@pytest.mark.parametrize("shift", [(1.0, 0.0, 0.0), (0.0, -0.6, 0.8)])
def test_a_reset_of_a_metre_causes_no_step(shift: Vector3) -> None:
    reset = f"stand_in.estimator_resets=[{{vehicle: 2, at_s: {IN_FORMATION_S}, shift_enu_m: {list(shift)}}}]"
    flight = flown(reset)
    assert flight.failures == []
    assert flight.largest_step_deg(IN_FORMATION_S - 1.0, IN_FORMATION_S) < WIGGLE_DEG
    assert flight.largest_step_deg(IN_FORMATION_S, IN_FORMATION_S + 8.0) < 1.0
    assert "the autopilot's position jumped by 1.0 m" in flight.events_text()
    assert flight.final_error_m() == pytest.approx(1.0, abs=0.05)  # of a truth that the estimator does not know


def test_a_reset_beyond_the_limit_hands_over_with_an_event() -> None:
    reset = f"stand_in.estimator_resets=[{{vehicle: 2, at_s: {IN_FORMATION_S}, shift_enu_m: [0, 8, 0]}}]"
    flight = flown(reset)
    assert len(flight.failures) == 1
    assert "vehicle 2 left phase formation" in flight.failures[0]
    assert "POSITION_JUMPED" in flight.failures[0]
    held = flight.largest_step_deg(IN_FORMATION_S, IN_FORMATION_S + 0.5)
    assert held < 1.0  # until then it is flown on by the position that it had


# ---------------------------------------------------------------- before take-off and before forming


def failure_of(*overrides: str) -> str:
    scenario = load_scenario(PLATOON, (SHORT, *overrides))
    return fly_in_virtual_time(scenario, FlightProgress("test", True, 0.0)).failure or ""


def test_different_altitudes_on_the_ground_are_refused() -> None:
    failure = failure_of("starts_enu_m.3=[-3.0, 0.0, 1.6]", "timeline[1].timeout_s=8")
    assert "arm: altitude: on the ground vehicle 3 is 1.6 m above vehicle" in failure
    assert "ground_spread_m 1" in failure


def test_a_spacing_within_the_estimator_error_is_refused() -> None:
    failure = failure_of("stand_in.sensors={position_sd_m: [0.4, 0.4, 0.5]}", "timeline[3].timeout_s=3")
    assert "form: the slots of vehicles 1 and 2 are 1.5 m apart, 2.7 sigma of their estimators' errors" in failure


def test_a_spacing_near_the_estimator_error_is_flown_with_a_warning() -> None:
    flight = flown("stand_in.sensors={position_sd_m: [0.2, 0.2, 0.2]}", "timeline[3].for_s=2")
    assert flight.failures == []
    assert (
        "the slots of vehicles 1 and 2 are 1.5 m apart, 5.3 sigma of their estimators' errors; better 6"
        in flight.events_text()
    )
