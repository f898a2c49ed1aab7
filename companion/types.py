"""Frozen values that travel between the rooms of the house.

World frame: ENU (x east, y north, z up), metres from the fleet origin. Body frame: FLU (x forward, y left, z up).
Euler angles are roll phi, pitch theta, yaw psi with R = Rz(psi) Ry(theta) Rx(phi), in radians. At psi = 0 a positive
pitch accelerates towards +x and a positive roll towards -y. Times are seconds of the agent's own monotonic clock.

A hundred of them are made in every tick, so they are Structs, which cost a sixth of a frozen dataclass to make; none holds
anything that could hold it, so the collector need not look for cycles (gc=False).
"""

from __future__ import annotations

from enum import IntEnum, StrEnum

from msgspec import Struct

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
    RETURN = "return"  # home and down, by the autopilot alone


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
    RETURN = "return"  # home, and down there
    OTHER = "other"


class LandedState(IntEnum):
    """MAV_LANDED_STATE of EXTENDED_SYS_STATE."""

    UNDEFINED = 0
    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


# ---------------------------------------------------------------- telemetry: autopilot -> agent


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
    """The flight mode as the autopilot itself reports it; `name` is the autopilot's own word for it."""

    received_s: float
    mode: AutopilotMode
    name: str


class HeartbeatSample(Struct, frozen=True, gc=False):
    """HEARTBEAT of the autopilot: its armed flag, and what make it is."""

    received_s: float
    armed: bool
    autopilot: AutopilotKind


class LandedSample(Struct, frozen=True, gc=False):
    """EXTENDED_SYS_STATE."""

    received_s: float
    landed: LandedState


class ThrustSample(Struct, frozen=True, gc=False):
    """ATTITUDE_TARGET: the collective thrust in 0..1 that the autopilot itself commands just now."""

    received_s: float
    thrust_norm: float


class OriginSample(Struct, frozen=True, gc=False):
    """GPS_GLOBAL_ORIGIN: where the autopilot's own local frame begins."""

    received_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float


class SystemSample(Struct, frozen=True, gc=False):
    """SYS_STATUS: the battery's charge, -1 where the autopilot does not know it, and whether its own checks let it arm."""

    received_s: float
    battery_percent: float
    may_arm: bool


class ParameterSample(Struct, frozen=True, gc=False):
    """One parameter of the autopilot, by the autopilot's own name."""

    received_s: float
    name: str
    value: float


class GlobalPositionSample(Struct, frozen=True, gc=False):
    """GLOBAL_POSITION_INT: the same estimate as PositionSample's, in degrees and metres above mean sea level."""

    received_s: float
    boot_time_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float


class EstimatorSample(Struct, frozen=True, gc=False):
    """What the autopilot's estimator reports of its own position error, one sigma; not finite where it does not know."""

    received_s: float
    horizontal_error_m: float
    vertical_error_m: float


class AckSample(Struct, frozen=True, gc=False):
    """COMMAND_ACK. `answers` are the kinds of request that the command stands for; `reason` says the result in words."""

    received_s: float
    answers: tuple[type, ...]
    accepted: bool
    reason: str


class TextSample(Struct, frozen=True, gc=False):
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


class PositionError(Struct, frozen=True, gc=False):
    """One sigma of an estimator's position by its own account, in the plane and in height."""

    horizontal_m: float
    vertical_m: float


class VehicleState(Struct, frozen=True, gc=False):
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
    stood_enu_m: Vector3 | None = None  # when it was last seen disarmed on the ground: its autopilot's home
    frame_known: bool = False  # can positions be mapped into the fleet frame?
    altitude_amsl_m: float | None = None  # by the autopilot's own origin, None until that is known
    frame_contradicted: bool = False  # do the autopilot's origin and its global position exclude each other?
    held_back_m: float = 0.0  # distance of the position used from the autopilot's
    jump_time_s: float = float("-inf")  # when the autopilot's position last jumped
    position_error: PositionError | None = None  # None where the estimator says nothing of it, or said it long ago


# ---------------------------------------------------------------- agent -> autopilot


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
    """Climb where the vehicle stands. `altitude_amsl_m` for PX4, `height_m` above the ground for ArduPilot."""

    altitude_amsl_m: float
    height_m: float


class RequestOrigin(Struct, frozen=True, gc=False):
    """Ask for GPS_GLOBAL_ORIGIN, which PX4 sends once and on change."""


class RequestParameter(Struct, frozen=True, gc=False):
    """Ask for one parameter. There is none that sets one: the agent only reads."""

    name: str


AutopilotRequest = SetMode | Arm | Disarm | TakeOff | RequestOrigin | RequestParameter


# ---------------------------------------------------------------- peers, commands, status


Term = tuple[
    int, int
]  # (epoch, minus the claim's rank): which lead is the newer, and a commanded one beats a claimed one


class Heading(Struct, frozen=True, gc=False):
    """Where the x axis of the formation's own frame points: 0 east, pi/2 north, from -pi to pi; and how it turns."""

    angle_rad: float = 0.0
    rate_rad_s: float = 0.0
    acceleration_rad_s2: float = 0.0


EAST = Heading()


class LeaderWord(Struct, frozen=True, gc=False):
    """What a vehicle has heard of its leader, passed on hop by hop with the PrC.

    Only the leader moves `stamp` on (milliseconds of its own clock), so no word gets younger on its way through the others.
    `epoch` counts the changes of the lead; `reference_s` is how far into the RFT the leader is at the time of the packet that
    carries the word, 0 while it does not fly it; `heading` is its formation's, likewise. `claim` is 0 where the lead was
    commanded, or is the fleet file's; a successor that took it from a lost leader tells its rank, from 1.
    """

    leader_id: int
    epoch: int
    stamp: int
    reference_s: float = 0.0
    claim: int = 0
    heading: Heading = EAST

    @property
    def term(self) -> Term:
        return (self.epoch, -self.claim)


class FlownSlot(Struct, frozen=True, gc=False):
    """A vehicle's place d_i0 about the RFT as it flies it just now, and how it moves while the formation changes or turns.

    `formation` counts the formations that were commanded, the fleet file's is 0; `waiting` is the one that is to come, the
    same where none is. `moves`: within the formation, as it changes or is joined; that the formation turns does not count.
    """

    position_enu_m: Vector3
    velocity_enu_m_s: Vector3 = ZERO3
    acceleration_enu_m_s2: Vector3 = ZERO3
    formation: int = 0
    waiting: int = 0
    moves: bool = False


class HeldReference(Struct, frozen=True, gc=False):
    """Which RFT a vehicle that may lead holds: `flown` counts those commanded, the file's is 0; `waiting` is to come.

    `begun_s` is when by the fleet's time the one flown began.
    """

    flown: int = 0
    waiting: int = 0  # the same where none is to come
    begun_s: float = 0.0


class FormationChange(Struct, frozen=True, gc=False, tag=True):
    """Other slots d_i0 for every vehicle of the fleet, gone to in step: from `begins_s` of the fleet's time (the RFT's) on.

    Nobody flies in the slots of those that are `absent`: their ways may cross the others', and it begins only while they are.
    """

    number: int
    slots_enu_m: tuple[tuple[int, Vector3], ...]
    begins_s: float
    lasts_s: float
    absent: tuple[int, ...] = ()


class PeerPacket(Struct, frozen=True, gc=False):
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
    slot: FlownSlot
    position_error: PositionError | None = None  # None where the estimator does not tell
    reference: HeldReference | None = None  # None where it may not lead
    change: FormationChange | None = None  # passed on by who leads in formation to those that do not have it
    armed: bool = True


class ReceivedPeerPacket(Struct, frozen=True, gc=False):
    received_s: float
    packet: PeerPacket


class TargetSample(Struct, frozen=True, gc=False, forbid_unknown_fields=True):
    """What something to be followed tells of itself, in the fleet frame; without a position (a joystick) its velocity alone.

    `sent_s` is of the sender's own monotonic clock; `session` tells a restart (sequence back to 0) from a replay.
    """

    session: int
    sequence: int
    sent_s: float
    velocity_enu_m_s: Vector3
    position_enu_m: Vector3 | None = None


class ReceivedTarget(Struct, frozen=True, gc=False):
    received_s: float
    name: str
    sample: TargetSample


class CommandName(StrEnum):
    """What an operator or a scenario may ask of a vehicle."""

    PREPARE = "prepare"
    ARM = "arm"
    TAKEOFF = "takeoff"
    FORM = "form"
    HOLD = "hold"
    LAND = "land"
    RETURN = "return"
    DISARM = "disarm"
    LEAD = "lead"
    FORMATION = "formation"
    REFERENCE = "reference"
    TAKE = "take"  # command itself, from whoever holds it
    ABORT = "abort"  # to the safest that is near: disarmed on the ground, the autopilot's own hold in the air


MAX_EPOCH = 2**31 - 1
MAX_EPOCHS_AHEAD = 1000  # of a vehicle's own; so many changes may it have missed


class Lead(Struct, frozen=True, gc=False, tag=True):
    """Who leads from now on; all others follow. Every vehicle is told, and none goes back to an older epoch."""

    leaders: tuple[int, ...]
    epoch: int


Described = dict[str, bool | int | float | str | list[float | list[float]]]
"""A section of a file as plain values."""


class ReferenceChange(Struct, frozen=True, gc=False, tag=True):
    """Another RFT for those that may lead, from `begins_s` of the fleet's time on, when its own time begins.

    `reference` is what the section `reference` of a file holds.
    """

    number: int
    reference: Described
    begins_s: float


Content = Lead | FormationChange | ReferenceChange


class Command(Struct, frozen=True, gc=False):
    """Obeyed once: `core/command_desk.py` says by whom, and which are old."""

    name: CommandName
    number: int  # newer than the last one's that the vehicle had, echoed in the reply
    operator: str  # whose command it is, the same over all that one operator starts
    session: int  # of the vehicle it is meant for, as its status tells
    content: Content | None = None  # what CONTENT says, of this name


CONTENT: dict[CommandName, type] = {
    CommandName.LEAD: Lead,
    CommandName.FORMATION: FormationChange,
    CommandName.REFERENCE: ReferenceChange,
}


class CommandReply(Struct, frozen=True, gc=False):
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
    LEADER_AWAITED = "no leader's word for a moment"
    LEADER_LOST = "no leader's word"
    FENCE = "outside the fence"
    FRAME_CONTRADICTED = "the autopilot's origin and its global position contradict each other"
    POSITION_JUMPED = "the autopilot's position jumped too far to be believed"


WITHOUT_LEADER = frozenset({HealthFlag.LEADER_AWAITED, HealthFlag.LEADER_LOST})


class FailsafeAction(IntEnum):
    """Ranked: the highest of all raised flags wins."""

    NONE = 0
    HOLD = 1  # hand over to the autopilot's own hold
    SILENT = 2  # no fresh decision is possible: send nothing, the autopilot's own failsafe acts


class Status(Struct, frozen=True, gc=False):
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
    slot: FlownSlot  # in the formation's own frame, which has `heading`
    reference_enu_m: Vector3 | None  # leaders only
    flags: tuple[HealthFlag, ...]
    rejected: dict[str, int]  # counted rejections by reason
    last_event: str
    reference_s: float = 0.0  # how far into the RFT the fleet is, as this vehicle counts
    reference: HeldReference | None = None  # None where it may not lead
    target_age_s: float | None = None  # of the target that the RFT follows; None where there is none, or none is heard
    lacks: tuple[str, ...] = ()  # while it is disarmed: what, besides its flags, forbids a flight in formation
    holder: str = ""  # the operator who holds command, "" nobody
    command_number: int = 0  # of the last command that it had
    peers: tuple[int, ...] = ()  # all others that are heard of just now, whatever they do
    battery_percent: float | None = None  # None where the autopilot does not know
    position_error: PositionError | None = None
    largest_step_deg: float = 0.0  # of the commanded attitude, setpoint to setpoint, in the last stream of them
    heading: Heading = EAST


class Inbox(Struct, frozen=True, gc=False):
    """All that came in since the last tick. `stopping`: the process is to end; a formation is handed over first."""

    telemetry: tuple[Telemetry, ...] = ()
    peers: tuple[ReceivedPeerPacket, ...] = ()
    commands: tuple[Command, ...] = ()
    stopping: bool = False
    targets: tuple[ReceivedTarget, ...] = ()


class Outbox(Struct, frozen=True, gc=False):
    """All that one tick decided. `attitude_target` is None whenever there is no fresh decision."""

    attitude_target: AttitudeTarget | None = None
    requests: tuple[AutopilotRequest, ...] = ()
    peer_packet: PeerPacket | None = None
    status: Status | None = None
    replies: tuple[CommandReply, ...] = ()
    events: tuple[str, ...] = ()
