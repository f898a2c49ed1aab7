"""Agent.step from telemetry to setpoint: when it speaks, when it must be silent, and what it tells the others."""

from math import inf, isfinite, nan

import pytest
from msgspec.structs import replace

from companion.assembly import build_agent, trajectory_of
from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember
from companion.config.law import Law
from companion.config.reference import Figure8Reference, PointReference, Reference
from companion.config.vehicle import AgentConfig, VehicleConfig
from companion.core.phase import LEVEL_BEFORE_HAND_OVER_S, TAKES_OVER_WITHIN_S
from companion.types import (
    Arm,
    AttitudeSample,
    AttitudeTarget,
    AutopilotKind,
    AutopilotMode,
    Command,
    CommandName,
    Content,
    FlightPhase,
    FlownSlot,
    FormationChange,
    HealthFlag,
    HeartbeatSample,
    HeldReference,
    Inbox,
    LandedSample,
    LandedState,
    Lead,
    LeaderWord,
    ModeSample,
    OriginSample,
    Outbox,
    ParameterSample,
    PeerPacket,
    PositionSample,
    ReceivedPeerPacket,
    ReferenceChange,
    RequestOrigin,
    RequestParameter,
    Role,
    SetMode,
    SystemSample,
    TakeOff,
    Telemetry,
    Vector3,
)

FLEET = FleetConfig(
    name="pair",
    origin="indoor",
    vehicles=(
        FormationMember(id=1, role=Role.LEADER, slot_enu_m=(0.0, 0.0, 0.0)),
        FormationMember(id=2, role=Role.FOLLOWER, slot_enu_m=(-1.5, 0.0, 0.0)),
    ),
    neighbours=EdgeNeighbours(edges=((1, 2),)),
    law=Law(name="weighted"),
    takeoff_height_m=1.0,
)
SESSION = 7
POINT = PointReference(point_enu_m=(1.0, 0.0, 1.0))
IN_ORDER = {
    "COM_OF_LOSS_T": 1.0,
    "COM_OBL_RC_ACT": 5.0,
    "NAV_DLL_ACT": 0.0,
    "COM_RC_OVERRIDE": 3.0,
    "GF_ACTION": 2.0,
    "GF_MAX_HOR_DIST": 100.0,
    "GF_MAX_VER_DIST": 50.0,
    "MPC_THR_HOVER": 0.5,
}


class Flight:
    """One agent, fed at 50 Hz by an autopilot that obeys at once and stands still where it is put.

    To be put elsewhere takes a while by the autopilot's clock, so that it is no jump.
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
        self.tells_origin = True
        self.parameters = dict(IN_ORDER)
        self.battery_percent = 90.0
        self.withheld: tuple[type, ...] = ()
        self.obeys = True
        self.velocity: Vector3 = (0.0, 0.0, 0.0)
        self.peer_phase = FlightPhase.FORMATION
        self.stopping = False
        self.roll_rad = 0.0
        self.targets: list[AttitudeTarget] = []
        self.events: list[str] = []
        self.peer_role: Role | None = None
        self.peer_reference_s = 0.0
        self.peer_reference: HeldReference | None = None
        self.peer_late_s = 0.0
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
        return [
            AttitudeSample(t, self.roll_rad, 0.0, 0.3),
            ModeSample(t, self.mode, self.mode),
            HeartbeatSample(t, self.armed, AutopilotKind.PX4),
            LandedSample(t, self.landed),
            *(
                [OriginSample(t, 47.0, 8.0, 400.0)]
                if RequestOrigin() in self.outbox.requests and self.tells_origin
                else []
            ),
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
            vehicle_id=leads,
            session=1,
            sequence=self._peer_sequence,
            formation_hash=self.fleet.formation_hash(),
            phase=self.peer_phase,
            role=self.peer_role or (Role.LEADER if leads == 1 else Role.FOLLOWER),
            position_enu_m=self.peer_position,
            velocity_enu_m_s=(0.0, 0.0, 0.0),
            acceleration_enu_m_s2=(0.0, 0.0, 0.0),
            state_age_s=0.0,
            sent_s=self.now_s - self.peer_late_s,
            prc=leads if self.peer_role is None else 2,
            leader_word=LeaderWord(1, 0, int(self.now_s * 1000), self.peer_reference_s),
            slot=FlownSlot(self.fleet.vehicles[leads - 1].slot_enu_m),
            reference=self.peer_reference,
        )
        return [ReceivedPeerPacket(self.now_s, packet)]

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
    ) -> Outbox:
        self.now_s += 0.02
        self.peer_reference_s += 0.02 if self.peer_reference_s else 0.0
        self.formation_ticks += self.agent.phase is FlightPhase.FORMATION
        commands = tuple(self.command(name, content=lead) for name in names)
        samples = self.telemetry() if telemetry is None else telemetry
        inbox = Inbox(tuple(samples), tuple(self.peer()), commands + given, self.stopping)
        self.outbox = self.agent.step(self.now_s, inbox)
        if self.obeys:
            self._obey()
        if self.outbox.attitude_target:
            self.targets.append(self.outbox.attitude_target)
        self.events += self.outbox.events
        return self.outbox

    def _obey(self) -> None:
        for request in self.outbox.requests:
            match request:
                case SetMode(mode):
                    self.mode = mode
                case Arm():
                    self.armed = True
                case TakeOff(_, height_m):
                    self.mode, self.landed = AutopilotMode.HOLD, LandedState.IN_AIR
                    self.position = (self.position[0], self.position[1], self.position[2] + height_m)

    def fly_to(self, phase: FlightPhase) -> "Flight":
        for name in (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF, CommandName.FORM):
            if self.agent.phase is phase:
                break
            self.tick()
            assert self.tick(name).replies[0].accepted, self.outbox.replies
            for _ in range(50):
                self.tick()
        assert self.agent.phase is phase, self.events
        return self


def test_on_the_ground_and_after_start_it_sends_no_setpoint() -> None:
    flight = Flight()
    asked = [request for _ in range(1000) for request in flight.tick().requests]
    asked = [request for request in asked if not isinstance(request, RequestParameter)]
    assert asked == [RequestOrigin()] * 4  # in 20 s: it may have changed without our hearing of it
    assert flight.targets == []


def test_a_geodetic_fleet_asks_for_the_origin_once_a_second() -> None:
    from companion.config.fleet import GeodeticOrigin

    origin = GeodeticOrigin(latitude_deg=47.0, longitude_deg=8.0, altitude_amsl_m=400.0)
    flight = Flight(fleet=FleetConfig(name="pair", origin=origin, vehicles=FLEET.vehicles, neighbours=FLEET.neighbours))
    flight.tells_origin = False
    asked = [request for _ in range(150) for request in flight.tick().requests]
    asked = [request for request in asked if not isinstance(request, RequestParameter)]
    assert asked == [RequestOrigin()] * 3
    reply = flight.tick(CommandName.PREPARE).replies[0]
    assert not reply.accepted
    assert HealthFlag.FRAME_UNKNOWN in reply.reason


def test_in_formation_there_is_one_setpoint_for_every_tick() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    before = len(flight.targets)
    for _ in range(50):
        flight.tick()
    assert len(flight.targets) - before == 50


def test_the_follower_follows_eq_14() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.peer_position = (0.5, 0.0, 1.0)  # the leader is 0.5 m ahead of where this vehicle's slot would have it
    for _ in range(20):
        flight.tick()
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.acceleration_enu_m_s2 == pytest.approx((1.39 * 0.5, 0.0, 0.0))
    target = flight.targets[-1]
    assert target.yaw_rad == pytest.approx(0.3)  # the heading it had when the stream began
    assert target.pitch_rad > 0.0


def test_the_leader_tracks_its_reference() -> None:
    flight = Flight(vehicle_id=1)
    flight.position, flight.peer_position = (0.0, 0.0, 0.0), (-1.5, 0.0, 1.0)
    flight.fly_to(FlightPhase.FORMATION)
    for _ in range(20):
        flight.tick()
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.acceleration_enu_m_s2 == pytest.approx((1.39 * 1.0, 0.0, 0.0))
    word = flight.outbox.peer_packet.leader_word
    assert word is not None
    assert (word.leader_id, word.epoch, word.stamp) == (1, 0, int(flight.now_s * 1000))
    assert word.reference_s == pytest.approx(0.02 * flight.formation_ticks, abs=0.03)


def test_the_hand_over_begins_level_and_steps_little() -> None:
    flight = Flight().fly_to(FlightPhase.HOLD)
    flight.peer_position, flight.peer_phase = (5.0, 0.0, 1.0), FlightPhase.HOLD  # which forms with it
    for _ in range(20):
        flight.tick()
    flight.tick(CommandName.FORM)
    for _ in range(60):
        flight.tick()
    assert flight.agent.phase is FlightPhase.FORMATION
    first = flight.targets[0]
    assert (first.roll_rad, first.pitch_rad, first.thrust_norm) == (0.0, 0.0, 0.5)
    steps = [abs(b.pitch_rad - a.pitch_rad) for a, b in zip(flight.targets, flight.targets[1:], strict=False)]
    assert 0.0 < max(steps) <= 400.0 * 0.02 * 3.1416 / 180.0 + 1e-9


@pytest.mark.parametrize("ticks", [1, 5, 20])
def test_no_fresh_state_no_setpoint(ticks: int) -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    before = len(flight.targets)
    for _ in range(ticks):
        flight.tick(telemetry=[])
    assert len(flight.targets) == before
    assert flight.agent.phase is FlightPhase.FORMATION
    flight.tick()
    assert len(flight.targets) == before + 1


@pytest.mark.parametrize(("age_s", "setpoints"), [(0.0, 1), (0.039, 1), (0.041, 0)])
def test_40_ms_after_a_position_came_nothing_is_decided_on_it(age_s: float, setpoints: int) -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    for _ in range(3):
        flight.tick(telemetry=[])
    before, came_s = len(flight.targets), flight.now_s + 0.02 - age_s
    flight.tick(telemetry=[PositionSample(came_s, came_s - 100.0 + flight.boot_s, flight.position, flight.velocity)])
    assert len(flight.targets) - before == setpoints


def test_silent_for_too_long_it_does_not_speak_again_by_itself() -> None:
    """PX4 re-enters OFFBOARD when a stream returns: an agent that was silent must wait for a command."""
    flight = Flight().fly_to(FlightPhase.FORMATION)
    for _ in range(30):
        flight.tick(telemetry=[])
    assert flight.agent.phase is FlightPhase.OBSERVE
    before = len(flight.targets)
    for _ in range(50):
        flight.tick()
    assert len(flight.targets) == before


def test_on_its_back_it_says_nothing_and_gives_up() -> None:
    """Remark 1: beyond 90 degrees no thrust carries the vehicle; the autopilot is left to its own devices."""
    flight = Flight().fly_to(FlightPhase.FORMATION)
    before = len(flight.targets)
    flight.roll_rad = 2.0
    for _ in range(30):
        flight.tick()
    assert len(flight.targets) == before
    assert flight.agent.phase is FlightPhase.OBSERVE
    status = next(status for _ in range(10) if (status := flight.tick().status))
    assert status.rejected == {"own command: no attitude gives this acceleration": 25}  # half a second


@pytest.mark.parametrize("bad", [nan, inf, 1e12])
def test_telemetry_that_cannot_be_true_never_becomes_a_setpoint(bad: float) -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    before = len(flight.targets)
    flight.position = (bad, 0.0, 1.0)
    for _ in range(10):
        flight.tick()
    assert len(flight.targets) == before
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.position_enu_m == (-1.5, 0.0, 1.0)


def test_a_lost_leader_ends_in_the_autopilots_hold() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.peer_position = None
    for _ in range(60):
        flight.tick()
    assert flight.agent.phase is FlightPhase.HOLD
    assert flight.mode is AutopilotMode.HOLD
    assert any(HealthFlag.LEADER_LOST in event for event in flight.events)
    reply = flight.tick(CommandName.FORM).replies[0]
    assert not reply.accepted
    assert HealthFlag.LEADER_LOST in reply.reason


def test_a_leader_heard_five_seconds_late_is_a_lost_one() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.peer_late_s = 5.0
    statuses = [status for _ in range(60) if (status := flight.tick().status)]
    assert flight.agent.phase is FlightPhase.HOLD
    assert any(HealthFlag.LEADER_LOST in event for event in flight.events)
    assert set(statuses[-1].rejected) == {"peer 1: comes too late"}


def test_leaving_the_fence_ends_in_the_autopilots_hold() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.position = (-101.0, 0.0, 1.0)
    for _ in range(30):
        flight.tick()
    assert flight.agent.phase is FlightPhase.HOLD


def test_the_pilots_mode_stops_the_stream_at_once() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.mode = AutopilotMode.OTHER
    assert flight.tick().attitude_target is None
    assert flight.agent.phase is FlightPhase.OBSERVE
    assert flight.tick().requests == ()


def test_own_altitude_hold_leaves_the_horizontal_law_alone() -> None:
    fleet = FleetConfig(
        name="pair",
        origin="indoor",
        vehicles=FLEET.vehicles,
        neighbours=FLEET.neighbours,
        law=Law(name="weighted", altitude="hold"),
        takeoff_height_m=1.0,
    )
    flight = Flight(fleet=fleet).fly_to(FlightPhase.FORMATION)
    flight.peer_position = (0.5, 0.0, 7.0)  # a neighbour's altitude is none of its business
    flight.position = (-1.5, 0.0, 0.9)  # 0.1 m below where it was when the formation began
    for _ in range(20):
        flight.tick()
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.acceleration_enu_m_s2 == pytest.approx((1.39 * 0.5, 0.0, 0.2))


def test_a_peer_with_another_fleet_file_never_reaches_the_law() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.fleet = FleetConfig(name="other", origin="indoor", vehicles=FLEET.vehicles, neighbours=FLEET.neighbours)
    for _ in range(40):
        flight.tick()
    assert flight.agent.phase in (FlightPhase.HOLD, FlightPhase.RELEASE)
    status = next(flight.outbox.status for _ in range(10) if flight.tick().status)
    assert status is not None
    assert any("another fleet file" in reason for reason in status.rejected)


def test_the_same_inputs_give_the_same_outputs_to_the_bit() -> None:
    def outputs() -> list[AttitudeTarget]:
        flight = Flight().fly_to(FlightPhase.FORMATION)
        for tick in range(200):
            flight.peer_position = (0.001 * tick, 0.01, 1.0)
            flight.tick()
        return flight.targets

    assert outputs() == outputs()


def test_commands_are_answered_with_their_number() -> None:
    flight = Flight()
    flight.tick()
    outbox = flight.tick(CommandName.PREPARE, CommandName.LAND)
    assert [(reply.number, reply.accepted) for reply in outbox.replies] == [(1, True), (2, False)]
    assert all(reply.vehicle_id == 2 for reply in outbox.replies)


def test_a_status_comes_ten_times_a_second() -> None:
    flight = Flight()
    statuses = [status for _ in range(100) if (status := flight.tick().status)]
    assert len(statuses) == 20
    assert replace(statuses[-1], state_age_s=0.0).phase is FlightPhase.OBSERVE


# ---------------------------------------------------------------- the pilot, and what is stale


def test_a_failsafe_in_the_tick_of_the_pilots_take_over_does_not_override_the_pilot() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.mode, flight.position = AutopilotMode.OTHER, (-101.0, 0.0, 1.0)
    for _ in range(200):
        outbox = flight.tick()
        assert outbox.attitude_target is None
        assert [r for r in outbox.requests if isinstance(r, SetMode)] == []
    assert flight.agent.phase is FlightPhase.OBSERVE


def test_a_command_in_the_tick_of_the_pilots_take_over_is_refused() -> None:
    flight = Flight().fly_to(FlightPhase.HOLD)
    flight.mode = AutopilotMode.OTHER
    reply = flight.tick(CommandName.FORM).replies[0]
    assert not reply.accepted
    assert flight.agent.phase is FlightPhase.OBSERVE


def test_an_agent_that_stops_hands_over_but_never_takes_from_a_pilot() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.stopping = True
    assert not flight.agent.has_handed_over
    for _ in range(30):
        flight.tick()
    assert flight.mode is AutopilotMode.HOLD
    assert flight.agent.has_handed_over
    flown = Flight().fly_to(FlightPhase.FORMATION)
    flown.stopping, flown.mode = True, AutopilotMode.OTHER
    for _ in range(30):
        assert [r for r in flown.tick().requests if isinstance(r, SetMode)] == []


@pytest.mark.parametrize("kind", [ModeSample, AttitudeSample])
def test_without_mode_or_attitude_it_falls_silent(kind: type) -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.withheld = (kind,)
    for _ in range(45):
        flight.tick()
    assert flight.outbox.attitude_target is None


@pytest.mark.parametrize("kind", [HeartbeatSample, LandedSample])
def test_without_armed_or_landed_state_it_hands_over(kind: type) -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.withheld = (kind,)
    for _ in range(200):
        flight.tick()
    assert flight.agent.phase is FlightPhase.HOLD
    assert not flight.tick(CommandName.FORM).replies[0].accepted


def test_no_formation_from_outside_the_fence() -> None:
    flight = Flight().fly_to(FlightPhase.HOLD)
    flight.position = (-101.0, 0.0, 1.0)
    reply = flight.tick(CommandName.FORM).replies[0]
    assert not reply.accepted
    assert HealthFlag.FENCE in reply.reason


@pytest.mark.parametrize("phase", [FlightPhase.OBSERVE, FlightPhase.TAKEOFF, FlightPhase.LAND, FlightPhase.RETURN])
def test_a_peer_that_lands_or_is_flown_by_its_pilot_is_nobodys_neighbour(phase: FlightPhase) -> None:
    flight = Flight().fly_to(FlightPhase.HOLD)
    flight.peer_phase = phase
    statuses = [status for _ in range(20) if (status := flight.tick().status)]
    assert statuses[-1].neighbours == ()


def test_a_landing_is_asked_for_even_when_the_state_goes_stale() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.tick(CommandName.LAND)
    flight.mode = AutopilotMode.OFFBOARD  # the one request was lost
    for _ in range(40):
        flight.tick(telemetry=[])
    assert flight.agent.phase is FlightPhase.LAND
    for _ in range(30):
        assert flight.tick().attitude_target is None
    assert flight.mode is AutopilotMode.LAND


def test_it_hands_over_level_and_at_its_altitude_and_brakes_where_nobody_takes_over() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.tick()
    flight.peer_position = (-120.0, 0.0, 1.0)  # a neighbour that would pull it farther out
    flight.position, flight.velocity = (-101.0, 0.0, 0.9), (3.0, 0.0, -1.0)
    flight.obeys = False
    up_m_s2 = pytest.approx(2.0 * 0.1 + 2.4 * 1.0, abs=0.01)
    for _ in range(round((LEVEL_BEFORE_HAND_OVER_S + TAKES_OVER_WITHIN_S) / 0.02)):
        assert told_acceleration(flight.tick()) == (0.0, 0.0, up_m_s2)
    assert flight.agent.phase is FlightPhase.RELEASE
    flight.tick()
    ux, _, uz = told_acceleration(flight.tick())
    assert ux < -2.0
    assert uz == up_m_s2


def told_acceleration(outbox: Outbox) -> Vector3:
    assert outbox.peer_packet is not None
    return outbox.peer_packet.acceleration_enu_m_s2


def test_the_neighbours_are_told_what_the_autopilot_still_flies() -> None:
    """A tick without a new position decides nothing, but the last setpoint goes on: they feed its acceleration forward."""
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.peer_position = (0.5, 0.0, 1.0)
    commanded = told_acceleration(flight.tick())
    assert commanded[0] > 0.5
    assert told_acceleration(flight.tick(telemetry=[])) == commanded
    flight.tick(telemetry=[])
    assert told_acceleration(flight.tick(telemetry=[])) == (0.0, 0.0, 0.0)  # older than a state may be


def test_the_neighbours_are_not_told_an_acceleration_that_never_became_a_setpoint() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.peer_position = (0.5, 0.0, 1.0)
    commanded = told_acceleration(flight.tick())
    flight.peer_position, flight.roll_rad = (2.5, 0.0, 1.0), 2.0  # Remark 1: no attitude gives what the law wants now
    outbox = flight.tick()
    assert outbox.attitude_target is None
    assert told_acceleration(outbox) == commanded
    for _ in range(3):
        outbox = flight.tick()
    assert told_acceleration(outbox) == (0.0, 0.0, 0.0)


def test_nothing_is_told_of_a_stream_that_has_ended() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.peer_position = (0.5, 0.0, 1.0)
    flight.tick()
    flight.mode = AutopilotMode.OTHER
    assert told_acceleration(flight.tick()) == (0.0, 0.0, 0.0)


# ---------------------------------------------------------------- the lead


MAY_LEAD = FleetConfig(
    name="pair",
    origin="indoor",
    vehicles=(FLEET.vehicles[0], FormationMember(id=2, role=Role.FOLLOWER, slot_enu_m=(-1.5, 0.0, 0.0), may_lead=True)),
    neighbours=FLEET.neighbours,
    law=Law(name="weighted"),
    takeoff_height_m=1.0,
)
EIGHT = Figure8Reference(centre_enu_m=(0.0, 0.0, 1.0), width_m=6.0, height_m=3.0, period_s=40.0)


def test_who_may_lead_does_not_fly_by_the_rft_before_it_is_told_to() -> None:
    one, other = (Flight(fleet=MAY_LEAD, reference=r).fly_to(FlightPhase.FORMATION) for r in (POINT, EIGHT))
    assert one.targets == other.targets
    status = next(status for _ in range(10) if (status := one.tick().status))
    assert status.reference_enu_m is None


def test_a_reference_goes_to_who_may_lead_and_shows_in_its_packets_and_status() -> None:
    change = ReferenceChange(1, {"kind": "point", "point_enu_m": [4.0, 0.0, 1.0]}, 34.5)
    follower = Flight().fly_to(FlightPhase.FORMATION)
    reply = follower.tick(CommandName.REFERENCE, lead=change).replies[0]
    assert (reply.accepted, reply.reason) == (False, "reference: this vehicle may not lead, and knows of none")
    flight = Flight(fleet=MAY_LEAD, reference=EIGHT)
    flight.peer_reference, flight.peer_reference_s = HeldReference(0, 1), 30.0
    flight.fly_to(FlightPhase.FORMATION)
    flight.peer_reference_s = 33.0
    flight.tick()
    assert flight.tick(CommandName.REFERENCE, lead=change).replies[0].accepted
    packet = flight.tick().peer_packet
    assert packet is not None
    assert packet.reference == HeldReference(0, 1)
    for _ in range(80):
        flight.tick()
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.reference == HeldReference(1, 1, 34.5)
    assert any(event.startswith("reference 0 -> 1 (hand-over of ") for event in flight.events)
    status = next(status for _ in range(10) if (status := flight.tick().status))
    assert status.reference == HeldReference(1, 1, 34.5)
    assert status.reference_s == pytest.approx(flight.peer_reference_s, abs=0.03)
    assert status.reference_enu_m is None  # it follows


def test_who_has_another_reference_than_the_leader_takes_no_lead() -> None:
    flight = Flight(fleet=MAY_LEAD, reference=EIGHT)
    flight.peer_reference, flight.peer_reference_s = HeldReference(1, 1, 5.0), 33.0
    flight.fly_to(FlightPhase.FORMATION)
    reply = flight.tick(CommandName.LEAD, lead=Lead((2,), 1)).replies[0]
    words = "lead: vehicle 1 flies reference 1 since 5.0 s of the fleet's time, this one 0 since 0.0 s"
    assert (reply.accepted, reply.reason) == (False, words)
    assert flight.tick(CommandName.LEAD, lead=Lead((1,), 1)).replies[0].accepted  # it may well follow


def test_who_has_the_reference_elsewhere_than_the_fleet_flies_takes_no_lead() -> None:
    """By number and beginning it is the leader's; it came to it by another way."""
    flight = Flight(fleet=MAY_LEAD, reference=PointReference(point_enu_m=(3.5, 0.0, 1.0)))
    flight.peer_reference_s = 33.0
    flight.fly_to(FlightPhase.FORMATION)
    reply = flight.tick(CommandName.LEAD, lead=Lead((2,), 1)).replies[0]
    words = "lead: the reference as this vehicle has it is 3.5 m from where the fleet flies"
    assert (reply.accepted, reply.reason) == (False, words)
    near = Flight(fleet=MAY_LEAD, reference=PointReference(point_enu_m=(2.5, 0.0, 1.0)))
    near.peer_reference_s = 33.0
    near.fly_to(FlightPhase.FORMATION)
    assert near.tick(CommandName.LEAD, lead=Lead((2,), 1)).replies[0].accepted


def test_it_takes_the_lead_in_the_tick_that_tells_it_and_goes_on_where_the_leader_was() -> None:
    flight = Flight(fleet=MAY_LEAD, reference=EIGHT)
    flight.peer_reference_s = 33.0
    flight.fly_to(FlightPhase.FORMATION)
    flight.peer_role = Role.FOLLOWER
    outbox = flight.tick(CommandName.LEAD, lead=Lead((2,), 1))
    assert outbox.replies[0].accepted
    packet = outbox.peer_packet
    assert packet is not None
    assert packet.leader_word is not None
    assert (packet.role, packet.prc, packet.leader_word.leader_id, packet.leader_word.epoch) == (Role.LEADER, 1, 2, 1)
    assert packet.leader_word.reference_s == pytest.approx(flight.peer_reference_s, abs=0.02)
    assert outbox.attitude_target is not None  # not a tick goes by without a setpoint
    assert outbox.events == ("follower -> leader in epoch 1 (told so)",)
    assert outbox.status is not None
    expected = trajectory_of(EIGHT)(packet.leader_word.reference_s).position_enu_m
    assert outbox.status.reference_enu_m == pytest.approx(expected)
    assert (outbox.status.role, outbox.status.epoch) == (Role.LEADER, 1)
    flight.tick()
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.leader_word is not None
    step_s = flight.outbox.peer_packet.leader_word.reference_s - packet.leader_word.reference_s
    assert step_s == pytest.approx(0.02)  # from now on it counts by itself


@pytest.mark.parametrize(
    ("fleet", "phase", "lead", "reason"),
    [
        (FLEET, FlightPhase.FORMATION, Lead((2,), 1), "lead: vehicle 2 is not one that may lead"),
        (MAY_LEAD, FlightPhase.FORMATION, Lead((2,), 0), "lead: epoch 0 is not newer than 0"),
        (MAY_LEAD, FlightPhase.ENGAGE, Lead((2,), 1), "lead is not possible in phase engage"),
    ],
)
def test_a_lead_that_cannot_be_is_refused_in_words(
    fleet: FleetConfig, phase: FlightPhase, lead: Lead, reason: str
) -> None:
    flight = Flight(fleet=fleet)
    flight.fly_to(FlightPhase.HOLD if phase is FlightPhase.ENGAGE else phase)
    if phase is FlightPhase.ENGAGE:
        flight.tick(CommandName.FORM)
    assert flight.agent.phase is phase
    reply = flight.tick(CommandName.LEAD, lead=lead).replies[0]
    assert not reply.accepted
    assert reason in reply.reason
    assert flight.outbox.peer_packet is not None
    assert flight.outbox.peer_packet.role is Role.FOLLOWER


def test_a_leader_that_hears_a_newer_word_steps_down_in_that_tick() -> None:
    flight = Flight(vehicle_id=1, fleet=MAY_LEAD)
    flight.position, flight.peer_position = (0.0, 0.0, 0.0), (-1.5, 0.0, 1.0)
    flight.fly_to(FlightPhase.FORMATION)
    packet = replace(flight.peer()[0].packet, role=Role.LEADER, prc=1, leader_word=LeaderWord(2, 1, 5, 7.0))
    outbox = flight.agent.step(
        flight.now_s + 0.02, Inbox(tuple(flight.telemetry()), (ReceivedPeerPacket(flight.now_s + 0.02, packet),))
    )
    assert outbox.peer_packet is not None
    assert outbox.peer_packet.role is Role.FOLLOWER
    assert outbox.peer_packet.leader_word is not None
    assert outbox.peer_packet.leader_word.leader_id == 2
    assert "leader -> follower in epoch 1 (heard of it)" in outbox.events


def reference_s_of(outbox: Outbox) -> float:
    assert outbox.peer_packet is not None
    assert outbox.peer_packet.leader_word is not None
    return outbox.peer_packet.leader_word.reference_s


@pytest.mark.parametrize("lands", [False, True])
def test_a_leader_s_second_formation_goes_on_in_the_rft_unless_it_has_landed(lands: bool) -> None:
    flight = Flight(vehicle_id=1, reference=EIGHT)
    flight.position, flight.peer_position = (0.0, 0.0, 0.0), (-1.5, 0.0, 1.0)
    flight.fly_to(FlightPhase.FORMATION)
    for _ in range(500):
        flight.tick()
    flown_s = reference_s_of(flight.outbox)
    assert flown_s > 10.0
    flight.tick(CommandName.LAND if lands else CommandName.HOLD)
    for _ in range(50):
        flight.tick()
    if lands:
        flight.armed, flight.landed, flight.position = False, LandedState.ON_GROUND, (0.0, 0.0, 0.0)
        flight.tick()
        flight.mode = AutopilotMode.HOLD
        flight.fly_to(FlightPhase.FORMATION)
    else:
        assert reference_s_of(flight.outbox) == 0.0
        flight.tick(CommandName.FORM)
        for _ in range(50):
            flight.tick()
    assert flight.agent.phase is FlightPhase.FORMATION
    assert reference_s_of(flight.outbox) == pytest.approx(0.0 if lands else flown_s, abs=1.1)


SLOTS = ((1, (0.0, 0.0, 0.0)), (2, (-98.0, 0.0, 0.0)))


def test_a_follower_refuses_a_formation_that_leaves_the_fence_about_where_the_fleet_is() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    flight.peer_reference_s = 9.0
    flight.tick()
    change = FormationChange(1, SLOTS, 10.0, 300.0)
    assert flight.tick(CommandName.FORMATION, lead=change).replies[0].accepted  # the fleet is about x = 0
    flight.position = (-4.5, 0.0, 1.0)  # 3 m west of its slot: for all it knows, so is the fleet
    flight.tick()
    reply = flight.tick(CommandName.FORMATION, lead=replace(change, number=2)).replies[0]
    words = "formation: puts vehicle 2 at x = -101.0 m, outside the fence (-100 to 100)"
    assert (reply.accepted, reply.reason) == (False, words)


def test_who_may_lead_refuses_a_formation_that_leaves_the_fence_wherever_the_reference_leads() -> None:
    eight = Flight(fleet=MAY_LEAD, reference=EIGHT)
    eight.tick()
    reply = eight.tick(CommandName.FORMATION, lead=FormationChange(1, SLOTS, 1.0, 10.0)).replies[0]
    assert "puts vehicle 2 at x = -10" in reply.reason  # 3 m west of the eight's centre, half a minute from now


def test_a_formation_commanded_on_the_ground_is_the_next_flight_s() -> None:
    flight = Flight()
    flight.tick()
    change = FormationChange(1, ((1, (0.0, 0.0, 0.0)), (2, (-3.0, 0.0, 0.0))), 1.0, 10.0)
    flight.peer_phase = FlightPhase.READY
    flight.tick()
    reply = flight.tick(CommandName.FORMATION, lead=change).replies[0]
    assert (reply.accepted, reply.reason) == (True, "formation 1, on the ground at once")
    packet = flight.tick().peer_packet
    assert packet is not None
    assert packet.slot == FlownSlot((-3.0, 0.0, 0.0), formation=1, waiting=1)
