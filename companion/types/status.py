"""What a vehicle reports to the ground, the report of its separation filter among it."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from msgspec import Meta, Struct

from companion.types.autopilot import LandedState, PositionError
from companion.types.commands import Described
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.formation import EAST, FlownSlot, Heading, HeldReference, LeaderBeacon
from companion.types.notices import Notice
from companion.types.values import (
    MAX_VEHICLES,
    Finite,
    FiniteVector,
    FleetName,
    Number,
    Part,
    VehicleId,
    VehicleIds,
    Word,
)


class NearestVehicle(Struct, frozen=True, gc=False):
    """The vehicle with the least room above its required distance, at present. In distances a height counts half.

    `name` is its id in the fleet, or the name of the traffic. `required_m` is `separation_m` with all margins.
    """

    name: Word
    distance_m: Finite
    required_m: Finite


class SeparationReport(Struct, frozen=True, gc=False):
    """What the separation filter sees and does. `changed_m_s2` is the change of the commanded acceleration, 0 without one.

    `violated`: a vehicle is nearer than `separation_m`, by the own position and its last packet. It may be another one than
    `nearest`, whose required distance may be larger. `unshaken`: names of vehicles that no evasion shakes off.
    """

    nearest: NearestVehicle | None = None
    changed_m_s2: Finite = 0.0
    violated: bool = False
    unshaken: Annotated[tuple[Word, ...], Meta(max_length=MAX_VEHICLES)] = ()


NO_STATE_AGE_S = 1e6  # before the first position, or as good as that
OfNeighbours = Annotated[tuple[Finite, ...], Meta(max_length=MAX_VEHICLES)]
Notices = Annotated[tuple[Notice, ...], Meta(max_length=100)]


class NetworkState(Struct, frozen=True, gc=False):
    """How the agent is protected in the network of its fleet.

    `security`: `local`, reached from its own machine only; `identity`, by certificates; `none`. `admission`: number of the
    admission list it holds.
    """

    security: Literal["local", "identity", "none"] = "local"
    admission: Number | None = None


class RecordingState(Struct, frozen=True, gc=False):
    """Whether the agent records this flight. `dropped` records were lost so far, to a full or a slow disk."""

    state: Literal["off", "on", "dropping"] = "off"
    dropped: Number = 0


class AgentIdentity(Part, frozen=True, gc=False):
    """The vehicle and its configuration. `session` differs from one start of this vehicle's agent to the next."""

    vehicle_id: VehicleId
    session: Number
    fleet: FleetName
    formation_hash: int
    law: Word


class AutopilotReport(Part, frozen=True, gc=False):
    mode_name: Word
    armed: bool
    landed: LandedState
    battery_percent: Finite | None = None  # None if the autopilot does not report it


class MotionReport(Part, frozen=True, gc=False):
    """`state_age_s` is the age of the position, NO_STATE_AGE_S at most: then there is neither position nor velocity."""

    position_enu_m: FiniteVector
    velocity_enu_m_s: FiniteVector
    state_age_s: Finite
    position_error: PositionError | None = None

    @property
    def is_known(self) -> bool:
        """Whether there is a position; where there is none, position and velocity are zeros that say nothing."""
        return self.state_age_s < NO_STATE_AGE_S


class ControlReport(Part, frozen=True, gc=False):
    hover_thrust_norm: Finite  # estimated, or its initial value
    disturbance_enu_m_s2: FiniteVector  # estimated acceleration by wind, without drag; z is always 0
    largest_step_deg: Finite = 0.0  # of the commanded attitude between two setpoints, in the last stream


class LeadershipReport(Part, frozen=True, gc=False):
    role: Role
    epoch: Number  # of the leadership, as this vehicle knows it
    prc: VehicleId
    leader_beacon: LeaderBeacon | None
    leader_beacon_age_s: Finite | None


class NeighbourReport(Part, frozen=True, gc=False):
    neighbours: VehicleIds
    peers: VehicleIds = ()  # fresh ones, in any phase
    weights: OfNeighbours = ()  # w_ij of the neighbours, in their order; empty where the law does not use them
    neighbour_ages_s: OfNeighbours = ()  # of their newest positions, in their order


class FormationReport(Part, frozen=True, gc=False):
    """What the vehicle flies: its slot in the formation frame, which has `heading`, and the reference."""

    slot: FlownSlot
    reference_enu_m: FiniteVector | None  # leaders only
    reference_s: Finite = 0.0  # mission time by this vehicle
    reference: HeldReference | None = None  # None if the vehicle may not lead
    target_age_s: Finite | None = None  # of the followed target; None without a target or samples of it
    heading: Heading = EAST
    # Of a leader, in some of its reports: the reference flown, as a section of a file. None of one that no command can bring.
    described: Annotated[Described, Meta(max_length=20)] | None = None


class SafetyReport(Part, frozen=True, gc=False):
    """Health flags and the separation filter; of a disarmed vehicle also what its audit found."""

    flags: Annotated[tuple[HealthFlag, ...], Meta(max_length=100)]
    refuses_return: Notice | None = None  # why `return` would be refused now, besides phase and flags
    lacks: Notices = ()  # refusals of formation flight besides the flags
    separation: SeparationReport = SeparationReport()  # while setpoints stream
    warnings: Notices = ()  # with which a vehicle may fly


class CommandReport(Part, frozen=True, gc=False):
    holder: Word = ""  # the operator who holds command, "" for none
    command_number: Number = 0  # of the last received command


class Status(Struct, frozen=True, gc=False):
    """Status of a vehicle, published to the ground a few times per second. In its bytes the fields of the parts are a flat map.

    LATER has the fields with a default in the order of the bytes; a new one stands behind them.
    """

    LATER: ClassVar[tuple[str, ...]] = (
        *("reference_s", "reference", "target_age_s", "refuses_return", "lacks", "holder", "command_number", "peers"),
        *("battery_percent", "position_error", "largest_step_deg", "heading", "separation", "network", "warnings"),
        *("weights", "neighbour_ages_s", "recording", "described"),
    )

    agent: AgentIdentity
    phase: FlightPhase
    autopilot: AutopilotReport
    motion: MotionReport
    control: ControlReport
    leadership: LeadershipReport
    neighbourhood: NeighbourReport
    formation: FormationReport
    safety: SafetyReport
    rejected: Annotated[dict[Word, Number], Meta(max_length=500)]  # counted rejections by code
    last_event: Notice | None
    command: CommandReport = CommandReport()
    network: NetworkState = NetworkState()
    recording: RecordingState = RecordingState()
