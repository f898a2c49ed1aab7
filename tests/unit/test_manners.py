"""Agents and autopilots of both manners talk in real MAVLink bytes: whole flights, refusals, lost truth, last words."""

from __future__ import annotations

import struct
from collections.abc import Callable
from math import inf, nan, pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.assembly import build_agent
from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember
from companion.config.reference import PointReference
from companion.config.vehicle import AgentConfig, VehicleConfig
from companion.core.envelope import EnvelopeLimits, LastGate
from companion.core.safeguard import HAND_OVER_S
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.mavlink.manners import MANNERS
from companion.mavlink.translator import Translator
from companion.types import (
    AttitudeTarget,
    AutopilotKind,
    AutopilotMode,
    Command,
    CommandName,
    FlightPhase,
    Inbox,
    Role,
    Status,
)

M, P, C = mavlink, FlightPhase, CommandName
PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
BOTH = pytest.mark.parametrize("kind", list(AutopilotKind))
MAV_AUTOPILOT = {PX4: M.MAV_AUTOPILOT_PX4, ARDUPILOT: M.MAV_AUTOPILOT_ARDUPILOTMEGA}
ORIGIN_AMSL_M = 488.0
TAKEOFF_M = 2.0
MANUAL = {PX4: 1 << 16, ARDUPILOT: 0}  # MANUAL, STABILIZE
HOLD = {PX4: 4 << 16 | 3 << 24, ARDUPILOT: 17}
IN_ORDER: dict[AutopilotKind, dict[str, int | float]] = {
    PX4: {
        "COM_OF_LOSS_T": 1.0,
        "COM_OBL_RC_ACT": 5,
        "NAV_DLL_ACT": 0,
        "COM_RC_OVERRIDE": 3,
        "GF_ACTION": 2,
        "GF_MAX_HOR_DIST": 100.0,
        "GF_MAX_VER_DIST": 50.0,
        "MPC_THR_HOVER": 0.5,
    },
    ARDUPILOT: {
        "GUID_OPTIONS": 8,
        "ATC_ANGLE_BOOST": 1,
        "GUID_TIMEOUT": 1.0,
        "FS_GCS_ENABLE": 0,
        "FENCE_ENABLE": 1,
        "FENCE_ACTION": 1,
        "MOT_THST_HOVER": 0.5,
    },
}
Answer = tuple[int, ...]
ACCEPTED, FAILED = M.MAV_RESULT_ACCEPTED, M.MAV_RESULT_FAILED
TEMPORARILY_REJECTED = M.MAV_RESULT_TEMPORARILY_REJECTED


class Autopilot:
    """Does what it is asked, unless `refuses` has answers for the command; those it gives, and does nothing."""

    def __init__(self, kind: AutopilotKind) -> None:
        self.kind = kind
        self.custom_mode, self.armed, self.landed, self.up_m = MANUAL[kind], False, 1, 0.0
        self.north_m_s = 0.0
        self.refuses: dict[int, Answer] = {}
        self.says: list[MavlinkMessage] = []  # next time
        self.withheld: tuple[str, ...] = ()
        self.parameters = dict(IN_ORDER[kind])
        self.battery_percent = 90
        self.may_arm = True
        self.read: list[str] = []  # names of parameters that were asked for
        self.commands: list[MavlinkMessage] = []
        self.targets: list[MavlinkMessage] = []
        self._codec = MavlinkCodec(3, 1)
        self._ticks = 0

    def tell(self) -> bytes:
        """50 Hz; PX4's HEARTBEAT once a second."""
        boot_ms = 20 * self._ticks
        said, self.says = self.says, []
        said.append(M.MAVLink_attitude_quaternion_message(boot_ms, 1, 0, 0, 0, 0, 0, 0))
        said.append(M.MAVLink_extended_sys_state_message(0, self.landed))
        healthy = M.MAV_SYS_STATUS_PREARM_CHECK if self.may_arm else 0
        said.append(M.MAVLink_sys_status_message(0, 0, healthy, 0, 0, 0, self.battery_percent, 0, 0, 0, 0, 0, 0))
        if self.kind is PX4:
            said.append(M.MAVLink_current_mode_message(0, self.custom_mode, self.custom_mode))
        if self.kind is ARDUPILOT or self._ticks % 50 == 0:
            said.append(self.heartbeat())
        said.append(M.MAVLink_local_position_ned_message(boot_ms, 0, 0, -self.up_m, self.north_m_s, 0, 0))
        self._ticks += 1
        return b"".join(self._codec.encode(m) for m in said if m.get_type() not in self.withheld)

    def heartbeat(self) -> MavlinkMessage:
        flags = M.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (M.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        return M.MAVLink_heartbeat_message(
            M.MAV_TYPE_QUADROTOR, MAV_AUTOPILOT[self.kind], flags, self.custom_mode, 4, 3
        )

    def hear(self, data: bytes) -> None:
        for message in self._codec.decode(data):
            if message.get_type() == "SET_ATTITUDE_TARGET":
                self.targets.append(message)
            elif message.get_type() == "PARAM_REQUEST_READ":
                self._tell_parameter(message.param_id)
            else:
                self._command(message)

    def _tell_parameter(self, name: str) -> None:
        """Integers bytewise in PX4's, as numbers in ArduPilot's. It says nothing of what it does not have."""
        self.read.append(name)
        if name not in self.parameters:
            return
        value = self.parameters[name]
        kind = M.MAV_PARAM_TYPE_INT32 if isinstance(value, int) else M.MAV_PARAM_TYPE_REAL32
        if isinstance(value, int) and self.kind is PX4:
            value = struct.unpack("<f", struct.pack("<i", value))[0]
        self.says.append(M.MAVLink_param_value_message(name.encode(), value, kind, len(self.parameters), 0))

    def _command(self, message: MavlinkMessage) -> None:
        number = message.command
        if number == M.MAV_CMD_REQUEST_MESSAGE:
            self.says.append(M.MAVLink_gps_global_origin_message(473977420, 85455940, int(ORIGIN_AMSL_M * 1000)))
            return
        self.commands.append(message)
        answers = self.refuses.get(number, (ACCEPTED,))
        self.says += [M.MAVLink_command_ack_message(number, result) for result in answers]
        if number not in self.refuses:
            self._do(message)

    def _do(self, message: MavlinkMessage) -> None:
        match message.command:
            case M.MAV_CMD_DO_SET_MODE:
                main, sub = int(message.param2), int(message.param3)
                self.custom_mode = main << 16 | sub << 24 if self.kind is PX4 else main
            case M.MAV_CMD_COMPONENT_ARM_DISARM:
                self.armed = bool(message.param1)
            case M.MAV_CMD_NAV_TAKEOFF:
                above_m = ORIGIN_AMSL_M if self.kind is PX4 else 0.0
                self.up_m, self.landed = message.param7 - above_m, 2
                self.custom_mode = HOLD[PX4] if self.kind is PX4 else self.custom_mode


class Flight:
    """An agent and its autopilot, tick by tick, with nothing but bytes between them."""

    def __init__(self, kind: AutopilotKind, wanted: AutopilotKind | None = None) -> None:
        member = FormationMember(id=3, role=Role.LEADER, slot_enu_m=(0.0, 0.0, 0.0))
        fleet = FleetConfig(
            name="one",
            origin="indoor",
            vehicles=(member,),
            neighbours=EdgeNeighbours(edges=()),
            takeoff_height_m=TAKEOFF_M,
        )
        vehicle = VehicleConfig(
            id=3,
            fleet="fleet.yaml",
            mavlink="udpin:127.0.0.1:14540",
            hover_thrust_norm=0.5,
            reference=PointReference(point_enu_m=(20.0, 0.0, TAKEOFF_M)),  # far away: it leans as far as it may
        )
        self.autopilot = Autopilot(kind)
        self.translator = Translator(3, wanted)
        self.agent = build_agent(AgentConfig(vehicle, fleet, member), session=1)
        self.now_s = 100.0
        self.stopping = False
        self.events: list[str] = []
        self.status: Status | None = None  # the newest
        self.replies: list[tuple[bool, str]] = []
        self._number = 0  # of the last command

    def next_number(self) -> int:
        self._number += 1
        return self._number

    def tick(self, *names: CommandName) -> None:
        self.now_s += 0.02
        telemetry = tuple(self.translator.telemetry(self.autopilot.tell(), self.now_s))
        commands = tuple(Command(name, self.next_number(), "anna@ground", 1) for name in names)
        outbox = self.agent.step(self.now_s, Inbox(telemetry, (), commands, self.stopping))
        if outbox.attitude_target:
            self.autopilot.hear(self.translator.attitude_target(outbox.attitude_target, self.now_s))
        for request in outbox.requests:
            self.autopilot.hear(self.translator.request(request))
        self.events += outbox.events
        self.status = outbox.status or self.status
        self.replies += [(reply.accepted, reply.reason) for reply in outbox.replies]

    def ticks(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.02)):
            self.tick()

    def do(self, name: CommandName, seconds: float = 2.0) -> FlightPhase:
        self.tick(name)
        assert self.replies[-1][0], self.replies[-1]
        self.ticks(seconds)
        return self.agent.phase

    def fly_to(self, phase: FlightPhase) -> Flight:
        self.ticks(0.2)
        for name in (C.PREPARE, C.ARM, C.TAKEOFF, C.FORM):
            if self.agent.phase is not phase:
                self.do(name)
        assert self.agent.phase is phase, self.events
        return self


def asked(flight: Flight) -> list[tuple[float, ...]]:
    """(command, the parameters that are not zero) of all COMMAND_LONGs."""
    return [
        (
            m.command,
            *(p for p in (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7) if p and p == p),
        )
        for m in flight.autopilot.commands
    ]


def test_the_words_of_a_whole_flight_with_px4() -> None:
    flight = Flight(PX4).fly_to(P.FORMATION)
    assert flight.do(C.HOLD) is P.HOLD
    assert flight.do(C.LAND) is P.LAND
    assert asked(flight) == [(176, 1, 4, 3), (400, 1), (22, 490), (176, 1, 6), (176, 1, 4, 3), (176, 1, 4, 6)]


def test_the_words_of_a_whole_flight_with_ardupilot() -> None:
    flight = Flight(ARDUPILOT).fly_to(P.FORMATION)
    assert flight.do(C.HOLD) is P.HOLD
    assert flight.do(C.FORM) is P.FORMATION  # from BRAKE now
    assert flight.do(C.LAND) is P.LAND
    flight.autopilot.armed = False
    flight.tick()
    assert flight.agent.phase is P.OBSERVE
    assert asked(flight) == [(176, 1, 4), (400, 1), (22, 2), (176, 1, 4), (176, 1, 17), (176, 1, 4), (176, 1, 9)]


@BOTH
@pytest.mark.parametrize(
    ("before", "name", "number"),
    [
        (P.OBSERVE, C.PREPARE, M.MAV_CMD_DO_SET_MODE),
        (P.READY, C.ARM, M.MAV_CMD_COMPONENT_ARM_DISARM),
        (P.ARMED, C.TAKEOFF, M.MAV_CMD_NAV_TAKEOFF),
        (P.FORMATION, C.HOLD, M.MAV_CMD_DO_SET_MODE),
        (P.HOLD, C.LAND, M.MAV_CMD_DO_SET_MODE),
    ],
)
@pytest.mark.parametrize("answers", [(ACCEPTED,), (ACCEPTED, TEMPORARILY_REJECTED), (FAILED,), ()])
def test_no_answer_makes_a_success_and_retries_are_bounded(
    kind: AutopilotKind, before: FlightPhase, name: CommandName, number: int, answers: Answer
) -> None:
    flight = Flight(kind).fly_to(before)
    flight.autopilot.refuses[number] = answers
    flight.autopilot.commands.clear()
    flight.tick(name)
    during, began_s = flight.agent.phase, flight.now_s
    while flight.agent.phase is during and flight.now_s < began_s + 130.0:
        flight.tick()
    assert f"({during} failed: " in flight.events[-1]
    assert flight.agent.phase in (P.OBSERVE, P.READY)
    assert 1 <= len(flight.autopilot.commands) <= 250
    assert len({m.command for m in flight.autopilot.commands}) == 1


def test_ardupilots_reason_in_chunks_is_relayed() -> None:
    flight = Flight(ARDUPILOT).fly_to(P.READY)
    flight.autopilot.refuses[M.MAV_CMD_COMPONENT_ARM_DISARM] = (FAILED,)
    flight.tick(C.ARM)
    whole = b"Arm: Accels inconsistent, and this is a reason that goes on in a second chunk"
    for number, text in ((0, b"Arm: Need Position Estimate"), (7, whole), (8, whole)):
        chunks = [text[i : i + 50] for i in range(0, len(text), 50)]
        flight.autopilot.says += [M.MAVLink_statustext_message(2, c, number, i) for i, c in enumerate(chunks)]
    flight.ticks(12.0)
    assert flight.agent.phase is P.READY
    assert flight.events[-1] == (
        "arm -> ready (arm failed: COMPONENT_ARM_DISARM failed: Arm: Need Position Estimate; " + whole.decode() + ")"
    )


def test_px4s_offboard_first_accepted_and_then_refused() -> None:
    flight = Flight(PX4).fly_to(P.HOLD)
    flight.autopilot.refuses[M.MAV_CMD_DO_SET_MODE] = (ACCEPTED, TEMPORARILY_REJECTED)
    assert flight.do(C.FORM, 6.0) is P.HOLD
    assert flight.events[-1] == "engage -> hold (engage failed: DO_SET_MODE temporarily rejected)"


@BOTH
def test_an_accepted_take_off_is_asked_for_again_only_where_nothing_shows_it(kind: AutopilotKind) -> None:
    """ArduCopter begins its run-up anew whenever it is asked, and shows it only 3 s later."""
    flight = Flight(kind).fly_to(P.ARMED)
    flight.autopilot.refuses[M.MAV_CMD_NAV_TAKEOFF] = (ACCEPTED,)
    flight.autopilot.commands.clear()
    flight.do(C.TAKEOFF, 3.0)
    assert len(flight.autopilot.commands) == (1 if kind is ARDUPILOT else 6)


def test_ardupilots_climb_is_over_when_its_landed_state_says_so() -> None:
    flight = Flight(ARDUPILOT).fly_to(P.ARMED)
    flight.autopilot.refuses[M.MAV_CMD_NAV_TAKEOFF] = (ACCEPTED,)
    flight.do(C.TAKEOFF)
    flight.autopilot.landed, flight.autopilot.up_m = 3, TAKEOFF_M
    flight.ticks(1.0)
    assert flight.agent.phase is P.TAKEOFF
    flight.autopilot.landed = 2
    flight.tick()
    assert flight.agent.phase is P.HOLD


@BOTH
def test_an_old_heartbeat_arms_nothing(kind: AutopilotKind) -> None:
    """The truth must be newer than the request."""
    flight = Flight(kind).fly_to(P.READY)
    flight.autopilot.withheld = ("HEARTBEAT",)
    assert flight.do(C.ARM, 1.0) is P.ARM
    assert flight.autopilot.armed
    flight.autopilot.withheld = ()
    flight.ticks(1.0)
    assert flight.agent.phase is P.ARMED


@BOTH
@pytest.mark.parametrize("phase", [P.READY, P.HOLD, P.FORMATION])
def test_a_mode_that_is_the_pilots_ends_the_stream_at_once(kind: AutopilotKind, phase: FlightPhase) -> None:
    flight = Flight(kind).fly_to(phase)
    flight.autopilot.custom_mode = 3 << 16 if kind is PX4 else 5  # POSCTL, LOITER
    flight.autopilot.targets.clear()
    flight.autopilot.commands.clear()
    flight.ticks(3.0)
    assert flight.agent.phase is P.OBSERVE
    assert flight.events[-1].endswith(f"(mode {'POSCTL' if kind is PX4 else 'LOITER'} was set by someone else)")
    assert (flight.autopilot.targets, flight.autopilot.commands) == ([], [])


def level_targets(flight: Flight) -> list[bool]:
    return [abs(m.q[1]) < 1e-6 and abs(m.q[2]) < 1e-6 for m in flight.autopilot.targets]


def without_positions(flight: Flight) -> None:
    flight.autopilot.withheld = ("LOCAL_POSITION_NED",)


def without_obedience(flight: Flight) -> None:
    flight.stopping, flight.autopilot.north_m_s = True, 1.0
    flight.autopilot.refuses[M.MAV_CMD_DO_SET_MODE] = ()


@BOTH
@pytest.mark.parametrize("disturb", [without_positions, without_obedience])
def test_the_last_word_to_who_goes_on_with_it_is_level(kind: AutopilotKind, disturb: Callable[[Flight], None]) -> None:
    flight = Flight(kind).fly_to(P.FORMATION)
    assert not any(level_targets(flight)[-5:])
    disturb(flight)
    flight.autopilot.targets.clear()
    flight.ticks(HAND_OVER_S + 1.0)
    levels = level_targets(flight)
    assert levels[-1:] == ([True] if kind is ARDUPILOT else [False] if disturb is without_obedience else [])
    assert flight.autopilot.targets == [] or flight.autopilot.targets[-1].thrust == pytest.approx(0.5, abs=0.1)
    assert flight.agent.has_handed_over


def test_silence_has_one_last_word_and_what_follows_is_flown() -> None:
    flight = Flight(ARDUPILOT).fly_to(P.FORMATION)
    for _ in range(2):
        flight.autopilot.targets.clear()
        flight.autopilot.withheld = ("LOCAL_POSITION_NED",)
        flight.ticks(0.3)
        assert level_targets(flight) == [True]
        flight.autopilot.withheld = ()
        flight.ticks(0.3)
        assert flight.agent.phase is P.FORMATION
        assert not any(level_targets(flight)[-10:])


def test_a_long_silence_ends_in_ardupilots_brake_but_takes_nothing_from_an_unseen_pilot() -> None:
    flight = Flight(ARDUPILOT).fly_to(P.FORMATION)
    flight.autopilot.withheld = ("LOCAL_POSITION_NED",)
    flight.ticks(1.0)
    assert flight.agent.phase is P.HOLD
    assert flight.autopilot.custom_mode == HOLD[ARDUPILOT]
    blind = Flight(ARDUPILOT).fly_to(P.FORMATION)
    blind.autopilot.withheld = ("LOCAL_POSITION_NED", "HEARTBEAT")
    blind.autopilot.commands.clear()
    blind.ticks(5.0)
    assert blind.agent.phase is P.OBSERVE
    assert blind.autopilot.commands == []


@BOTH
def test_an_agent_started_in_flight_sends_nothing_until_it_is_told_to_hold(kind: AutopilotKind) -> None:
    flying = Flight(kind).fly_to(P.FORMATION).autopilot
    restarted = Flight(kind)
    restarted.autopilot = flying
    flying.targets.clear()
    flying.commands.clear()
    restarted.ticks(3.0)
    for name in (C.PREPARE, C.ARM, C.TAKEOFF, C.FORM, C.DISARM):
        restarted.tick(name)
        assert not restarted.replies[-1][0]
    assert (flying.targets, flying.commands) == ([], [])
    assert restarted.do(C.HOLD) is P.HOLD
    assert flying.custom_mode == HOLD[kind]
    assert flying.targets == []


@BOTH
def test_before_its_heartbeat_nothing_is_asked_and_every_command_refused(kind: AutopilotKind) -> None:
    flight = Flight(kind)
    flight.autopilot.withheld = ("HEARTBEAT",)
    flight.ticks(1.0)
    for name in (C.PREPARE, C.ARM, C.TAKEOFF, C.FORM, C.HOLD, C.LAND, C.DISARM):
        flight.tick(name)
        accepted, reason = flight.replies[-1]
        assert not accepted
        assert reason.startswith(f"{name}: ")
    assert flight.autopilot.commands == []


@BOTH
def test_a_heartbeat_that_contradicts_the_vehicle_file_is_refused_in_words(kind: AutopilotKind) -> None:
    other = PX4 if kind is ARDUPILOT else ARDUPILOT
    flight = Flight(kind, wanted=other)
    flight.ticks(1.0)
    assert flight.translator.rejected["HEARTBEAT of another make of autopilot"] > 0
    said, expected = (f"{MAV_AUTOPILOT[k]} ({MANNERS[k].NAME})" for k in (kind, other))
    assert flight.translator.refused_heartbeat == f"its HEARTBEAT says MAV_AUTOPILOT {said}, expected {expected}"
    flight.tick(C.HOLD)
    assert flight.replies[-1] == (False, "hold: no HEARTBEAT has come from the autopilot yet")


@BOTH
def test_an_autopilot_does_not_change_its_make_in_flight(kind: AutopilotKind) -> None:
    flight = Flight(kind).fly_to(P.HOLD)
    flight.autopilot.says.append(Autopilot(PX4 if kind is ARDUPILOT else ARDUPILOT).heartbeat())
    flight.ticks(1.0)
    assert flight.agent.phase is P.HOLD
    assert flight.translator.rejected == {"HEARTBEAT of another make of autopilot": 1}


def test_an_arduplane_is_no_arducopter() -> None:
    translator = Translator(3)
    plane = M.MAVLink_heartbeat_message(M.MAV_TYPE_FIXED_WING, M.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 4, 4, 3)
    assert translator.telemetry(MavlinkCodec(3, 1).encode(plane), 1.0) == []
    assert translator.refused_heartbeat == (
        "its HEARTBEAT says MAV_AUTOPILOT 3 of MAV_TYPE 1, expected 12 (PX4) or 3 (ArduCopter)"
    )


def test_ardupilots_modes_by_meaning() -> None:
    mode_of = MANNERS[ARDUPILOT].mode_of
    assert mode_of(4) == (AutopilotMode.OFFBOARD, "GUIDED")
    assert mode_of(17) == (AutopilotMode.HOLD, "BRAKE")
    assert mode_of(9) == (AutopilotMode.LAND, "LAND")
    assert mode_of(6) == (AutopilotMode.RETURN, "RTL")
    for number in (0, 2, 3, 5, 16, 20, 21, 27, 99):
        assert mode_of(number)[0] is AutopilotMode.OTHER
    assert mode_of(99)[1] == "mode 99"


def sent(kind: AutopilotKind, target: AttitudeTarget) -> MavlinkMessage:
    (message,) = MavlinkCodec(3, 1).decode(Translator(3, kind).attitude_target(target, 12.5))
    return message


def test_ardupilot_raises_the_thrust_by_the_tilt_itself() -> None:
    leaning = AttitudeTarget(pi / 3, 0.0, 0.0, 0.6)
    assert sent(PX4, leaning).thrust == pytest.approx(0.6)
    assert sent(ARDUPILOT, leaning).thrust == pytest.approx(0.3)


ANY = st.one_of(st.floats(width=64), st.sampled_from([nan, inf, -inf, 1e300, pi, -pi]))


@given(kind=st.sampled_from(list(AutopilotKind)), angles=st.tuples(ANY, ANY, ANY), thrust=ANY)
def test_whatever_is_wanted_what_is_sent_is_a_rotation_and_a_thrust(
    kind: AutopilotKind, angles: tuple[float, float, float], thrust: float
) -> None:
    """PX4 falls at a NaN thrust; ArduCopter's process ends at a NaN quaternion, and it stops at one that is not of length 1."""
    limits = EnvelopeLimits(0.5, 7.0, 0.3, 1.6, 10.0, (-9.0, -9.0, -9.0), (9.0, 9.0, 9.0))
    gate = LastGate(limits)
    gate.open_at(0.0, AttitudeTarget(0.0, 0.0, 0.0, 0.5), 0.5)
    admitted = gate.admit(0.02, AttitudeTarget(*angles, thrust), 0.5)
    if admitted is None:
        return
    message = sent(kind, admitted)
    assert sum(q * q for q in message.q) == pytest.approx(1.0, abs=1e-5)
    assert 0.0 < message.thrust <= 1.0
    assert message.type_mask == 7
