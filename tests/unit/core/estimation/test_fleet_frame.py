"""Local frame in the fleet frame: its source messages and its changes."""

from dataclasses import dataclass, field
from math import nan

import msgspec
import pytest

from companion.core.estimation.corrections import RELEASE_M_S
from companion.core.estimation.vehicle import VehicleTracker
from companion.geometry.frames import geodetic_from_enu
from companion.types.autopilot import (
    AutopilotKind,
    EstimatorSample,
    GlobalPositionSample,
    HeartbeatSample,
    HomeSample,
    LandedSample,
    LandedState,
    OriginSample,
    PositionError,
    PositionSample,
    Telemetry,
    VehicleState,
)
from companion.types.flight import Flight
from companion.types.notices import Code, Notice
from companion.types.values import Vector3

FLEET = (47.397742, 8.545594, 488.0)


@dataclass
class Autopilot:
    """An autopilot at `true_m` in the fleet frame with its local origin at `origin_m`; sends at 50 Hz."""

    tracker: VehicleTracker
    true_m: Vector3 = (3.0, 4.0, 5.0)
    origin_m: Vector3 = (50.0, -20.0, 2.0)
    armed: bool = True
    landed: LandedState = LandedState.IN_AIR
    now_s: float = 0.0
    used: list[Vector3] = field(default_factory=list)
    events: list[Notice] = field(default_factory=list)

    def origin(self) -> OriginSample:
        return OriginSample(self.now_s, *geodetic_from_enu(self.origin_m, FLEET))

    def position(self) -> PositionSample:
        x, y, z = (a - o for a, o in zip(self.true_m, self.origin_m, strict=True))
        return PositionSample(self.now_s, self.now_s, (x, y, z), (0.0, 0.0, 0.0))

    def global_position(self, off_m: float = 0.0) -> GlobalPositionSample:
        x, y, z = self.true_m
        return GlobalPositionSample(self.now_s, self.now_s, *geodetic_from_enu((x + off_m, y, z), FLEET))

    def send(self, *more: Telemetry, ticks: int = 1) -> VehicleState:
        state = self.tracker.state
        for _ in range(ticks):
            self.now_s += 0.02
            status = (HeartbeatSample(self.now_s, self.armed, AutopilotKind.PX4), LandedSample(self.now_s, self.landed))
            state, events = self.tracker.fold([*status, *more, self.position()])
            self.events += events
            self.used.append(state.position_enu_m)
        return state


def flying(*, from_takeoff: bool = False) -> Autopilot:
    return Autopilot(VehicleTracker(FLEET, from_takeoff))


# ---------------------------------------------------------------- which message


def test_origin_is_derived_from_the_global_position() -> None:
    autopilot = flying()
    autopilot.send()
    for _ in range(4):
        assert not autopilot.send(autopilot.global_position()).frame_known
    state = autopilot.send(autopilot.global_position())
    state = autopilot.send()
    assert state.frame_known
    assert state.position_enu_m == pytest.approx((3.0, 4.0, 5.0), abs=1e-6)
    assert state.altitude_amsl_m == pytest.approx(493.0)


def test_scattered_global_position_gives_no_origin() -> None:
    autopilot = flying()
    autopilot.send()
    for index in range(20):
        autopilot.send(autopilot.global_position(off_m=float(index % 3)))
    assert not autopilot.tracker.state.frame_known


def test_global_position_without_a_fix_is_ignored() -> None:
    autopilot = flying()
    autopilot.send()
    nowhere = GlobalPositionSample(autopilot.now_s, autopilot.now_s, 0.0, 0.0, 0.0)
    for _ in range(10):
        autopilot.send(nowhere)
    assert not autopilot.tracker.state.frame_known
    assert autopilot.tracker.rejected[Code.GLOBAL_POSITION_IMPLAUSIBLE] > 0


def test_origin_contradicted_by_the_global_position_is_not_used() -> None:
    autopilot = flying()
    autopilot.send(autopilot.origin())
    for _ in range(5):
        assert not autopilot.tracker.state.frame_contradicted
        autopilot.send(autopilot.global_position(off_m=3.0))
    assert autopilot.send().frame_contradicted
    assert not autopilot.send(autopilot.global_position(), ticks=2).frame_contradicted


# ---------------------------------------------------------------- a new origin


@pytest.mark.parametrize("ticks_before_origin", [0, 1, 5])
def test_new_origin_does_not_move_the_position_at_any_delay(ticks_before_origin: int) -> None:
    autopilot = flying()
    autopilot.send(autopilot.origin())
    autopilot.send(ticks=10)
    autopilot.origin_m = (0.0, 30.0, 0.0)
    autopilot.send(ticks=ticks_before_origin)
    autopilot.send(autopilot.origin())
    state = autopilot.send(ticks=10)
    assert all(
        used == pytest.approx(autopilot.true_m, abs=0.01 + 0.004 * ticks_before_origin) for used in autopilot.used
    )
    assert state.held_back_m < 0.02
    assert state.altitude_amsl_m == pytest.approx(493.0)


def test_new_origin_received_early_does_not_move_the_position() -> None:
    autopilot = flying()
    autopilot.send(autopilot.origin())
    autopilot.send(ticks=10)
    before, autopilot.origin_m = autopilot.origin_m, (0.0, 30.0, 0.0)
    new_origin = autopilot.origin()
    autopilot.origin_m = before
    autopilot.send(new_origin)
    autopilot.origin_m = (0.0, 30.0, 0.0)
    autopilot.send(ticks=10)
    assert all(used == pytest.approx(autopilot.true_m, abs=0.01) for used in autopilot.used)


def test_new_origin_is_derived_from_the_global_position() -> None:
    autopilot = flying()
    for _ in range(6):
        autopilot.send(autopilot.global_position())
    autopilot.origin_m = (0.0, 30.0, 0.0)
    assert autopilot.send().held_back_m == pytest.approx(70.7, abs=0.1)
    for _ in range(6):
        autopilot.send(autopilot.global_position())
    assert autopilot.send().held_back_m < 0.1
    assert autopilot.used[-1] == pytest.approx(autopilot.true_m, abs=0.1)


def test_estimator_reset_is_followed_slowly_and_reported() -> None:
    autopilot = flying()
    autopilot.send(autopilot.origin())
    autopilot.send(ticks=10)
    autopilot.true_m = (4.0, 4.0, 5.0)
    state = autopilot.send()
    assert state.position_enu_m == pytest.approx((3.0, 4.0, 5.0), abs=0.005)
    assert state.held_back_m == pytest.approx(1.0, abs=0.005)
    text = f"the autopilot's position jumped by 1.0 m: followed at {RELEASE_M_S} m/s"
    assert autopilot.events == [Notice(Code.POSITION_RESET, text)]
    assert autopilot.send(ticks=260).position_enu_m == pytest.approx((4.0, 4.0, 5.0), abs=0.001)


def test_next_position_is_used_at_once_out_of_formation() -> None:
    autopilot = flying()
    autopilot.send(autopilot.origin())
    autopilot.tracker.step(autopilot.now_s, (), Flight())  # not in formation
    autopilot.true_m = (9.0, 9.0, 0.0)
    assert autopilot.send().position_enu_m == pytest.approx((9.0, 9.0, 0.0), abs=0.005)


# ---------------------------------------------------------------- height from take-off


def test_height_is_measured_from_the_arming_position() -> None:
    autopilot = flying(from_takeoff=True)
    autopilot.armed, autopilot.landed, autopilot.true_m = False, LandedState.ON_GROUND, (1.0, 2.0, 1.7)
    autopilot.send(autopilot.origin())
    autopilot.true_m = (1.0, 2.0, 0.9)  # its altitude drifts
    assert autopilot.send().position_enu_m[2] == pytest.approx(0.0, abs=1e-3)
    autopilot.armed = True
    autopilot.send()
    autopilot.landed, autopilot.true_m = LandedState.IN_AIR, (1.0, 2.0, 1.0)
    autopilot.send()
    autopilot.origin_m = (0.0, 0.0, 7.0)
    state = autopilot.send(autopilot.origin())
    assert state.position_enu_m == pytest.approx((1.0, 2.0, 0.1), abs=0.02)
    assert state.altitude_amsl_m == pytest.approx(489.0, abs=1e-3)


def test_height_is_unknown_after_a_restart_in_flight() -> None:
    autopilot = flying(from_takeoff=True)
    autopilot.send(autopilot.origin())
    state = autopilot.send(ticks=50)
    assert not state.frame_known
    assert state.position_time_s == float("-inf")


# ---------------------------------------------------------------- its own error


def test_a_position_error_that_is_reported_no_more_grows() -> None:
    autopilot = flying()
    autopilot.send(autopilot.origin(), EstimatorSample(0.0, 0.3, 0.5))
    assert autopilot.send().position_error == PositionError(0.3, 0.5)
    state = autopilot.send(ticks=260)
    assert state.position_unaided and state.position_error
    assert state.position_error.horizontal_m > 1.0 and state.position_error.vertical_m > 0.9


@pytest.mark.parametrize("bad", [nan, -0.1, float("inf")])
def test_an_invalid_position_error_is_unknown(bad: float) -> None:
    for sample in (EstimatorSample(0.1, bad, 0.5), EstimatorSample(0.1, 0.3, bad)):
        autopilot = flying()
        state = autopilot.send(autopilot.origin(), sample)
        assert state.position_error is None and not state.position_unaided
        autopilot.send(EstimatorSample(0.2, 0.3, 0.5))
        state = autopilot.send(msgspec.structs.replace(sample, received_s=0.3))
        assert state.position_unaided and state.position_error and state.position_error.horizontal_m >= 0.3


def home(position_m: Vector3, origin: Vector3 = FLEET) -> HomeSample:
    return HomeSample(0.0, *geodetic_from_enu(position_m, origin)[:2])


def test_home_is_a_place_in_the_fleet_frame_whatever_the_autopilot_s_origin() -> None:
    autopilot = flying()
    state = autopilot.send(home((-7.0, 30.0, 2.0)))  # also before the origin
    assert state.home_enu_m == pytest.approx((-7.0, 30.0), abs=1e-6)
    autopilot.send(autopilot.origin())
    assert autopilot.send(home((8.0, -1.0, 0.0))).home_enu_m == pytest.approx((8.0, -1.0), abs=1e-6)


def test_home_in_a_shared_frame_needs_the_autopilot_s_origin() -> None:
    autopilot = Autopilot(VehicleTracker(None))
    assert autopilot.send(home((1.0, 2.0, 0.0))).home_enu_m is None
    assert autopilot.tracker.rejected == {}
    assert autopilot.send(OriginSample(0.0, *FLEET)).home_enu_m == pytest.approx((1.0, 2.0), abs=1e-6)


@pytest.mark.parametrize("place", [(0.0, 0.0), (91.0, 8.5), (47.4, 181.0), (nan, 8.5), (47.6, 8.5)])
def test_an_implausible_home_is_unknown_and_counted(place: tuple[float, float]) -> None:
    autopilot = flying()
    autopilot.send(home((1.0, 2.0, 0.0)))
    assert autopilot.send(HomeSample(0.0, *place)).home_enu_m is None
    assert autopilot.tracker.rejected[Code.HOME_IMPLAUSIBLE] == 1
