"""A vehicle without GPS that gets motion-capture poses: its origin, the state of its poses, and its position error."""

from __future__ import annotations

from math import inf

import pytest
from msgspec.structs import replace

from companion.config.fleet import GeodeticOrigin, VisionSettings
from companion.core.estimation.accuracy import POSE_GAP_S
from companion.core.estimation.vehicle import ORIGIN_REFRESH_S, VehicleTracker
from companion.types.autopilot import (
    Arm,
    AutopilotKind,
    AutopilotRequest,
    EstimatorSample,
    HeartbeatSample,
    OriginSample,
    PoseSample,
    PositionError,
    PositionSample,
    RequestOrigin,
    SetOrigin,
    Telemetry,
)
from companion.types.commands import CommandName
from companion.types.flight import Flight
from companion.types.notices import Code
from one_agent import FLEET, AgentFlight

PLACE = GeodeticOrigin(latitude_deg=47.0, longitude_deg=8.0, altitude_amsl_m=400.0)
ORIGIN = SetOrigin(*PLACE.as_tuple())
ZERO = (0.0, 0.0, 0.0)


class Vehicle:
    """Telemetry of 50 Hz and, while it `has_poses`, a pose before each tick."""

    def __init__(self, vision_origin: SetOrigin | None = ORIGIN) -> None:
        self.tracker = VehicleTracker(None, vision_origin=vision_origin)
        self.now_s, self.boot_s = 10.0, 5.0
        self.armed, self.has_poses = False, True

    def fly(self, for_s: float, *more: Telemetry) -> list[AutopilotRequest]:
        """The requests of this time; `more` comes in its first tick."""
        asked: list[AutopilotRequest] = []
        for _ in range(round(for_s * 50)):
            self.now_s, self.boot_s = self.now_s + 0.02, self.boot_s + 0.02
            samples: list[Telemetry] = [
                HeartbeatSample(self.now_s, self.armed, AutopilotKind.PX4),
                PositionSample(self.now_s, self.boot_s, ZERO, ZERO),
                *([PoseSample(self.now_s, self.now_s - 0.01)] if self.has_poses else []),
                *more,
            ]
            asked += self.tracker.step(self.now_s, samples, Flight()).requests
            more = ()
        return asked


def test_the_origin_is_set_where_the_autopilot_has_none_and_was_asked() -> None:
    vehicle = Vehicle()
    assert vehicle.fly(3.9) == [RequestOrigin(), ORIGIN, RequestOrigin(), ORIGIN]  # either answer may be lost
    vehicle.fly(0.02, OriginSample(vehicle.now_s, 47.0, 8.0, 0.0))
    assert set(vehicle.fly(3.0 * ORIGIN_REFRESH_S)) == {RequestOrigin()}


def test_an_origin_that_the_autopilot_has_is_left_as_it_is() -> None:
    vehicle = Vehicle()
    assert vehicle.fly(0.02) == [RequestOrigin()]
    assert set(vehicle.fly(20.0, OriginSample(vehicle.now_s, 48.0, 9.0, 100.0))) == {RequestOrigin()}


@pytest.mark.parametrize("prevents", ["armed", "no poses", "not configured"])
def test_the_origin_is_not_set(prevents: str) -> None:
    vehicle = Vehicle(None if prevents == "not configured" else ORIGIN)
    vehicle.armed, vehicle.has_poses = prevents == "armed", prevents != "no poses"
    assert set(vehicle.fly(5.0)) == {RequestOrigin()}


def test_poses_that_have_ceased_set_no_origin() -> None:
    vehicle = Vehicle()
    vehicle.fly(0.5)
    vehicle.has_poses = False
    assert set(vehicle.fly(5.0)) == {RequestOrigin()}


def test_a_rebooted_autopilot_gets_its_origin_again() -> None:
    vehicle = Vehicle()
    vehicle.fly(1.0, OriginSample(vehicle.now_s, 47.0, 8.0, 0.0))
    vehicle.boot_s = 1.0
    assert ORIGIN in vehicle.fly(2.1)


def test_nothing_is_asked_of_an_unknown_make() -> None:
    tracker = VehicleTracker(None, vision_origin=ORIGIN)
    assert tracker.step(10.0, [PoseSample(10.0, 10.0)], Flight()).requests == ()


def test_arming_is_refused_until_the_origin_is_there() -> None:
    flight = AgentFlight(fleet=replace(FLEET, external_vision=VisionSettings(place=PLACE)))
    flight.sends_origin = False

    def ticks(seconds: float, *commands: CommandName) -> None:
        for _ in range(round(seconds * 50)):
            flight.tick(*commands, telemetry=[*flight.telemetry(), PoseSample(flight.now_s, flight.now_s)])
            commands = ()

    assert flight.tick(CommandName.PREPARE).replies[0].code is Code.POSE_LOST  # before the first pose
    ticks(2.0)
    ticks(1.0, CommandName.PREPARE)
    ticks(0.02, CommandName.ARM)
    (reply,) = flight.outbox.replies
    assert (reply.accepted, reply.code) == (False, Code.ALTITUDE_UNKNOWN)
    assert "no origin" in reply.reason
    assert Arm() not in flight.outbox.requests
    flight.sends_origin = True
    ticks(2.1)
    ticks(0.02, CommandName.ARM)
    assert flight.outbox.replies[0].accepted


# ---------------------------------------------------------------- the state of the poses


def test_a_good_pose_gives_the_time_and_a_refused_one_its_fault() -> None:
    tracker = VehicleTracker(None, vision_origin=ORIGIN)
    assert tracker.state.pose_time_s == -inf
    state, _ = tracker.fold([PoseSample(10.0, 9.9)])
    assert (state.pose_time_s, state.pose_refused_s, state.pose_fault) == (9.9, -inf, "")
    state, _ = tracker.fold([PoseSample(10.1, 10.0, "jumped by 1.00 m")])
    assert (state.pose_time_s, state.pose_refused_s, state.pose_fault) == (9.9, 10.1, "jumped by 1.00 m")


def test_a_vehicle_with_gps_needs_no_poses() -> None:
    tracker = VehicleTracker(PLACE.as_tuple())
    assert tracker.fold([PoseSample(10.0, 9.9)])[0].pose_time_s == inf


@pytest.mark.parametrize("refused", [False, True])
def test_without_good_poses_the_position_error_grows(refused: bool) -> None:
    """The autopilot's own estimate of it, which hardly does, is known."""
    vehicle, known = Vehicle(), PositionError(0.05, 0.04)

    def errors_m(seconds: float) -> list[float]:
        errors = []
        for number in range(round(seconds * 50)):
            now_s = vehicle.now_s + 0.02
            bad = [PoseSample(now_s, now_s, "frozen")] if refused and not vehicle.has_poses else []
            reported = [EstimatorSample(now_s, 0.05, 0.04)] if number % 10 == 0 else []
            vehicle.fly(0.02, *bad, *reported)
            error = vehicle.tracker.state.position_error
            assert error
            errors.append(error.horizontal_m)
        return errors

    assert set(errors_m(2.0)) == {0.05}
    vehicle.has_poses = False
    assert set(errors_m(POSE_GAP_S - 0.04)) == {0.05}  # a usual gap
    errors = errors_m(2.0)[5:]
    assert errors == sorted(set(errors))  # in every tick
    assert errors[0] > 0.05 and 0.3 < errors[-1] < 1.0  # measured: 0.2 m in 1 s, 0.6 m in 2 to 3 s
    assert not vehicle.tracker.state.position_unaided  # what the autopilot reports is another flag
    vehicle.has_poses = True
    errors_m(0.2)
    vehicle.fly(0.02)
    assert vehicle.tracker.state.position_error == known
