"""Samples: autopilot -> agent."""

from __future__ import annotations

from msgspec import Struct

from companion.types.autopilot import AutopilotKind, AutopilotMode, LandedState
from companion.types.vectors import Vector3


class PositionSample(Struct, frozen=True, gc=False):
    """LOCAL_POSITION_NED, in ENU about the autopilot's own origin."""

    received_s: float
    boot_time_s: float
    position_local_enu_m: Vector3
    velocity_enu_m_s: Vector3


class AttitudeSample(Struct, frozen=True, gc=False):
    """ATTITUDE_QUATERNION as Euler angles of the FLU body in ENU."""

    received_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float


class ModeSample(Struct, frozen=True, gc=False):
    """The flight mode as the autopilot itself reports it; `name` is the autopilot's name of it."""

    received_s: float
    mode: AutopilotMode
    name: str


class HeartbeatSample(Struct, frozen=True, gc=False):
    """HEARTBEAT of the autopilot: its armed flag and its make."""

    received_s: float
    armed: bool
    autopilot: AutopilotKind


class LandedSample(Struct, frozen=True, gc=False):
    """EXTENDED_SYS_STATE."""

    received_s: float
    landed: LandedState


class ThrustSample(Struct, frozen=True, gc=False):
    """ATTITUDE_TARGET: the collective thrust in 0..1 that the autopilot commands at present."""

    received_s: float
    thrust_norm: float


class OriginSample(Struct, frozen=True, gc=False):
    """GPS_GLOBAL_ORIGIN: origin of the autopilot's local frame."""

    received_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float


class SystemSample(Struct, frozen=True, gc=False):
    """SYS_STATUS: battery charge, -1 if unknown, whether the arming checks pass, and the health of the state estimate."""

    received_s: float
    battery_percent: float
    may_arm: bool
    estimator_healthy: bool = True


class ParameterSample(Struct, frozen=True, gc=False):
    """One parameter of the autopilot, by the autopilot's own name."""

    received_s: float
    name: str
    value: float


class GlobalPositionSample(Struct, frozen=True, gc=False):
    """GLOBAL_POSITION_INT: the estimate of PositionSample in degrees and metres above mean sea level."""

    received_s: float
    boot_time_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float


class EstimatorSample(Struct, frozen=True, gc=False):
    """Position error that the estimator reports, one sigma; not finite if unknown. `healthy`: its position may be used."""

    received_s: float
    horizontal_error_m: float
    vertical_error_m: float
    healthy: bool = True


class AckSample(Struct, frozen=True, gc=False):
    """COMMAND_ACK. `answers` are the request types of the acknowledged command; `reason` is the result as text."""

    received_s: float
    answers: tuple[type, ...]
    accepted: bool
    reason: str


class TextSample(Struct, frozen=True, gc=False):
    """One complete STATUSTEXT."""

    received_s: float
    severity: int
    text: str


Telemetry = (
    PositionSample
    | AttitudeSample
    | ModeSample
    | HeartbeatSample
    | LandedSample
    | ThrustSample
    | OriginSample
    | SystemSample
    | ParameterSample
    | GlobalPositionSample
    | EstimatorSample
    | AckSample
    | TextSample
)
