"""The first way to make a vehicle fly: one agent in virtual time, whose autopilot executes requests at once.

`AgentFlight` is the whole agent; `flown_to` has its phase machine alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isfinite

from msgspec.structs import replace

from common import with_fields
from companion.assembly import build_agent
from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember
from companion.config.law import LawSection
from companion.config.reference import PointReference, Reference
from companion.config.vehicle import AgentConfig, VehicleConfig
from companion.core.command.hand_over import LEVEL_BEFORE_HAND_OVER_S
from companion.core.command.phase import PhaseMachine
from companion.geometry.frames import geodetic_from_enu
from companion.mavlink.autopilot_types import PROFILES
from companion.types.autopilot import (
    Arm,
    AttitudeSample,
    AttitudeTarget,
    AutopilotKind,
    AutopilotMode,
    AutopilotRequest,
    Disarm,
    HeartbeatSample,
    HomeSample,
    LandedSample,
    LandedState,
    ModeSample,
    OriginSample,
    ParameterSample,
    PositionSample,
    RequestOrigin,
    RequestParameter,
    SetMode,
    SystemSample,
    TakeOff,
    Telemetry,
    VehicleState,
)
from companion.types.commands import Command, CommandName, Content
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, HeldReference, LeaderBeacon
from companion.types.notices import Notice
from companion.types.peers import (
    LeaderReport,
    Motion,
    PeerPacket,
    ReceivedPeerPacket,
    ReceivedTraffic,
    Sender,
    TrafficSample,
)
from companion.types.tick import Inbox, Outbox
from companion.types.values import Vector3
from tests.fuzz.plant import PARAMETERS

FLEET = FleetConfig(
    name="pair",
    origin="indoor",
    vehicles=(
        FormationMember(id=1, role=Role.LEADER, slot_enu_m=(0.0, 0.0, 0.0)),
        FormationMember(id=2, role=Role.FOLLOWER, slot_enu_m=(-1.5, 0.0, 0.0)),
    ),
    neighbours=EdgeNeighbours(edges=((1, 2),)),
    law=LawSection(name="weighted", velocity_correction_1_s=0.0),  # its position does not move as its velocity says
    takeoff_height_m=1.0,
)
ORIGIN: Vector3 = (47.0, 8.0, 400.0)  # of its autopilot
SESSION = 7
POINT = PointReference(point_enu_m=(1.0, 0.0, 1.0))


class AgentFlight:
    """One agent, fed at 50 Hz by an autopilot that executes requests at once and does not move by itself.

    A new `position` takes a while by the autopilot's clock, so that it is no jump.
    """

    def __init__(self, vehicle_id: int = 2, fleet: FleetConfig = FLEET, reference: Reference = POINT) -> None:
        member = fleet.member(vehicle_id)
        assert member is not None
        vehicle = VehicleConfig(
            id=vehicle_id,
            fleet="fleet.yaml",
            mavlink="udpin:127.0.0.1:14540",
            hover_thrust_norm=0.5,
            reference=reference if member.can_lead else None,
        )
        self.agent = build_agent(AgentConfig(vehicle, fleet, member), session=SESSION)
        self.fleet = fleet
        self.now_s = 100.0
        self.position: Vector3 = (-1.5, 0.0, 0.0)
        self.mode, self.armed, self.landed = AutopilotMode.OTHER, False, LandedState.ON_GROUND
        self.peer_position: Vector3 | None = (0.0, 0.0, 1.0)
        self.outbox = Outbox()
        self.sends_origin = True
        self.kind = AutopilotKind.PX4
        self.home: Vector3 = self.position  # follows the vehicle while that is on the ground
        self.parameters = dict(PARAMETERS)
        self.battery_percent = 90.0
        self.withheld: tuple[type, ...] = ()
        self.executes_requests = True
        self.velocity: Vector3 = (0.0, 0.0, 0.0)
        self.peer_phase = FlightPhase.FORMATION
        self.stopping = False
        self.roll_rad = 0.0
        self.targets: list[AttitudeTarget] = []
        self.events: list[Notice] = []
        self.peer_role: Role | None = None
        self.peer_reference_s = 0.0
        self.peer_reference: HeldReference | None = None
        self.peer_late_s = 0.0
        self.peer_changes: dict[str, object] = {}  # of its packets
        self.traffic: dict[str, TrafficSample] = {}  # published again before every tick
        self.formation_ticks = 0
        self._peer_sequence = 0
        self._number = 0  # of the last command
        self._put_at, self.boot_s = self.position, 50.0

    def telemetry(self) -> list[Telemetry]:
        t = self.now_s
        return [sample for sample in self._all_telemetry(t) if not isinstance(sample, self.withheld)]

    def _all_telemetry(self, t: float) -> list[Telemetry]:
        if self.position != self._put_at and all(map(isfinite, self.position)):
            self._put_at, self.boot_s = self.position, self.boot_s + 1.0
        if self.landed is LandedState.ON_GROUND:
            self.home = self.position
        return [
            AttitudeSample(t, self.roll_rad, 0.0, 0.3),
            ModeSample(t, self.mode, self.mode),
            HeartbeatSample(t, self.armed, self.kind),
            LandedSample(t, self.landed),
            *([OriginSample(t, *ORIGIN)] if RequestOrigin() in self.outbox.requests and self.sends_origin else []),
            HomeSample(t, *geodetic_from_enu(self.home, ORIGIN)[:2]),
            SystemSample(t, self.battery_percent, may_arm=True),
            *(ParameterSample(t, name, self.parameters[name]) for name in self.asked() if name in self.parameters),
            PositionSample(t, t - 100.0 + self.boot_s, self.position, self.velocity),
        ]

    def asked(self) -> list[str]:
        """The parameters that the last tick asked for."""
        return [request.name for request in self.outbox.requests if isinstance(request, RequestParameter)]

    def peer(self) -> list[ReceivedPeerPacket]:
        if self.peer_position is None:
            return []
        self._peer_sequence += 1
        leads = 1 if self.agent_id == 2 else 2
        packet = PeerPacket(
            sender=Sender(
                vehicle_id=leads, session=1, sequence=self._peer_sequence, formation_hash=self.fleet.formation_hash()
            ),
            phase=self.peer_phase,
            role=self.peer_role or (Role.LEADER if leads == 1 else Role.FOLLOWER),
            motion=Motion(
                position_enu_m=self.peer_position,
                velocity_enu_m_s=(0.0, 0.0, 0.0),
                acceleration_enu_m_s2=(0.0, 0.0, 0.0),
                state_age_s=0.0,
                sent_s=self.now_s - self.peer_late_s,
            ),
            leader=LeaderReport(
                prc=leads if self.peer_role is None else 2,
                beacon=LeaderBeacon(1, 0, int(self.now_s * 1000), self.peer_reference_s),
            ),
            slot=FlownSlot(self.fleet.vehicles[leads - 1].slot_enu_m),
            reference=self.peer_reference,
        )
        return [ReceivedPeerPacket(self.now_s, with_fields(packet, **self.peer_changes))]

    @property
    def agent_id(self) -> int:
        return 2 if self.position[0] < 0 else 1

    def command(self, name: CommandName, operator: str = "anna@ground", content: Content | None = None) -> Command:
        """The next one."""
        self._number += 1
        return Command(name, self._number, operator, SESSION, content)

    def tick(
        self,
        *names: CommandName,
        telemetry: list[Telemetry] | None = None,
        lead: Content | None = None,
        given: tuple[Command, ...] = (),
        checks: tuple[Command, ...] = (),
    ) -> Outbox:
        self.now_s += 0.02
        self.peer_reference_s += 0.02 if self.peer_reference_s else 0.0
        self.formation_ticks += self.agent.phase is FlightPhase.FORMATION
        commands = tuple(self.command(name, content=lead) for name in names)
        samples = self.telemetry() if telemetry is None else telemetry
        traffic = tuple(ReceivedTraffic(self.now_s, name, sample) for name, sample in self.traffic.items())
        inbox = Inbox(
            tuple(samples), tuple(self.peer()), commands + given, self.stopping, traffic=traffic, checks=checks
        )
        self.outbox = self.agent.step(self.now_s, inbox)
        if self.executes_requests:
            self._execute_requests()
        if self.outbox.attitude_target:
            self.targets.append(self.outbox.attitude_target)
        self.events += self.outbox.events
        return self.outbox

    def _execute_requests(self) -> None:
        for request in self.outbox.requests:
            match request:
                case SetMode(mode):
                    self.mode = mode
                case Arm():
                    self.armed = True
                case TakeOff(height_m):
                    self.mode, self.landed = AutopilotMode.HOLD, LandedState.IN_AIR
                    self.position = (self.position[0], self.position[1], self.position[2] + height_m)

    def fly_to(self, phase: FlightPhase) -> AgentFlight:
        for name in (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF, CommandName.FORM):
            if self.agent.phase is phase:
                break
            self.tick()
            assert self.tick(name).replies[0].accepted, self.outbox.replies
            for _ in range(50):
                self.tick()
        assert self.agent.phase is phase, self.events
        return self


NEW = float("inf")  # state that is always newer than the request
GROUND = VehicleState(
    mode_time_s=NEW,
    heartbeat_time_s=NEW,
    autopilot=AutopilotKind.PX4,
    mode=AutopilotMode.OTHER,
    mode_name="POSCTL",
    landed=LandedState.ON_GROUND,
    altitude_amsl_m=488.0,
)
AIR = replace(GROUND, armed=True, landed=LandedState.IN_AIR, mode=AutopilotMode.HOLD, position_enu_m=(0.0, 0.0, 2.5))


def tick(
    machine: PhaseMachine, now_s: float, vehicle: VehicleState, telemetry: Sequence[Telemetry]
) -> tuple[AutopilotRequest, ...]:
    """Autopilot requests of one tick without commands."""
    machine.follow_truth(vehicle)
    return machine.advance(now_s, vehicle, telemetry)


class ImmediateAutopilot:
    """An autopilot that executes every request at once."""

    def __init__(self) -> None:
        self.state = GROUND
        self.asked: list[AutopilotRequest] = []

    def execute(self, requests: Iterable[AutopilotRequest]) -> None:
        for request in requests:
            self.asked.append(request)
            match request:
                case SetMode(mode):
                    self.state = replace(self.state, mode=mode, mode_name=mode)
                case Arm():
                    self.state = replace(self.state, armed=True)
                case Disarm():
                    self.state = replace(self.state, armed=False)
                case TakeOff():
                    self.state = replace(AIR, mode=AutopilotMode.HOLD)


def flown_to(phase: FlightPhase) -> tuple[PhaseMachine, ImmediateAutopilot, float]:
    """A machine that reached `phase` by the usual commands."""
    machine, autopilot, now_s = PhaseMachine(2.5, PROFILES), ImmediateAutopilot(), 0.0
    for name in (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF, CommandName.FORM):
        if machine.phase is phase:
            break
        assert machine.command(name, now_s, autopilot.state)[0]
        for _ in range(100):
            if machine.phase is phase:
                return machine, autopilot, now_s
            autopilot.execute(tick(machine, now_s, autopilot.state, ()))
            now_s += 0.02
    return machine, autopilot, now_s


def levelled(machine: PhaseMachine, autopilot: ImmediateAutopilot, now_s: float) -> float:
    """Let a hand-over from formation stream until its level phase ends; the time of the request that follows."""
    until_s = now_s + LEVEL_BEFORE_HAND_OVER_S
    while now_s < until_s:
        assert tick(machine, now_s, autopilot.state, ()) == ()
        assert machine.streams(autopilot.state) and machine.handing_over.levels(now_s)
        now_s += 0.02
    autopilot.execute(tick(machine, now_s, autopilot.state, ()))
    return now_s
