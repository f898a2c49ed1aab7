"""Setpoints and requests: agent -> autopilot."""

from __future__ import annotations

from msgspec import Struct

from companion.types.autopilot import AutopilotMode


class AttitudeTarget(Struct, frozen=True, gc=False):
    """SET_ATTITUDE_TARGET: Euler angles of the FLU body in ENU and the collective thrust in 0..1."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    thrust_norm: float


class SetMode(Struct, frozen=True, gc=False):
    mode: AutopilotMode


class Arm(Struct, frozen=True, gc=False):
    pass


class Disarm(Struct, frozen=True, gc=False):
    pass


class TakeOff(Struct, frozen=True, gc=False):
    """Take off vertically. `altitude_amsl_m` for PX4, `height_m` above the ground for ArduPilot."""

    altitude_amsl_m: float
    height_m: float


class RequestOrigin(Struct, frozen=True, gc=False):
    """Ask for GPS_GLOBAL_ORIGIN, which PX4 sends once and on change."""


class RequestParameter(Struct, frozen=True, gc=False):
    """Ask for one parameter. There is none that sets one: the agent only reads."""

    name: str


AutopilotRequest = SetMode | Arm | Disarm | TakeOff | RequestOrigin | RequestParameter
