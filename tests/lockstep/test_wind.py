"""Wind and a wrong hover thrust with the full quadrotor: errors in formation, and hand-overs without a step.

Measured: errors of 0.1 m RMS with gusts, and none in steady wind. Without the observer they are 1.4 m, and 2.8 m with a wrong
hover thrust in addition.
"""

from dataclasses import dataclass
from functools import cache
from itertools import combinations, pairwise
from math import degrees, hypot

import numpy as np
import pytest

from common import ROOT
from companion.analysis.interaction import FloatArray
from companion.types.flight import FlightPhase
from companion.types.status import Status
from companion.wire.messages import StatusReport
from lockstep_fleet import director_of
from sitl.autopilots.px4.autopilot import Px4Mode
from sitl.flight.files import ids_of
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import Scenario, load_scenario, reference_of
from sitl.flight.watch import FlightWatch
from sitl.report.metrics import Formation, Track, errors_m, reference_positions_m, stand_at

SCENARIOS = ROOT / "config" / "scenarios"
TRUE_HOVER = 0.49
LOW, RIGHT, HIGH = 0.7, 1.0, 1.3  # the hover thrust that is assumed, as a share of the true one
OFF = "fleet.law.disturbance_bandwidth_1_s=0"
CALM = "stand_in.wind.gust_sd_m_s=0"
# The formation begins where it already is, and ends in the autopilot's own hold.
THEN_HOLD = (
    "timeline=[{command: prepare}, {command: arm}, {command: takeoff, for_s: 5}, {command: form, for_s: 20},"
    " {command: hold, for_s: 3}, {command: land}]"
)
HANDED_OVER_S = 0.1  # the attitude that is commanded, from before a change of mode to so long after it


@dataclass(frozen=True)
class Row:
    """Px4Mode and setpoint that one stand-in follows."""

    time_s: float
    mode: Px4Mode
    roll_rad: float
    pitch_rad: float
    thrust_norm: float
    rates_rad_s: tuple[float, float, float]
    altitude_m: float


class Recorder(FlightWatch):
    """Records every status in formation, and what each stand-in follows at that time."""

    def __init__(self, lockstep: Lockstep, scenario: Scenario) -> None:
        super().__init__(ids_of(scenario), [1], 0.0)
        self.received: list[Status] = []
        self.followed: dict[int, list[Row]] = {i: [] for i in ids_of(scenario)}
        for stand_in in lockstep.stand_ins:
            self._follow(stand_in)

    def receive(self, report: StatusReport, now_s: float) -> None:
        super().receive(report, now_s)
        if report.status.phase is FlightPhase.FORMATION:
            self.received.append(report.status)

    def _follow(self, stand_in):  # type: ignore[no-untyped-def]
        record, autopilot, rows = stand_in.record, stand_in.autopilot, self.followed[stand_in.vehicle_id]

        def recorded(now_s: float) -> None:
            record(now_s)
            roll, pitch, _ = autopilot.wanted_euler_rad()
            thrust, quad = autopilot.setpoint.thrust_norm, autopilot.quad
            mode, z = autopilot.mode, quad.position_enu_m[2]
            rows.append(Row(now_s, mode, roll, pitch, thrust, quad.rates_rad_s, z))

        stand_in.record = recorded


@dataclass(frozen=True)
class Flown:
    scenario: Scenario
    watch: Recorder
    tracks: dict[int, Track]

    @property
    def formation(self) -> Formation:
        assert self.watch.formation is not None
        return self.watch.formation

    def errors_m(self, from_s: float) -> FloatArray:
        """True distance to the slot (vehicles, times), from `from_s` after the start of the formation."""
        times_s = np.arange(self.formation.start_s + from_s, self.formation.end_s, 0.02)
        reference_m = reference_positions_m(reference_of(self.scenario), self.formation.reference_start_s, times_s)
        slots = {member.id: member.slot_enu_m for member in self.scenario.fleet.vehicles}
        return np.array([errors_m(track, stand_at(slots)[i], reference_m, times_s) for i, track in self.tracks.items()])

    def changes(self, before: Px4Mode, after: Px4Mode) -> list[tuple[list[Row], int]]:
        """The rows of each vehicle, and the index of the first in the new mode."""
        found = []
        for rows in self.watch.followed.values():
            changed = [k for k, (a, b) in enumerate(pairwise(rows), 1) if (a.mode, b.mode) == (before, after)]
            assert len(changed) == 1
            found.append((rows, changed[0]))
        return found

    def steps(self, before: Px4Mode, after: Px4Mode) -> list[tuple[float, float]]:
        """Step at the hand-over, for every vehicle."""
        return [step_of(rows, changed) for rows, changed in self.changes(before, after)]

    def rms_rate_deg_s(self, from_s: float) -> float:
        """RMS rate of roll and pitch in formation."""
        begin_s, end_s = self.formation.start_s + from_s, self.formation.end_s
        rates = [
            row.rates_rad_s[:2] for rows in self.watch.followed.values() for row in rows if begin_s < row.time_s < end_s
        ]
        return degrees(float(np.sqrt(np.mean(np.square(rates)))))


@cache
def flown(name: str, *overrides: str) -> Flown:
    scenario = load_scenario(SCENARIOS / f"{name}.yaml", overrides)
    lockstep = Lockstep(scenario)
    watch = Recorder(lockstep, scenario)
    director = director_of(lockstep, watch)
    assert director.fly_and_land(scenario.timeline) == []
    return Flown(scenario, watch, {s.vehicle_id: s.track() for s in lockstep.stand_ins})


def assuming(share: float) -> str:
    return f"assumed.hover_thrust_norm={TRUE_HOVER * share}"


def windy(share: float, *overrides: str) -> Flown:
    return flown("platoon_wind", THEN_HOLD, assuming(share), *overrides)


INTO_FORMATION, OUT_OF_FORMATION = (Px4Mode.LOITER, Px4Mode.OFFBOARD), (Px4Mode.OFFBOARD, Px4Mode.LOITER)


def step_of(rows: list[Row], changed: int) -> tuple[float, float]:
    """Difference (degrees, share of thrust) of the followed setpoints just before and after the change."""
    before, until_s = rows[changed - 1], rows[changed].time_s + HANDED_OVER_S
    after = [row for row in rows[changed:] if row.time_s <= until_s]
    tilt_rad = max(hypot(row.roll_rad - before.roll_rad, row.pitch_rad - before.pitch_rad) for row in after)
    thrust = max(abs(row.thrust_norm / before.thrust_norm - 1.0) for row in after)
    return degrees(tilt_rad), thrust


ASSUMED = pytest.mark.parametrize("assumed", [LOW, pytest.param(HIGH, marks=pytest.mark.long)])


# ---------------------------------------------------------------- what the formation keeps


@ASSUMED
def test_the_formation_keeps_its_slots_in_gusts(assumed: float) -> None:
    errors = flown("platoon_wind", assuming(assumed), "timeline[3].for_s=30").errors_m(from_s=5.0)
    assert np.sqrt(np.mean(errors**2, axis=1)).max() < 0.15
    assert errors.max() < 0.4


@ASSUMED
def test_steady_wind_leaves_no_error(assumed: float) -> None:
    assert windy(assumed, CALM).errors_m(from_s=10.0).max() < 0.01


def test_steady_wind_leaves_no_error_with_ardupilot() -> None:
    """ArduPilot reports and accepts thrust without tilt compensation."""
    copters = ("stand_in.autopilot=ardupilot", "stand_in.airframe.hover_thrust_norm=0.49", "timeline[1].timeout_s=60")
    flight = flown("platoon_wind", THEN_HOLD, *copters, assuming(LOW), CALM)
    assert flight.errors_m(from_s=10.0).max() < 0.01
    assert flight.watch.received[-1].control.hover_thrust_norm == pytest.approx(TRUE_HOVER, rel=0.01)


def test_wind_displaces_the_formation_without_the_observer() -> None:
    """This shows that the tests above are sensitive."""
    assert windy(RIGHT, CALM, OFF).errors_m(from_s=10.0).max() > 1.0
    assert windy(LOW, CALM, OFF).errors_m(from_s=10.0).max() > 1.5


@ASSUMED
def test_the_status_reports_hover_thrust_and_wind(assumed: float) -> None:
    status = windy(assumed, CALM).watch.received[-1]
    assert status.control.hover_thrust_norm == pytest.approx(TRUE_HOVER, rel=0.01)
    assert status.control.disturbance_enu_m_s2 == pytest.approx((0.25 * 6.5, 0.25 * 4.7, 0.0), abs=0.02)


# ---------------------------------------------------------------- hand-overs


@ASSUMED
def test_hand_overs_have_no_step(assumed: float) -> None:
    flight = windy(assumed, CALM)
    for before, after in (INTO_FORMATION, OUT_OF_FORMATION):
        for tilt_deg, thrust in flight.steps(before, after):
            assert tilt_deg < 5.0
            assert thrust < 0.05


@ASSUMED
def test_entering_formation_in_gusts_has_no_step(assumed: float) -> None:
    """The agent also leaves formation smoothly; but a hold that starts with a moving vehicle brakes at its own limit."""
    for tilt_deg, thrust in windy(assumed).steps(*INTO_FORMATION):
        assert tilt_deg < 5.0
        assert thrust < 0.05


@ASSUMED
def test_hand_overs_lose_no_altitude(assumed: float) -> None:
    for rows, changed in windy(assumed).changes(*INTO_FORMATION):
        altitude_m = rows[changed].altitude_m
        until_s = rows[changed].time_s + 5.0
        assert min(row.altitude_m for row in rows[changed:] if row.time_s < until_s) > altitude_m - 0.5


def test_an_immediate_formation_loses_no_altitude() -> None:
    """The climb alone is enough to estimate the hover thrust."""
    hurried = THEN_HOLD.replace("for_s: 5}", "for_s: 0}")
    for rows, changed in flown("platoon_wind", hurried, assuming(LOW), CALM).changes(*INTO_FORMATION):
        altitude_m = rows[changed].altitude_m
        assert min(row.altitude_m for row in rows[changed : changed + 250]) > altitude_m - 0.5


# ---------------------------------------------------------------- what it must not do


def test_the_observer_does_not_change_the_flight_in_still_air() -> None:
    """Known drag adds the same damping: the flight is the same within a centimetre, on the path and at the end."""
    still = ("fleet.law.name=cooperative", "stand_in.airframe.drag_n_per_m_s=0.5", "timeline[3].for_s=8")
    with_observer, without = (flown("platoon", *still, *off).errors_m(from_s=0.0) for off in ((), (OFF,)))
    count = min(with_observer.shape[1], without.shape[1])
    assert np.abs(with_observer[:, :count] - without[:, :count]).max() < 0.01


@pytest.mark.parametrize("sensors", ["default", pytest.param("px4_sih", marks=pytest.mark.long)])
def test_noise_increases_attitude_changes_only_slightly(sensors: str) -> None:
    """Measured: 3.1 -> 4.1 and 11.5 -> 15.2 deg/s RMS of roll and pitch rate; the commands vary by 4 % more."""
    noisy = (f"stand_in.sensors={sensors}", CALM)
    assert windy(RIGHT, *noisy).rms_rate_deg_s(5.0) < 1.4 * windy(RIGHT, *noisy, OFF).rms_rate_deg_s(5.0)


# ---------------------------------------------------------------- distances in gusts

TURNING_IN_GUSTS = (
    "fleet.law.name=cooperative",
    "fleet.formation_heading=course",
    "stand_in.airframe={drag_n_per_m_s: 0.25, motor_lag_s: 0.08}",
    "stand_in.armable_after_s=1",
    "timeline=[{command: prepare}, {command: arm}, {command: takeoff, for_s: 3}, {command: form, for_s: 22}]",
    "reference={kind: figure_8, centre_enu_m: [0, 0, 2], width_m: 12, height_m: 6, period_s: 30, ramp_s: 6}",
)
SPACING_M = 2.0
BY_THEN_S = 3.0  # in formation; the autopilots' own hold has let them drift together


@pytest.mark.long
@pytest.mark.parametrize(("gust_sd_m_s", "least"), [(2.0, 1.05), (3.0, 0.95)])
def test_a_turning_formation_keeps_its_distances_in_gusts(gust_sd_m_s: float, least: float) -> None:
    """The limit in docs/separation.md is 2 m/s: slots at 1.3 of separation_m, slow motors, 6 m/s of wind with gusts of 1 s."""
    wind = f"stand_in.wind={{mean_enu_m_s: [6, 0, 0], gust_sd_m_s: {gust_sd_m_s}, gust_time_s: 1}}"
    flight = flown("ring_figure_8", *TURNING_IN_GUSTS, f"fleet.separation_m={SPACING_M / 1.3:.3f}", wind)
    times_s = np.arange(flight.formation.start_s + BY_THEN_S, flight.formation.end_s, 0.02)
    at = [track.at(times_s) for track in flight.tracks.values()]
    nearest_m = min(float(np.linalg.norm(a - b, axis=1).min()) for a, b in combinations(at, 2))
    assert nearest_m > least * flight.scenario.fleet.separation_m
