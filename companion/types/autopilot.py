"""What autopilot and agent exchange: telemetry samples, setpoints and requests; and the state of the own vehicle."""

from __future__ import annotations

from enum import IntEnum, StrEnum

from msgspec import Struct

from companion.types.values import ZERO3, Finite, Place, Vector3


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


class PositionAid(StrEnum):
    """Whether the estimator uses a sensor of position or velocity, or whether GPS has a 3D fix."""

    NOT_REPORTED = "not_reported"
    USED = "used"
    NOT_USED = "not_used"
    FIX = "fix"
    NO_FIX = "no_fix"


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
    ground_position_enu_m: Vector3 | None = None  # last disarmed position on the ground
    home_enu_m: Place | None = None  # the autopilot's home, where its return ends; None where it is not reported
    returns_elsewhere: str = ""  # why its return may end at another place
    frame_known: bool = False  # whether positions can be mapped into the fleet frame
    ground_unknown: bool = False  # armed, and the height of its take-off is unknown, from which z would count
    altitude_amsl_m: float | None = None  # relative to the autopilot's origin; None until that is known
    frame_contradicted: bool = False  # the autopilot's origin and its global position disagree
    held_back_m: float = 0.0  # distance between the position used and the autopilot's
    jump_time_s: float = float("-inf")  # when the autopilot's position last jumped
    position_error: PositionError | None = None  # None if it was never reported; it grows while the position is unaided
    position_unaided: bool = False  # the autopilot has lost GPS or vision, and dead-reckons
    pose_time_s: float = float("inf")  # when the newest pose passed on was measured; infinite where none are needed
    pose_refused_s: float = float("-inf")  # when a pose was last refused
    pose_fault: str = ""  # why
    failsafe_s: float = float("-inf")  # when the armed autopilot last reported a failsafe of its own
    estimator_healthy: bool = True  # as last reported; True where it is not reported
    battery_percent: float = -1.0  # -1 where unknown
    interleaves: bool = False  # two autopilots with one system id send, or one over two ways


def in_air(vehicle: VehicleState) -> bool:
    """Armed and not known to be on the ground: an unknown landed state counts as flying."""
    return vehicle.armed and vehicle.landed is not LandedState.ON_GROUND


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
    """Take off vertically, to a height above the ground; PX4 needs the altitude above sea level of the same place."""

    height_m: float
    altitude_amsl_m: float = float("nan")


class RequestOrigin(Struct, frozen=True, gc=False):
    """Ask for GPS_GLOBAL_ORIGIN, which PX4 sends once and on change."""


class SetOrigin(Struct, frozen=True, gc=False):
    """SET_GPS_GLOBAL_ORIGIN, for an autopilot without GPS: the place of the zero of its local frame."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float


class RequestParameter(Struct, frozen=True, gc=False):
    """Ask for one parameter. No request sets one: the agent only reads."""

    name: str


AutopilotRequest = SetMode | Arm | Disarm | TakeOff | RequestOrigin | SetOrigin | RequestParameter


class PositionSample(Struct, frozen=True, gc=False):
    """LOCAL_POSITION_NED, in ENU about the autopilot's own origin. `late_s`: its age on arrival, 0 where that is usual."""

    received_s: float
    boot_time_s: float
    position_local_enu_m: Vector3
    velocity_enu_m_s: Vector3
    late_s: float = 0.0


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
    """HEARTBEAT of the autopilot: its armed flag and its make. `critical`: MAV_STATE_CRITICAL or worse.

    `interleaves`: two streams with the autopilot's system id arrive in turn.
    """

    received_s: float
    armed: bool
    autopilot: AutopilotKind
    critical: bool = False
    interleaves: bool = False


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


class HomeSample(Struct, frozen=True, gc=False):
    """HOME_POSITION: where a return ends, unless rally points or parameters say otherwise. ArduPilot's local fields are 0."""

    received_s: float
    latitude_deg: float
    longitude_deg: float


class RallySample(Struct, frozen=True, gc=False):
    """MISSION_CURRENT: whether rally points are stored in the autopilot. ArduPilot has a parameter for that."""

    received_s: float
    has_rally_points: bool


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
    """Position error that the estimator reports, one sigma; not finite if unknown. `healthy`: its position may be used.

    `aid`: what it says of the sensors that aid the position.
    """

    received_s: float
    horizontal_error_m: float
    vertical_error_m: float
    healthy: bool = True
    aid: PositionAid = PositionAid.NOT_REPORTED


class AckSample(Struct, frozen=True, gc=False):
    """COMMAND_ACK. `answers` are the request types of the acknowledged command; `reason` is the result as text."""

    received_s: float
    answers: tuple[type, ...]
    accepted: bool
    reason: str


class TextSample(Struct, frozen=True, gc=False):
    """One complete STATUSTEXT. `failsafe`: it reports one that begins."""

    received_s: float
    severity: int
    text: str
    failsafe: bool = False


class GroundSample(Struct, frozen=True, gc=False):
    """The ground of the last take-off, as the agent that ran before kept it: for an agent that starts again in the air.

    `ground_up_m` is the height that z counts from, above the fleet's origin or the local one. It holds for the start of the
    autopilot at `booted_s` of this computer's clock, to within `within_s`.
    """

    received_s: float
    ground_up_m: float
    booted_s: float
    within_s: float


class PoseSample(Struct, frozen=True, gc=False):
    """A motion-capture pose of this vehicle: passed on to the autopilot, or refused for a `fault`, which is a short text."""

    received_s: float
    measured_s: float
    fault: str = ""


Telemetry = (
    PositionSample
    | AttitudeSample
    | ModeSample
    | HeartbeatSample
    | LandedSample
    | ThrustSample
    | OriginSample
    | HomeSample
    | RallySample
    | SystemSample
    | ParameterSample
    | GlobalPositionSample
    | EstimatorSample
    | AckSample
    | TextSample
    | GroundSample
    | PoseSample
)
