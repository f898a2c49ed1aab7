"""Frozen values that travel between the rooms of the house.

World frame: ENU (x east, y north, z up), metres from the fleet origin. Body frame: FLU (x forward, y left, z up).
Euler angles are roll phi, pitch theta, yaw psi with R = Rz(psi) Ry(theta) Rx(phi), in radians. At psi = 0 a positive
pitch accelerates towards +x and a positive roll towards -y. Times are seconds of the agent's own monotonic clock.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum, StrEnum

Vector3 = tuple[float, float, float]
ZERO3: Vector3 = (0.0, 0.0, 0.0)

GRAVITY_M_S2 = 9.80665


class Role(StrEnum):
    """A leader flies by the reference formation trajectory (RFT); a follower never does."""

    LEADER = "leader"
    FOLLOWER = "follower"


class FlightPhase(StrEnum):
    """What the agent is doing. `core/phase.py` holds the table of transitions."""

    OBSERVE = "observe"  # sends nothing to the autopilot; the phase after start and after a pilot's take-over
    PREPARE = "prepare"
    READY = "ready"
    ARM = "arm"
    ARMED = "armed"
    TAKEOFF = "takeoff"
    HOLD = "hold"  # the autopilot's own position hold
    ENGAGE = "engage"  # setpoints stream, the autopilot has not yet taken them
    FORMATION = "formation"
    RELEASE = "release"  # leaving formation: setpoints stream until the autopilot has taken over
    LAND = "land"


class AutopilotKind(StrEnum):
    """Whose manners the autopilot has. `companion/mavlink/manners.py` and `core/flight_manners.py` hold them."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"


class AutopilotMode(StrEnum):
    """Flight modes by meaning, the same for every autopilot. OTHER covers every mode the agent never commands."""

    UNKNOWN = "unknown"
    HOLD = "hold"
    TAKEOFF = "takeoff"
    OFFBOARD = "offboard"
    LAND = "land"
    OTHER = "other"


class LandedState(IntEnum):
    """MAV_LANDED_STATE of EXTENDED_SYS_STATE."""

    UNDEFINED = 0
    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


# ---------------------------------------------------------------- telemetry: autopilot -> agent


@dataclass(frozen=True, slots=True)
class PositionSample:
    """LOCAL_POSITION_NED, in ENU about the autopilot's own origin."""

    received_s: float
    boot_time_s: float
    position_local_enu_m: Vector3
    velocity_enu_m_s: Vector3


@dataclass(frozen=True, slots=True)
class AttitudeSample:
    """ATTITUDE_QUATERNION as Euler angles of the FLU body in ENU."""

    received_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class ModeSample:
    """The flight mode as the autopilot itself reports it; `name` is the autopilot's own word for it."""

    received_s: float
    mode: AutopilotMode
    name: str


@dataclass(frozen=True, slots=True)
class HeartbeatSample:
    """HEARTBEAT of the autopilot: its armed flag, and what make it is."""

    received_s: float
    armed: bool
    autopilot: AutopilotKind


@dataclass(frozen=True, slots=True)
class LandedSample:
    """EXTENDED_SYS_STATE."""

    received_s: float
    landed: LandedState


@dataclass(frozen=True, slots=True)
class ThrustSample:
    """ATTITUDE_TARGET: the collective thrust in 0..1 that the autopilot itself commands just now."""

    received_s: float
    thrust_norm: float


@dataclass(frozen=True, slots=True)
class OriginSample:
    """GPS_GLOBAL_ORIGIN: where the autopilot's own local frame begins."""

    received_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float


@dataclass(frozen=True, slots=True)
class SystemSample:
    """SYS_STATUS: the battery's charge, -1 where the autopilot does not know it, and whether its own checks let it arm."""

    received_s: float
    battery_percent: float
    may_arm: bool


@dataclass(frozen=True, slots=True)
class ParameterSample:
    """One parameter of the autopilot, by the autopilot's own name."""

    received_s: float
    name: str
    value: float


@dataclass(frozen=True, slots=True)
class GlobalPositionSample:
    """GLOBAL_POSITION_INT: the same estimate as PositionSample's, in degrees and metres above mean sea level."""

    received_s: float
    boot_time_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float


@dataclass(frozen=True, slots=True)
class EstimatorSample:
    """What the autopilot's estimator reports of its own position error, one sigma; not finite where it does not know."""

    received_s: float
    horizontal_error_m: float
    vertical_error_m: float


@dataclass(frozen=True, slots=True)
class AckSample:
    """COMMAND_ACK. `answers` are the kinds of request that the command stands for; `reason` says the result in words."""

    received_s: float
    answers: tuple[type, ...]
    accepted: bool
    reason: str


@dataclass(frozen=True, slots=True)
class TextSample:
    """One whole STATUSTEXT."""

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


@dataclass(frozen=True, slots=True)
class PositionError:
    """One sigma of an estimator's position by its own account, in the plane and in height."""

    horizontal_m: float
    vertical_m: float


@dataclass(frozen=True, slots=True)
class VehicleState:
    """All that is known of the own vehicle, in the fleet frame. Samples that never came have time -inf.

    `position_enu_m` is the position used: where the autopilot's jumps in flight, this one stays and follows slowly.
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
    frame_known: bool = False  # can positions be mapped into the fleet frame?
    altitude_amsl_m: float | None = None  # by the autopilot's own origin, None until that is known
    frame_contradicted: bool = False  # do the autopilot's origin and its global position exclude each other?
    held_back_m: float = 0.0  # distance of the position used from the autopilot's
    jump_time_s: float = float("-inf")  # when the autopilot's position last jumped
    position_error: PositionError | None = None  # None where the estimator says nothing of it, or said it long ago


# ---------------------------------------------------------------- agent -> autopilot


@dataclass(frozen=True, slots=True)
class AttitudeTarget:
    """SET_ATTITUDE_TARGET: Euler angles of the FLU body in ENU and the collective thrust in 0..1."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    thrust_norm: float


@dataclass(frozen=True, slots=True)
class SetMode:
    mode: AutopilotMode


@dataclass(frozen=True, slots=True)
class Arm:
    pass


@dataclass(frozen=True, slots=True)
class Disarm:
    pass


@dataclass(frozen=True, slots=True)
class TakeOff:
    """Climb where the vehicle stands. `altitude_amsl_m` for PX4, `height_m` above the ground for ArduPilot."""

    altitude_amsl_m: float
    height_m: float


@dataclass(frozen=True, slots=True)
class RequestOrigin:
    """Ask for GPS_GLOBAL_ORIGIN, which PX4 sends once and on change."""


@dataclass(frozen=True, slots=True)
class RequestParameter:
    """Ask for one parameter. There is none that sets one: the agent only reads."""

    name: str


AutopilotRequest = SetMode | Arm | Disarm | TakeOff | RequestOrigin | RequestParameter


# ---------------------------------------------------------------- peers, commands, status


@dataclass(frozen=True, slots=True)
class LeaderWord:
    """What a vehicle has heard of its leader, passed on hop by hop with the PrC.

    Only the leader moves `stamp` on (milliseconds of its own clock), so no word gets younger on its way through the others.
    `epoch` counts the changes of the lead; `reference_s` is how far into the RFT the leader is at the time of the packet that
    carries the word, 0 while it does not fly it.
    """

    leader_id: int
    epoch: int
    stamp: int
    reference_s: float = 0.0


@dataclass(frozen=True, slots=True)
class PeerPacket:
    """What a vehicle tells its peers at every tick.

    `state_age_s` is the position's age when the packet was made, at `sent_s` of the sender's own monotonic clock.
    """

    vehicle_id: int
    session: int  # drawn at start-up: tells a restart (sequence back to 0) from a replay
    sequence: int
    formation_hash: int
    phase: FlightPhase
    role: Role
    position_enu_m: Vector3
    velocity_enu_m_s: Vector3
    acceleration_enu_m_s2: Vector3
    state_age_s: float
    sent_s: float
    prc: int
    leader_word: LeaderWord | None
    position_error: PositionError | None = None  # None where the estimator does not tell


@dataclass(frozen=True, slots=True)
class ReceivedPeerPacket:
    received_s: float
    packet: PeerPacket


class CommandName(StrEnum):
    """What an operator or a scenario may ask of a vehicle."""

    PREPARE = "prepare"
    ARM = "arm"
    TAKEOFF = "takeoff"
    FORM = "form"
    HOLD = "hold"
    LAND = "land"
    DISARM = "disarm"
    LEAD = "lead"


MAX_EPOCH = 2**31 - 1
MAX_EPOCHS_AHEAD = 1000  # of a vehicle's own; so many changes may it have missed


@dataclass(frozen=True, slots=True)
class Lead:
    """Who leads from now on; all others follow. Every vehicle is told, and none goes back to an older epoch."""

    leaders: tuple[int, ...]
    epoch: int


@dataclass(frozen=True, slots=True)
class Command:
    name: CommandName
    number: int  # the sender's own count, echoed in the reply
    lead: Lead | None = None  # of CommandName.LEAD, and of no other


@dataclass(frozen=True, slots=True)
class CommandReply:
    vehicle_id: int
    number: int
    accepted: bool
    reason: str  # why refused, or what happens now


class HealthFlag(StrEnum):
    """What is wrong just now. `core/failsafe.py` ranks what follows."""

    STATE_STALE = "position older than allowed"
    ATTITUDE_STALE = "attitude older than allowed"
    MODE_STALE = "flight mode older than allowed"
    FRAME_UNKNOWN = "the autopilot's origin is unknown"
    ARMED_STALE = "armed state older than allowed"
    LANDED_STALE = "landed state older than allowed"
    LEADER_LOST = "no leader's word"
    FENCE = "outside the fence"
    FRAME_CONTRADICTED = "the autopilot's origin and its global position contradict each other"
    POSITION_JUMPED = "the autopilot's position jumped too far to be believed"


class FailsafeAction(IntEnum):
    """Ranked: the highest of all raised flags wins."""

    NONE = 0
    HOLD = 1  # hand over to the autopilot's own hold
    SILENT = 2  # no fresh decision is possible: send nothing, the autopilot's own failsafe acts


@dataclass(frozen=True, slots=True)
class Status:
    """What a vehicle tells the ground a few times a second."""

    vehicle_id: int
    session: int
    fleet: str
    formation_hash: int
    law: str
    phase: FlightPhase
    mode_name: str
    armed: bool
    landed: LandedState
    position_enu_m: Vector3
    velocity_enu_m_s: Vector3
    state_age_s: float
    hover_thrust_norm: float  # as it was found, or was begun with
    disturbance_enu_m_s2: Vector3  # what was found to push it, its own drag apart; z is always 0
    role: Role
    epoch: int  # of the lead, as this vehicle knows it
    prc: int
    leader_word: LeaderWord | None
    leader_word_age_s: float | None
    neighbours: tuple[int, ...]
    slot_enu_m: Vector3
    reference_enu_m: Vector3 | None  # leaders only
    flags: tuple[HealthFlag, ...]
    rejected: dict[str, int]  # counted rejections by reason
    last_event: str
    lacks: tuple[str, ...] = ()  # while it is disarmed: what, besides its flags, forbids a flight in formation


@dataclass(frozen=True, slots=True)
class Inbox:
    """All that came in since the last tick. `stopping`: the process is to end; a formation is handed over first."""

    telemetry: tuple[Telemetry, ...] = ()
    peers: tuple[ReceivedPeerPacket, ...] = ()
    commands: tuple[Command, ...] = ()
    stopping: bool = False


@dataclass(frozen=True, slots=True)
class Outbox:
    """All that one tick decided. `attitude_target` is None whenever there is no fresh decision."""

    attitude_target: AttitudeTarget | None = None
    requests: tuple[AutopilotRequest, ...] = ()
    peer_packet: PeerPacket | None = None
    status: Status | None = None
    replies: tuple[CommandReply, ...] = ()
    events: tuple[str, ...] = field(default=())
