"""Autopilot makes and flight modes, and the state of the own vehicle."""

from __future__ import annotations

from enum import IntEnum, StrEnum

from msgspec import Struct

from companion.types.bounds import Finite
from companion.types.vectors import ZERO3, Vector3


class AutopilotKind(StrEnum):
    """Make of the autopilot: selects the MAVLink dialect and the autopilot profile."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"


class AutopilotMode(StrEnum):
    """Flight modes by meaning, the same for every autopilot. OTHER covers every mode the agent never commands."""

    UNKNOWN = "unknown"
    HOLD = "hold"
    TAKEOFF = "takeoff"
    OFFBOARD = "offboard"
    LAND = "land"
    RETURN = "return"  # fly home and land
    OTHER = "other"


class LandedState(IntEnum):
    """MAV_LANDED_STATE of EXTENDED_SYS_STATE."""

    UNDEFINED = 0
    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


class PositionError(Struct, frozen=True, gc=False):
    """One sigma of the position as the estimator reports it, horizontal and vertical."""

    horizontal_m: Finite
    vertical_m: Finite


class VehicleState(Struct, frozen=True, gc=False):
    """Estimate of the own vehicle's state in the fleet frame. Times are -inf before the first sample.

    `position_enu_m` is the position used by the law: after a jump of the autopilot's position in
    flight it is blended to the new one.
    """

    position_enu_m: Vector3 = ZERO3
    velocity_enu_m_s: Vector3 = ZERO3
    position_time_s: float = float("-inf")
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    attitude_time_s: float = float("-inf")
    mode: AutopilotMode = AutopilotMode.UNKNOWN
    mode_name: str = "unknown"
    mode_time_s: float = float("-inf")
    autopilot: AutopilotKind | None = None  # None until its first HEARTBEAT
    armed: bool = False
    heartbeat_time_s: float = float("-inf")
    landed: LandedState = LandedState.UNDEFINED
    landed_time_s: float = float("-inf")
    thrust_norm: float = 0.0  # as the autopilot commands it
    thrust_time_s: float = float("-inf")
    ground_position_enu_m: Vector3 | None = None  # last disarmed position on the ground: the autopilot's home
    frame_known: bool = False  # whether positions can be mapped into the fleet frame
    altitude_amsl_m: float | None = None  # relative to the autopilot's origin; None until that is known
    frame_contradicted: bool = False  # the autopilot's origin and its global position disagree
    held_back_m: float = 0.0  # distance between the position used and the autopilot's
    jump_time_s: float = float("-inf")  # when the autopilot's position last jumped
    position_error: PositionError | None = None  # None if not reported or stale
    estimator_healthy: bool = True  # as last reported; True where it is not reported
    battery_percent: float = -1.0  # -1 where unknown


def in_air(vehicle: VehicleState) -> bool:
    """Armed and not known to be on the ground: an unknown landed state counts as flying."""
    return vehicle.armed and vehicle.landed is not LandedState.ON_GROUND
