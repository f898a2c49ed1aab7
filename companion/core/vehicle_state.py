"""Folds telemetry into one VehicleState in the fleet frame, and keeps out what cannot be true."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from math import hypot, isfinite
from typing import Any

from companion.core.bumpless import LET_IN_M_S, BumplessPosition
from companion.core.fleet_frame import FleetFrame
from companion.types import (
    ZERO3,
    AttitudeSample,
    EstimatorSample,
    GlobalPositionSample,
    HeartbeatSample,
    LandedSample,
    LandedState,
    ModeSample,
    OriginSample,
    PositionError,
    PositionSample,
    Telemetry,
    ThrustSample,
    Vector3,
    VehicleState,
)

MAX_LOCAL_M = 100_000.0  # LOCAL_POSITION_NED loses centimetres to its 32 bit floats far before this
MAX_SPEED_M_S = 100.0
MAX_ERROR_M = 10_000.0
ERROR_AGE_S = 5.0  # for so long an estimator's word on its own error counts
REBOOT_S = 1.0  # time_boot_ms that runs back by more than this is a reboot, by less a datagram overtaken by another
EVENT_PERIOD_S = 1.0  # an estimator that jumps on and on is not told of on and on


class VehicleTracker:
    """The own vehicle's newest state.

    Until the autopilot's own origin is known, a geodetic fleet has no position. Where `height_from_takeoff`, z is the height
    above where the vehicle stood when it was last seen disarmed on the ground; one first seen in flight has no position.
    """

    def __init__(self, fleet_origin: Vector3 | None, height_from_takeoff: bool = False) -> None:
        self._frame = FleetFrame(fleet_origin)
        self._bumpless = BumplessPosition()
        self._ground_up_m: float | None = None if height_from_takeoff else 0.0
        self._follows_ground = height_from_takeoff
        self._position: PositionSample | None = None
        self._jump_told_s = self._error_s = float("-inf")
        self.rejected: Counter[str] = Counter()
        self.events: list[str] = []
        self._fields: dict[str, Any] = {"frame_known": self._frame_known()}  # all that was ever heard
        self.state = VehicleState(**self._fields)
        self._folds: dict[type[Telemetry], Callable[[Any], None]] = {
            PositionSample: self._fold_position,
            AttitudeSample: self._fold_attitude,
            ModeSample: self._fold_mode,
            HeartbeatSample: self._fold_heartbeat,
            LandedSample: self._fold_landed,
            ThrustSample: self._fold_thrust,
            OriginSample: self._fold_origin,
            GlobalPositionSample: self._fold_global_position,
            EstimatorSample: self._fold_error,
        }

    def take_as_told(self) -> None:
        """The next position is used as it comes: nobody heeds this vehicle just now, itself included."""
        self._bumpless.begin_anew()

    def fold(self, telemetry: Iterable[Telemetry]) -> VehicleState:
        """The state after these samples. What is out of range is counted in `rejected` and changes nothing."""
        for sample in telemetry:
            fold = self._folds.get(type(sample))
            if fold is not None:
                fold(sample)
        # Once a tick: a new state for every sample would cost more than the law.
        self.state = VehicleState(**self._fields)
        return self.state

    def _fold_position(self, sample: PositionSample) -> None:
        step_s = sample.boot_time_s - self._position.boot_time_s if self._position else 0.0
        if self._position and -REBOOT_S < step_s <= 0.0:
            self.rejected["position out of order"] += 1
            return
        if not _within(sample.position_local_enu_m, MAX_LOCAL_M) or not _within(sample.velocity_enu_m_s, MAX_SPEED_M_S):
            self.rejected["position not plausible"] += 1
            return
        if step_s <= -REBOOT_S:
            self._forget_origin()
        self._position = sample
        if sample.received_s - self._error_s > ERROR_AGE_S:
            self._fields["position_error"] = None
        offset_m = self._frame.offset_enu_m
        if offset_m is None:
            return
        east, north, up = sample.position_local_enu_m
        if self._follows_ground and self._stands():
            self._ground_up_m = up + offset_m[2]
        own_altitude_m = self._frame.own_altitude_amsl_m
        self._fields["frame_known"] = self._ground_up_m is not None
        self._fields["altitude_amsl_m"] = None if own_altitude_m is None else own_altitude_m + up
        if self._ground_up_m is not None:
            self._use(sample, (east + offset_m[0], north + offset_m[1], up + offset_m[2] - self._ground_up_m))

    def _use(self, sample: PositionSample, position_enu_m: Vector3) -> None:
        used_enu_m, jump_m = self._bumpless.follow(sample.boot_time_s, position_enu_m, sample.velocity_enu_m_s)
        if jump_m:
            self._fields.update(jump_time_s=sample.received_s)
            if sample.received_s - self._jump_told_s > EVENT_PERIOD_S:
                self.events.append(f"the autopilot's position jumped by {jump_m:.1f} m: followed at {LET_IN_M_S} m/s")
            self._jump_told_s = sample.received_s
        fields, held_back_m = self._fields, self._bumpless.held_back_m
        fields["position_enu_m"] = used_enu_m
        fields["velocity_enu_m_s"] = sample.velocity_enu_m_s
        fields["position_time_s"] = sample.received_s
        if not fields.get("armed", True) and self._stands():
            fields["stood_enu_m"] = used_enu_m
        fields["held_back_m"] = 0.0 if held_back_m is ZERO3 else hypot(*held_back_m)

    def _stands(self) -> bool:
        """Heard of as disarmed and not as flying."""
        fields = self._fields
        heard = "heartbeat_time_s" in fields and not fields["armed"]
        return heard and fields.get("landed", LandedState.UNDEFINED) in (LandedState.UNDEFINED, LandedState.ON_GROUND)

    def _frame_known(self) -> bool:
        return self._frame.offset_enu_m is not None and self._ground_up_m is not None

    def _forget_origin(self) -> None:
        """The autopilot began anew."""
        self._frame.forget()
        self._bumpless.begin_anew()
        if self._follows_ground:
            self._ground_up_m = None
        self._fields.update(altitude_amsl_m=None, frame_known=self._frame_known(), frame_contradicted=False)
        if not self._frame_known():
            self._fields.pop("position_time_s", None)

    def _fold_mode(self, sample: ModeSample) -> None:
        self._fields.update(mode=sample.mode, mode_name=sample.name, mode_time_s=sample.received_s)

    def _fold_heartbeat(self, sample: HeartbeatSample) -> None:
        self._fields.update(autopilot=sample.autopilot, armed=sample.armed, heartbeat_time_s=sample.received_s)

    def _fold_landed(self, sample: LandedSample) -> None:
        self._fields.update(landed=sample.landed, landed_time_s=sample.received_s)

    def _fold_attitude(self, sample: AttitudeSample) -> None:
        if not (isfinite(sample.roll_rad) and isfinite(sample.pitch_rad) and isfinite(sample.yaw_rad)):
            self.rejected["attitude not finite"] += 1
            return
        fields = self._fields
        fields["roll_rad"], fields["pitch_rad"], fields["yaw_rad"] = sample.roll_rad, sample.pitch_rad, sample.yaw_rad
        fields["attitude_time_s"] = sample.received_s

    def _fold_thrust(self, sample: ThrustSample) -> None:
        if not 0.0 <= sample.thrust_norm <= 1.0:
            self.rejected["thrust not plausible"] += 1
            return
        self._fields["thrust_norm"], self._fields["thrust_time_s"] = sample.thrust_norm, sample.received_s

    def _fold_origin(self, sample: OriginSample) -> None:
        before = self._frame.offset_enu_m
        if not self._frame.hear_origin(sample):
            self.rejected["origin not plausible"] += 1
            return
        self._origin_heard(before)

    def _fold_global_position(self, sample: GlobalPositionSample) -> None:
        before = self._frame.offset_enu_m
        if self._position and not self._frame.hear_global_position(sample, self._position):
            self.rejected["global position not plausible"] += 1
            return
        self._origin_heard(before)

    def _origin_heard(self, before: Vector3 | None) -> None:
        """On the ground the last position is of the old origin; in flight the one used goes on."""
        if self._frame.offset_enu_m != before and not self._fields.get("armed", False):
            self._fields.pop("position_time_s", None)
        self._fields.update(frame_known=self._frame_known(), frame_contradicted=self._frame.contradicted)

    def _fold_error(self, sample: EstimatorSample) -> None:
        horizontal_m, vertical_m = sample.horizontal_error_m, sample.vertical_error_m
        self._error_s = sample.received_s
        known = 0.0 <= horizontal_m <= MAX_ERROR_M and 0.0 <= vertical_m <= MAX_ERROR_M
        self._fields["position_error"] = PositionError(horizontal_m, vertical_m) if known else None


def _within(vector: Vector3, limit: float) -> bool:
    """False for NaN, too."""
    x, y, z = vector
    return abs(x) <= limit and abs(y) <= limit and abs(z) <= limit
