"""Roles, flight phases and the commands that change them (RULES), health flags and failsafe actions."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum, StrEnum, auto

from msgspec import Struct

from companion.types.autopilot import AutopilotRequest
from companion.types.commands import CommandName
from companion.types.generated.codes import TEXTS
from companion.types.generated.codes import HealthFlag as HealthFlag
from companion.types.notices import Answer, Notice


class Role(StrEnum):
    """A leader flies by the reference formation trajectory (RFT); a follower never does."""

    LEADER = "leader"
    FOLLOWER = "follower"


class FlightPhase(StrEnum):
    """Flight phase of the agent. RULES has the commands that change it, `core/command/phase.py` the state machine."""

    OBSERVE = "observe"  # sends nothing; after the start and after a pilot takes over
    PREPARE = "prepare"
    READY = "ready"
    ARM = "arm"
    ARMED = "armed"
    TAKEOFF = "takeoff"
    HOLD = "hold"  # the autopilot's own position hold
    ENGAGE = "engage"  # setpoints are sent; the autopilot has not changed its mode yet
    FORMATION = "formation"
    RELEASE = "release"  # setpoints are sent until the autopilot has changed its mode
    LAND = "land"
    RETURN = "return"  # fly home and land, by the autopilot alone


# Sets of phases that several packages use. COOPERATING: peers may use the vehicle as a neighbour.
ON_GROUND = frozenset({FlightPhase.PREPARE, FlightPhase.READY, FlightPhase.ARM, FlightPhase.ARMED})
STREAMING = frozenset({FlightPhase.ENGAGE, FlightPhase.FORMATION})
HELD = frozenset({FlightPhase.RELEASE, FlightPhase.HOLD})
COOPERATING = STREAMING | HELD
TO_THE_GROUND = frozenset({FlightPhase.LAND, FlightPhase.RETURN})  # by the autopilot alone
FLYING = COOPERATING | TO_THE_GROUND | {FlightPhase.TAKEOFF}
LEAD_CHANGES_IN = ON_GROUND | {FlightPhase.HOLD, FlightPhase.FORMATION}


FLAG_TEXTS = {flag: TEXTS[flag] for flag in HealthFlag}


WITHOUT_LEADER = frozenset({HealthFlag.LEADER_AWAITED, HealthFlag.LEADER_LOST})
OF_THE_FLEET = WITHOUT_LEADER | {
    HealthFlag.FLEET_LINK_LOST,
    HealthFlag.SEPARATION_VIOLATED,
    HealthFlag.NOT_SHAKEN_OFF,
    HealthFlag.PEER_IN_DOUBT,
}
BATTERY_FLAGS = frozenset({HealthFlag.BATTERY_LOW, HealthFlag.BATTERY_CRITICAL})


class FailsafeAction(IntEnum):
    """Failsafe actions by rank: the highest of all raised flags is taken. `core/safety/failsafe.py` has the table."""

    NONE = 0
    WARN = 1  # one event; the flight continues
    HOLD = 2  # leave formation for the autopilot's own hold
    RETURN = 3  # hold, and from there the autopilot's own return, or its landing where the way home is not free
    LAND = 4  # hold, and from there the autopilot's own landing
    LEAVE = 5  # observe: nothing is sent, the pilot or the autopilot continues
    STOP_STREAM = 6  # the state is unknown: no setpoint, so that the autopilot's failsafe acts


@dataclass(frozen=True, slots=True)
class Rule:
    """A command: the phases that allow it, the phase while it runs, the phase after it, and the phase after a failure.

    After a failure that leads to RELEASE the agent requests a hold, after one that leads to LAND a landing. What began in
    OBSERVE fails to OBSERVE: there the vehicle is another's.
    """

    allowed: frozenset[FlightPhase]
    via: FlightPhase
    to: FlightPhase
    on_failure: FlightPhase
    on_ground: bool  # True: only on the ground; False: only in the air


P, C = FlightPhase, CommandName

# All commands that change the phase. LEAD, FORMATION, REFERENCE and TAKE do not; ABORT becomes one of these.
RULES: dict[CommandName, Rule] = {
    C.PREPARE: Rule(frozenset({P.OBSERVE}), P.PREPARE, P.READY, P.OBSERVE, True),
    C.ARM: Rule(frozenset({P.READY}), P.ARM, P.ARMED, P.READY, True),
    C.TAKEOFF: Rule(frozenset({P.ARMED}), P.TAKEOFF, P.HOLD, P.OBSERVE, True),
    C.FORM: Rule(frozenset({P.HOLD}), P.ENGAGE, P.FORMATION, P.HOLD, False),
    C.HOLD: Rule(FLYING | {P.OBSERVE}, P.RELEASE, P.HOLD, P.LAND, False),
    C.LAND: Rule(FLYING | {P.OBSERVE}, P.LAND, P.OBSERVE, P.OBSERVE, False),
    C.RETURN: Rule(STREAMING | {P.HOLD, P.RELEASE}, P.RETURN, P.OBSERVE, P.RELEASE, False),
    C.DISARM: Rule(ON_GROUND | {P.OBSERVE}, P.LAND, P.OBSERVE, P.OBSERVE, True),
}


class PhaseChange(Enum):
    """What a stage may request of the phase machine. Each is ignored in a phase that it does not apply to."""

    HAND_OVER = auto()  # from ENGAGE and FORMATION to the autopilot's own hold: brake, then level first
    HAND_OVER_LEVEL = auto()  # the same without braking, where the velocity is in doubt
    HAND_OVER_NOW = auto()  # the same without levelling, where the attitude is unknown
    GIVE_UP = auto()  # from ENGAGE and FORMATION to OBSERVE
    HOLD = auto()  # from OBSERVE to the autopilot's own hold, where it still waits for setpoints
    ABANDON = auto()  # from every phase to OBSERVE
    LAND = auto()  # from HOLD by the autopilot's own landing, unless a command came in the same tick
    RETURN = auto()  # from HOLD by the autopilot's own return, likewise
    END_STREAM = auto()  # no more setpoints; requests to the autopilot continue


class PhaseRequest(Struct, frozen=True, gc=False):
    """A change of phase that a stage asks for, with the reason for the event."""

    kind: PhaseChange
    reason: Notice


class Flight(Struct, frozen=True, gc=False):
    """The flight phase and what follows from it in this tick.

    `streams`: attitude targets go out. `in_formation`: formation is flown or being left, so mission time runs. `on_ground`:
    before a take-off or after a landing. `levels`: level attitude of a hand-over. `descends`: the autopilot does not take over
    to land, and the agent lowers the vehicle, level. `commanded`: a command was executed.
    """

    phase: FlightPhase = FlightPhase.OBSERVE
    streams: bool = False
    in_formation: bool = False
    on_ground: bool = True
    levels: bool = False
    descends: bool = False
    commanded: bool = False
    requests: tuple[AutopilotRequest, ...] = ()
    answers: tuple[tuple[int, Answer], ...] = ()
    events: tuple[Notice, ...] = ()

    @property
    def has_handed_over(self) -> bool:
        """No setpoint stream is left that the autopilot would miss."""
        return self.phase is not FlightPhase.RELEASE and not self.streams
