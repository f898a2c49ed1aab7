"""Agents with PX4 and ArduPilot stand-ins in real MAVLink bytes: flights, refusals, lost telemetry, last setpoints."""

from __future__ import annotations

from collections.abc import Callable
from math import hypot, inf, nan, pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent_on_bytes import (
    ACCEPTED,
    ARDUPILOT,
    BOTH,
    FAILED,
    HOLD,
    MAV_AUTOPILOT,
    PX4,
    TAKEOFF_M,
    TEMPORARILY_REJECTED,
    Answer,
    AutopilotOnBytes,
    C,
    FlightOnBytes,
    M,
    P,
    asked,
)
from companion.core.control.setpoint import STOPS_IN_S
from companion.core.safety.limits import OutputLimiter, OutputLimits
from companion.core.safety.safeguard import HAND_OVER_S
from companion.geometry.airspace import Fence
from companion.mavlink.autopilot_types import DIALECTS
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage
from companion.mavlink.translator import Translator
from companion.types.autopilot import AttitudeTarget, AutopilotKind, AutopilotMode
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from companion.types.values import GRAVITY_M_S2


def test_messages_of_a_whole_flight_with_px4() -> None:
    flight = FlightOnBytes(PX4).fly_to(P.FORMATION)
    assert flight.do(C.HOLD) is P.HOLD
    assert flight.do(C.LAND) is P.LAND
    assert asked(flight) == [(176, 1, 4, 3), (400, 1), (22, 490), (176, 1, 6), (176, 1, 4, 3), (176, 1, 4, 6)]


def test_messages_of_a_whole_flight_with_ardupilot() -> None:
    flight = FlightOnBytes(ARDUPILOT).fly_to(P.FORMATION)
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
@pytest.mark.parametrize(
    "answers",
    [
        (ACCEPTED,),
        pytest.param((ACCEPTED, TEMPORARILY_REJECTED), marks=pytest.mark.long),
        pytest.param((FAILED,), marks=pytest.mark.long),
        (),
    ],
)
def test_a_procedure_without_effect_fails_after_bounded_retries(
    kind: AutopilotKind, before: FlightPhase, name: CommandName, number: int, answers: Answer
) -> None:
    flight = FlightOnBytes(kind).fly_to(before)
    flight.autopilot.refuses[number] = answers
    flight.autopilot.commands.clear()
    flight.tick(name)
    during, began_s = flight.agent.phase, flight.now_s
    while flight.agent.phase is during and flight.now_s < began_s + 130.0:
        flight.tick()
    assert flight.events[-1].code is Code.PROCEDURE_FAILED
    assert f"({during} failed: " in flight.events[-1].text
    assert flight.agent.phase is {C.ARM: P.READY, C.HOLD: P.LAND}.get(name, P.OBSERVE)
    assert 1 <= len(flight.autopilot.commands) <= 250
    assert len({m.command for m in flight.autopilot.commands}) == 1


def test_ardupilots_reason_in_chunks_is_relayed() -> None:
    flight = FlightOnBytes(ARDUPILOT).fly_to(P.READY)
    flight.autopilot.refuses[M.MAV_CMD_COMPONENT_ARM_DISARM] = (FAILED,)
    flight.tick(C.ARM)
    whole = b"Arm: Accels inconsistent, and this is a reason that goes on in a second chunk"
    for number, text in ((0, b"Arm: Need Position Estimate"), (7, whole), (8, whole)):
        chunks = [text[i : i + 50] for i in range(0, len(text), 50)]
        flight.autopilot.queued += [M.MAVLink_statustext_message(2, c, number, i) for i, c in enumerate(chunks)]
    flight.ticks(12.0)
    assert flight.agent.phase is P.READY
    assert flight.events[-1].text == (
        "arm -> ready (arm failed: COMPONENT_ARM_DISARM failed: Arm: Need Position Estimate; " + whole.decode() + ")"
    )


def test_the_vehicle_holds_when_px4_refuses_offboard_after_accepting_it() -> None:
    flight = FlightOnBytes(PX4).fly_to(P.HOLD)
    flight.autopilot.refuses[M.MAV_CMD_DO_SET_MODE] = (ACCEPTED, TEMPORARILY_REJECTED)
    assert flight.do(C.FORM, 6.0) is P.HOLD
    assert flight.events[-1].text == "engage -> hold (engage failed: DO_SET_MODE temporarily rejected)"


@BOTH
def test_an_accepted_take_off_is_requested_again_only_with_px4(kind: AutopilotKind) -> None:
    """ArduCopter restarts its spin-up with every request and reports the climb 3 s later."""
    flight = FlightOnBytes(kind).fly_to(P.ARMED)
    flight.autopilot.refuses[M.MAV_CMD_NAV_TAKEOFF] = (ACCEPTED,)
    flight.autopilot.commands.clear()
    flight.do(C.TAKEOFF, 3.0)
    assert len(flight.autopilot.commands) == (1 if kind is ARDUPILOT else 6)


def test_ardupilots_climb_ends_with_the_landed_state_in_air() -> None:
    flight = FlightOnBytes(ARDUPILOT).fly_to(P.ARMED)
    flight.autopilot.refuses[M.MAV_CMD_NAV_TAKEOFF] = (ACCEPTED,)
    flight.do(C.TAKEOFF)
    flight.autopilot.landed, flight.autopilot.up_m = 3, TAKEOFF_M
    flight.ticks(1.0)
    assert flight.agent.phase is P.TAKEOFF
    flight.autopilot.landed = 2
    flight.tick()
    assert flight.agent.phase is P.HOLD


@BOTH
def test_arming_waits_for_a_heartbeat_newer_than_the_request(kind: AutopilotKind) -> None:
    flight = FlightOnBytes(kind).fly_to(P.READY)
    flight.autopilot.withheld = ("HEARTBEAT",)
    assert flight.do(C.ARM, 1.0) is P.ARM
    assert flight.autopilot.armed
    flight.autopilot.withheld = ()
    flight.ticks(1.0)
    assert flight.agent.phase is P.ARMED


@BOTH
@pytest.mark.parametrize("phase", [P.READY, P.HOLD, P.FORMATION])
def test_a_pilot_mode_ends_the_stream_at_once(kind: AutopilotKind, phase: FlightPhase) -> None:
    flight = FlightOnBytes(kind).fly_to(phase)
    flight.autopilot.custom_mode = 3 << 16 if kind is PX4 else 5  # POSCTL, LOITER
    flight.autopilot.targets.clear()
    flight.autopilot.commands.clear()
    flight.ticks(3.0)
    assert flight.agent.phase is P.OBSERVE
    assert flight.events[-1].code is Code.MODE_CHANGED_BY_OTHERS
    assert f"mode {'POSCTL' if kind is PX4 else 'LOITER'} " in flight.events[-1].text
    assert (flight.autopilot.targets, flight.autopilot.commands) == ([], [])


LEVEL = 2e-3  # of a quaternion: the last setpoint brakes what the attitude lag still adds


def level_targets(flight: FlightOnBytes) -> list[bool]:
    return [abs(m.q[1]) < LEVEL and abs(m.q[2]) < LEVEL for m in flight.autopilot.targets]


def without_positions(flight: FlightOnBytes) -> None:
    flight.autopilot.withheld = ("LOCAL_POSITION_NED",)


def without_mode_changes(flight: FlightOnBytes) -> None:
    flight.stopping, flight.autopilot.north_m_s = True, 1.0
    flight.autopilot.refuses[M.MAV_CMD_DO_SET_MODE] = ()


@BOTH
@pytest.mark.parametrize("disturb", [without_positions, without_mode_changes])
def test_the_last_setpoint_brakes_as_the_autopilot_continues_it(
    kind: AutopilotKind, disturb: Callable[[FlightOnBytes], None]
) -> None:
    flight = FlightOnBytes(kind).fly_to(P.FORMATION)
    assert not any(level_targets(flight)[-5:])
    disturb(flight)
    flight.autopilot.targets.clear()
    flight.ticks(HAND_OVER_S + 1.0)
    last = flight.autopilot.targets[-1]
    (x, y, z, w) = (last.q[1], last.q[2], last.q[3], last.q[0])
    tilt_rad = hypot(2.0 * (w * x + y * z), 2.0 * (w * y - z * x))  # small
    at_m_s = 0.0 if disturb is without_positions else 1.0  # which braking does not change, as in a wind
    assert tilt_rad <= at_m_s / STOPS_IN_S / GRAVITY_M_S2 + 2.0 * LEVEL
    assert last.thrust == pytest.approx(0.5, abs=0.1)
    assert flight.agent.has_handed_over


def test_one_level_setpoint_ends_a_stream() -> None:
    flight = FlightOnBytes(ARDUPILOT).fly_to(P.FORMATION)
    for _ in range(2):
        flight.autopilot.targets.clear()
        flight.autopilot.withheld = ("LOCAL_POSITION_NED",)
        flight.ticks(0.3)
        assert level_targets(flight) == [True]
        flight.autopilot.withheld = ()
        flight.ticks(0.3)
        assert flight.agent.phase is P.FORMATION
        assert not any(level_targets(flight)[-10:])


def test_a_long_silence_ends_in_brake_unless_the_mode_is_unknown() -> None:
    flight = FlightOnBytes(ARDUPILOT).fly_to(P.FORMATION)
    flight.autopilot.withheld = ("LOCAL_POSITION_NED",)
    flight.ticks(1.0)
    assert flight.agent.phase is P.HOLD
    assert flight.autopilot.custom_mode == HOLD[ARDUPILOT]
    blind = FlightOnBytes(ARDUPILOT).fly_to(P.FORMATION)
    blind.autopilot.withheld = ("LOCAL_POSITION_NED", "HEARTBEAT")
    blind.autopilot.commands.clear()
    blind.ticks(5.0)
    assert blind.agent.phase is P.OBSERVE
    assert blind.autopilot.commands == []


@BOTH
def test_an_agent_started_in_flight_sends_nothing_until_a_hold_command(kind: AutopilotKind) -> None:
    flying = FlightOnBytes(kind).fly_to(P.FORMATION).autopilot
    restarted = FlightOnBytes(kind)
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
def test_every_command_is_refused_before_the_heartbeat(kind: AutopilotKind) -> None:
    flight = FlightOnBytes(kind)
    flight.autopilot.withheld = ("HEARTBEAT",)
    flight.ticks(1.0)
    for name in (C.PREPARE, C.ARM, C.TAKEOFF, C.FORM, C.HOLD, C.LAND, C.DISARM):
        flight.tick(name)
        accepted, _, reason = flight.replies[-1]
        assert not accepted
        assert reason.startswith(f"{name}: ")
    assert flight.autopilot.commands == []


@BOTH
def test_a_heartbeat_of_another_make_than_configured_is_refused(kind: AutopilotKind) -> None:
    other = PX4 if kind is ARDUPILOT else ARDUPILOT
    flight = FlightOnBytes(kind, wanted=other)
    flight.ticks(1.0)
    assert flight.translator.rejected[Code.AUTOPILOT_OTHER_MAKE] > 0
    reported, expected = (f"{MAV_AUTOPILOT[k]} ({DIALECTS[k].NAME})" for k in (kind, other))
    assert flight.translator.refused_heartbeat == f"HEARTBEAT reports MAV_AUTOPILOT {reported}, expected {expected}"
    flight.tick(C.HOLD)
    assert flight.replies[-1][:2] == (False, Code.NO_HEARTBEAT)


@BOTH
def test_an_autopilot_does_not_change_its_make_in_flight(kind: AutopilotKind) -> None:
    flight = FlightOnBytes(kind).fly_to(P.HOLD)
    flight.autopilot.queued.append(AutopilotOnBytes(PX4 if kind is ARDUPILOT else ARDUPILOT).heartbeat())
    flight.ticks(1.0)
    assert flight.agent.phase is P.HOLD
    assert flight.translator.rejected == {Code.AUTOPILOT_OTHER_MAKE: 1}


def test_an_arduplane_is_refused() -> None:
    translator = Translator(3)
    plane = M.MAVLink_heartbeat_message(M.MAV_TYPE_FIXED_WING, M.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 4, 4, 3)
    assert translator.telemetry(MavlinkCodec(3, 1).encode(plane), 1.0) == []
    assert translator.refused_heartbeat == (
        "HEARTBEAT reports MAV_AUTOPILOT 3 of MAV_TYPE 1, expected 12 (PX4) or 3 (ArduCopter)"
    )


def test_ardupilots_modes_by_meaning() -> None:
    mode_of = DIALECTS[ARDUPILOT].mode_of
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
def test_every_attitude_target_sent_is_a_rotation_and_a_thrust(
    kind: AutopilotKind, angles: tuple[float, float, float], thrust: float
) -> None:
    """PX4 falls at a NaN thrust; ArduCopter crashes at a NaN quaternion and stops at one whose length is not 1."""
    limits = OutputLimits(0.5, 7.0, 0.3, 1.6, 10.0, Fence((-9.0, -9.0, -9.0), (9.0, 9.0, 9.0)))
    gate = OutputLimiter(limits)
    gate.open_at(0.0, AttitudeTarget(0.0, 0.0, 0.0, 0.5), 0.5)
    admitted = gate.admit(0.02, AttitudeTarget(*angles, thrust), 0.5)
    if admitted is None:
        return
    message = sent(kind, admitted)
    assert sum(q * q for q in message.q) == pytest.approx(1.0, abs=1e-5)
    assert 0.0 < message.thrust <= 1.0
    assert message.type_mask == 7
