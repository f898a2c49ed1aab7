"""Folds telemetry into one VehicleState in the fleet frame, and keeps out what cannot be true."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from math import isfinite
from typing import Any

from companion.frames import enu_from_geodetic
from companion.types import (
    ZERO3,
    AttitudeSample,
    HeartbeatSample,
    LandedSample,
    ModeSample,
    OriginSample,
    PositionSample,
    Telemetry,
    Vector3,
    VehicleState,
)

MAX_LOCAL_M = 100_000.0  # LOCAL_POSITION_NED loses centimetres to its 32 bit floats far before this
MAX_SPEED_M_S = 100.0
REBOOT_S = 1.0  # time_boot_ms that runs back by more than this is a reboot, by less a datagram overtaken by another


class VehicleTracker:
    """The own vehicle's newest state.

    `fleet_origin` is (latitude deg, longitude deg, altitude AMSL m) of the fleet frame, or None where the autopilot's local
    frame is the fleet frame already (one motion-capture system for all). Until the autopilot's own origin is known, a
    geodetic fleet has no position.
    """

    def __init__(self, fleet_origin: Vector3 | None) -> None:
        self._fleet_origin = fleet_origin
        self._offset_enu_m: Vector3 | None = ZERO3 if fleet_origin is None else None
        self._own_origin_altitude_m: float | None = None
        self._boot_time_s = float("-inf")
        self.rejected: Counter[str] = Counter()
        self.state = VehicleState(frame_known=fleet_origin is None)
        self._fields: dict[str, Any] = {"frame_known": self.state.frame_known}  # all that was ever heard

    def fold(self, telemetry: Iterable[Telemetry]) -> VehicleState:
        """The state after these samples. What is out of range is counted in `rejected` and changes nothing."""
        for sample in telemetry:
            match sample:
                case PositionSample():
                    self._fold_position(sample)
                case AttitudeSample():
                    self._fold_attitude(sample)
                case ModeSample():
                    self._fields.update(mode=sample.mode, mode_name=sample.name, mode_time_s=sample.received_s)
                case HeartbeatSample():
                    self._fields.update(
                        autopilot=sample.autopilot, armed=sample.armed, heartbeat_time_s=sample.received_s
                    )
                case LandedSample():
                    self._fields.update(landed=sample.landed, landed_time_s=sample.received_s)
                case OriginSample():
                    self._fold_origin(sample)
        # Once a tick: a new state for every sample would cost more than the law.
        self.state = VehicleState(**self._fields)
        return self.state

    def _fold_position(self, sample: PositionSample) -> None:
        step_s = sample.boot_time_s - self._boot_time_s
        if -REBOOT_S < step_s <= 0.0:
            self.rejected["position out of order"] += 1
            return
        if not _within(sample.position_local_enu_m, MAX_LOCAL_M) or not _within(sample.velocity_enu_m_s, MAX_SPEED_M_S):
            self.rejected["position not plausible"] += 1
            return
        if step_s <= -REBOOT_S:
            self._forget_origin()
        self._boot_time_s = sample.boot_time_s
        if self._offset_enu_m is None:
            return
        east, north, up = sample.position_local_enu_m
        offset = self._offset_enu_m
        self._fields.update(
            position_enu_m=(east + offset[0], north + offset[1], up + offset[2]),
            velocity_enu_m_s=sample.velocity_enu_m_s,
            position_time_s=sample.received_s,
            altitude_amsl_m=None if self._own_origin_altitude_m is None else self._own_origin_altitude_m + up,
        )

    def _forget_origin(self) -> None:
        """The autopilot began anew, and its origin with it; in a local frame only its altitude is lost."""
        self._own_origin_altitude_m = None
        self._fields.update(altitude_amsl_m=None)
        if self._fleet_origin is not None:
            self._offset_enu_m = None
            self._fields.update(frame_known=False)
            self._fields.pop("position_time_s", None)

    def _fold_attitude(self, sample: AttitudeSample) -> None:
        if not (isfinite(sample.roll_rad) and isfinite(sample.pitch_rad) and isfinite(sample.yaw_rad)):
            self.rejected["attitude not finite"] += 1
            return
        fields = self._fields
        fields["roll_rad"], fields["pitch_rad"], fields["yaw_rad"] = sample.roll_rad, sample.pitch_rad, sample.yaw_rad
        fields["attitude_time_s"] = sample.received_s

    def _fold_origin(self, sample: OriginSample) -> None:
        plausible = abs(sample.latitude_deg) <= 90.0 and abs(sample.longitude_deg) <= 180.0
        if not plausible or not -1000.0 < sample.altitude_amsl_m < 10_000.0:
            self.rejected["origin not plausible"] += 1
            return
        self._own_origin_altitude_m = sample.altitude_amsl_m
        if self._fleet_origin is not None:
            offset_enu_m = enu_from_geodetic(
                sample.latitude_deg, sample.longitude_deg, sample.altitude_amsl_m, self._fleet_origin
            )
            if offset_enu_m != self._offset_enu_m:
                self._fields.pop("position_time_s", None)  # the last position was of the old origin
            self._offset_enu_m = offset_enu_m
        self._fields.update(frame_known=True)


def _within(vector: Vector3, limit: float) -> bool:
    """False for NaN, too."""
    x, y, z = vector
    return abs(x) <= limit and abs(y) <= limit and abs(z) <= limit
