"""The own local frame in the fleet's: whichever message tells of it, and when it changes."""

from dataclasses import dataclass, field
from math import nan

import pytest

from companion.core.bumpless import LET_IN_M_S
from companion.core.vehicle_state import VehicleTracker
from companion.frames import geodetic_from_enu
from companion.types import (
    AutopilotKind,
    EstimatorSample,
    GlobalPositionSample,
    HeartbeatSample,
    LandedSample,
    LandedState,
    OriginSample,
    PositionError,
    PositionSample,
    Telemetry,
    Vector3,
    VehicleState,
)

FLEET = (47.397742, 8.545594, 488.0)


@dataclass
class Autopilot:
    """At `true_m` in the fleet frame, with a local frame that begins at `origin_m`; what it tells, 50 times a second."""

    tracker: VehicleTracker
    true_m: Vector3 = (3.0, 4.0, 5.0)
    origin_m: Vector3 = (50.0, -20.0, 2.0)
    armed: bool = True
    landed: LandedState = LandedState.IN_AIR
    now_s: float = 0.0
    used: list[Vector3] = field(default_factory=list)

    def origin(self) -> OriginSample:
        return OriginSample(self.now_s, *geodetic_from_enu(self.origin_m, FLEET))

    def position(self) -> PositionSample:
        x, y, z = (a - o for a, o in zip(self.true_m, self.origin_m, strict=True))
        return PositionSample(self.now_s, self.now_s, (x, y, z), (0.0, 0.0, 0.0))

    def global_position(self, off_m: float = 0.0) -> GlobalPositionSample:
        x, y, z = self.true_m
        return GlobalPositionSample(self.now_s, self.now_s, *geodetic_from_enu((x + off_m, y, z), FLEET))

    def tell(self, *more: Telemetry, ticks: int = 1) -> VehicleState:
        state = self.tracker.state
        for _ in range(ticks):
            self.now_s += 0.02
            status = (HeartbeatSample(self.now_s, self.armed, AutopilotKind.PX4), LandedSample(self.now_s, self.landed))
            state = self.tracker.fold([*status, *more, self.position()])
            self.used.append(state.position_enu_m)
        return state


def flying(*, from_takeoff: bool = False) -> Autopilot:
    return Autopilot(VehicleTracker(FLEET, from_takeoff))


# ---------------------------------------------------------------- which message


def test_without_an_origin_the_global_position_tells_of_it() -> None:
    autopilot = flying()
    autopilot.tell()
    for _ in range(4):
        assert not autopilot.tell(autopilot.global_position()).frame_known
    state = autopilot.tell(autopilot.global_position())
    state = autopilot.tell()
    assert state.frame_known
    assert state.position_enu_m == pytest.approx((3.0, 4.0, 5.0), abs=1e-6)
    assert state.altitude_amsl_m == pytest.approx(493.0)


def test_one_that_scatters_tells_nothing() -> None:
    autopilot = flying()
    autopilot.tell()
    for index in range(20):
        autopilot.tell(autopilot.global_position(off_m=float(index % 3)))
    assert not autopilot.tracker.state.frame_known


def test_no_fix_is_no_place() -> None:
    autopilot = flying()
    autopilot.tell()
    nowhere = GlobalPositionSample(autopilot.now_s, autopilot.now_s, 0.0, 0.0, 0.0)
    for _ in range(10):
        autopilot.tell(nowhere)
    assert not autopilot.tracker.state.frame_known
    assert autopilot.tracker.rejected["global position not plausible"] > 0


def test_an_origin_that_the_global_position_contradicts_is_not_trusted() -> None:
    autopilot = flying()
    autopilot.tell(autopilot.origin())
    for _ in range(5):
        assert not autopilot.tracker.state.frame_contradicted
        autopilot.tell(autopilot.global_position(off_m=3.0))
    assert autopilot.tell().frame_contradicted
    assert not autopilot.tell(autopilot.global_position(), ticks=2).frame_contradicted


# ---------------------------------------------------------------- a new origin


@pytest.mark.parametrize("told_after", [0, 1, 5])
def test_a_new_origin_moves_nothing_however_late_it_is_told(told_after: int) -> None:
    autopilot = flying()
    autopilot.tell(autopilot.origin())
    autopilot.tell(ticks=10)
    autopilot.origin_m = (0.0, 30.0, 0.0)
    autopilot.tell(ticks=told_after)
    autopilot.tell(autopilot.origin())
    state = autopilot.tell(ticks=10)
    assert all(used == pytest.approx(autopilot.true_m, abs=0.01 + 0.004 * told_after) for used in autopilot.used)
    assert state.held_back_m < 0.02
    assert state.altitude_amsl_m == pytest.approx(493.0)


def test_told_before_it_counts_moves_nothing_either() -> None:
    autopilot = flying()
    autopilot.tell(autopilot.origin())
    autopilot.tell(ticks=10)
    before, autopilot.origin_m = autopilot.origin_m, (0.0, 30.0, 0.0)
    told = autopilot.origin()
    autopilot.origin_m = before
    autopilot.tell(told)
    autopilot.origin_m = (0.0, 30.0, 0.0)
    autopilot.tell(ticks=10)
    assert all(used == pytest.approx(autopilot.true_m, abs=0.01) for used in autopilot.used)


def test_a_new_origin_that_only_the_global_position_tells_of() -> None:
    autopilot = flying()
    for _ in range(6):
        autopilot.tell(autopilot.global_position())
    autopilot.origin_m = (0.0, 30.0, 0.0)
    assert autopilot.tell().held_back_m == pytest.approx(70.7, abs=0.1)
    for _ in range(6):
        autopilot.tell(autopilot.global_position())
    assert autopilot.tell().held_back_m < 0.1
    assert autopilot.used[-1] == pytest.approx(autopilot.true_m, abs=0.1)


def test_a_reset_estimator_is_followed_slowly_and_told_of() -> None:
    autopilot = flying()
    autopilot.tell(autopilot.origin())
    autopilot.tell(ticks=10)
    autopilot.true_m = (4.0, 4.0, 5.0)
    state = autopilot.tell()
    assert state.position_enu_m == pytest.approx((3.0, 4.0, 5.0), abs=0.005)
    assert state.held_back_m == pytest.approx(1.0, abs=0.005)
    assert autopilot.tracker.events == [f"the autopilot's position jumped by 1.0 m: followed at {LET_IN_M_S} m/s"]
    assert autopilot.tell(ticks=260).position_enu_m == pytest.approx((4.0, 4.0, 5.0), abs=0.001)


def test_where_nobody_heeds_it_it_is_used_at_once() -> None:
    autopilot = flying()
    autopilot.tell(autopilot.origin())
    autopilot.tracker.take_as_told()
    autopilot.true_m = (9.0, 9.0, 0.0)
    assert autopilot.tell().position_enu_m == pytest.approx((9.0, 9.0, 0.0), abs=0.005)


# ---------------------------------------------------------------- height from take-off


def test_height_is_from_where_it_stood_when_it_was_armed() -> None:
    autopilot = flying(from_takeoff=True)
    autopilot.armed, autopilot.landed, autopilot.true_m = False, LandedState.ON_GROUND, (1.0, 2.0, 1.7)
    autopilot.tell(autopilot.origin())
    autopilot.true_m = (1.0, 2.0, 0.9)  # its altitude wanders
    assert autopilot.tell().position_enu_m[2] == pytest.approx(0.0, abs=1e-3)
    autopilot.armed = True
    autopilot.tell()
    autopilot.landed, autopilot.true_m = LandedState.IN_AIR, (1.0, 2.0, 1.0)
    autopilot.tell()
    autopilot.origin_m = (0.0, 0.0, 7.0)
    state = autopilot.tell(autopilot.origin())
    assert state.position_enu_m == pytest.approx((1.0, 2.0, 0.1), abs=0.02)
    assert state.altitude_amsl_m == pytest.approx(489.0, abs=1e-3)


def test_one_first_seen_in_flight_has_no_height() -> None:
    autopilot = flying(from_takeoff=True)
    autopilot.tell(autopilot.origin())
    state = autopilot.tell(ticks=50)
    assert not state.frame_known
    assert state.position_time_s == float("-inf")


# ---------------------------------------------------------------- its own error


def test_the_estimator_s_word_on_its_error_grows_old() -> None:
    autopilot = flying()
    autopilot.tell(autopilot.origin(), EstimatorSample(0.0, 0.3, 0.5))
    assert autopilot.tell().position_error == PositionError(0.3, 0.5)
    assert autopilot.tell(ticks=260).position_error is None


@pytest.mark.parametrize("bad", [nan, -0.1, float("inf")])
def test_an_error_that_is_none_is_not_known(bad: float) -> None:
    autopilot = flying()
    autopilot.tell(autopilot.origin(), EstimatorSample(0.0, 0.3, 0.5))
    assert autopilot.tell(EstimatorSample(0.1, bad, 0.5)).position_error is None
    assert autopilot.tell(EstimatorSample(0.2, 0.3, bad)).position_error is None
