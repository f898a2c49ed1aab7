"""Messages of others: peers of the fleet, targets, traffic that a receiver of ADS-B reports, and motion-capture poses."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from companion.types.autopilot import PositionError
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange, HeldReference, LeaderBeacon
from companion.types.values import Finite, Number, Part, Place, Position, Vector3, VehicleId

FORGOTTEN_S = 600.0  # a vehicle that is silent for so long is no obstacle any more: its battery lasts no longer
MOST_LOST = 8  # so many in a packet
MOST_VALUES = 4  # vectors that a law may publish

LostAge = Annotated[float, Meta(ge=0, le=FORGOTTEN_S)]
TermSignature = Annotated[bytes, Meta(min_length=64, max_length=64)]
"""ECDSA P-256: r and s, 32 bytes each."""


class Sender(Part, frozen=True, gc=False):
    """Who sends, and which packet this is. `session` is the random number of a start: it tells a restart from a replay."""

    vehicle_id: int
    session: int
    sequence: int
    formation_hash: int


class Motion(Part, frozen=True, gc=False):
    """Position and velocity, and the last acceleration command; of a vehicle under a pilot what its attitude shows.

    `state_age_s` is the age of the position at `sent_s`, which is of the sender's monotonic clock.
    """

    position_enu_m: Vector3
    velocity_enu_m_s: Vector3
    acceleration_enu_m_s2: Vector3
    state_age_s: float
    sent_s: float


class TermProof(Struct, frozen=True, gc=False):
    """The signature of a term's leader, as `companion/security/terms.py` makes it. `session`: of the agent that signed."""

    session: Number
    signature: TermSignature


class LeaderReport(Part, frozen=True, gc=False):
    """What a vehicle knows of the leader: hops to it + 1, and its newest beacon, None without a fresh one.

    `proof`: that the leader in the beacon has stated its term. Only links of vehicles with identities add it.
    """

    prc: int
    beacon: LeaderBeacon | None
    proof: TermProof | None = None


class LostVehicle(Struct, frozen=True, gc=False):
    """A vehicle that was armed when it fell silent, by its last packet. `age_s`: of its state, when this is sent."""

    vehicle_id: VehicleId
    position_enu_m: Position
    velocity_enu_m_s: Vector3
    age_s: LostAge


class PeerPacket(Struct, frozen=True, gc=False):
    """State of a vehicle that it publishes to its peers at every tick.

    `change` is from a leader in formation, for vehicles that lack the change. `rft` is the state of the RFT (position,
    velocity, acceleration) by which a vehicle flies that is kept off its slot; None where its own position minus its slot
    counts. `home_enu_m` is where its autopilot's return ends, None where that is not certain. `lost` tells vehicles that start
    later of those that are silent and may still be in the air. `law_values` is what
    the law publishes of its own, at most MOST_VALUES vectors in formation; the formation hash contains the law. The order of
    the fields is that of the bytes.
    """

    sender: Sender
    phase: FlightPhase
    role: Role
    motion: Motion
    leader: LeaderReport
    slot: FlownSlot
    position_error: PositionError | None = None  # None if the estimator does not report it
    reference: HeldReference | None = None  # None if the vehicle may not lead
    change: FormationChange | None = None
    armed: bool = True
    rft: tuple[Vector3, Vector3, Vector3] | None = None
    home_enu_m: Place | None = None
    lost: tuple[LostVehicle, ...] = ()
    law_values: tuple[Vector3, ...] = ()


class ReceivedPeerPacket(Struct, frozen=True, gc=False):
    """`proven`: not False where the term in the packet's beacon is hearsay, and vehicles have identities."""

    received_s: float
    packet: PeerPacket
    proven: bool = True


class TargetSample(Struct, frozen=True, gc=False, forbid_unknown_fields=True):
    """State of a target in the fleet frame; velocity alone for a joystick.

    `sent_s` is of the sender's monotonic clock; `session` distinguishes a restart (sequence 0) from
    a replay.
    """

    session: Number
    sequence: Number
    sent_s: float
    velocity_enu_m_s: Vector3
    position_enu_m: Vector3 | None = None


class ReceivedTarget(Struct, frozen=True, gc=False):
    received_s: float
    name: str
    sample: TargetSample


MAX_TRAFFIC_SPEED_M_S = 350.0
TrafficSpeed = Annotated[float, Meta(ge=-MAX_TRAFFIC_SPEED_M_S, le=MAX_TRAFFIC_SPEED_M_S)]


class TrafficSample(Struct, frozen=True, gc=False, forbid_unknown_fields=True):
    """Position and velocity in the fleet frame, `age_s` old when sent.

    `error_m` is one standard deviation of the position. `height` says what the third coordinate is: a height in the fleet
    frame, or nothing, where its sender does not know to what the reported one refers. Samples have no counter: two receivers
    may report one aircraft, and the newest position is used.
    """

    position_enu_m: Position
    velocity_enu_m_s: tuple[TrafficSpeed, TrafficSpeed, TrafficSpeed]
    age_s: Annotated[float, Meta(ge=0, le=10)] = 0.0
    error_m: Annotated[float, Meta(ge=0, le=100)] = 0.0
    height: Literal["fleet", "unknown"] = "fleet"


class ReceivedTraffic(Struct, frozen=True, gc=False):
    """A sample with its name on the network, such as the ICAO address of an aircraft."""

    received_s: float
    name: str
    sample: TrafficSample


Unit = Annotated[float, Meta(ge=-1.0, le=1.0)]
MAX_POSE_AGE_S = 10.0


class BodyPose(Struct, frozen=True, gc=False, forbid_unknown_fields=True):
    """Pose of a vehicle in the fleet frame, as a motion-capture system measured it, `age_s` old when sent.

    `quaternion` (w, x, y, z) turns the FLU body into ENU. `sent_s` is of the sender's monotonic clock; `session` tells a
    restart (sequence 0) from a replay. Each vehicle has a sequence of its own.
    """

    session: Number
    sequence: Number
    sent_s: Finite
    position_enu_m: Position
    quaternion: tuple[Unit, Unit, Unit, Unit]
    age_s: Annotated[float, Meta(ge=0, le=MAX_POSE_AGE_S)] = 0.0
