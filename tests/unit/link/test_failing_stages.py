"""A fault in every stage of the tick, for both autopilots: level attitude, the autopilot's hold, the reason, the end."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable
from typing import Any

import pytest

from agent_on_bytes import BOTH, HOLD, MANUAL, PERIOD_S, FailingFlight
from companion.core.agent import Agent
from companion.core.command.hand_over import BRAKES_WITHIN_S
from companion.core.consensus.peers import FleetLimits, PeerTable
from companion.core.safety.safeguard import HAND_OVER_WITHIN_S
from companion.link.control_loop import ControlLoop
from companion.mavlink.codec import mavlink
from companion.types.autopilot import AutopilotKind
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from companion.types.values import ZERO3

P = FlightPhase
SET_MODE = mavlink.MAV_CMD_DO_SET_MODE
LEVEL = 1e-6
LIMITS = FleetLimits(25.0, 20.0, (200.0, 200.0, 55.0))
CLEARED_S = 0.25  # level setpoints at the end of formation, before the next mode is requested

# Owner and method of each stage, in the order of the tick.
STAGES: dict[str, Callable[[FailingFlight], tuple[Any, str]]] = {
    "peers and commands received": lambda flight: (flight.peers, "receive"),
    "targets received": lambda flight: (flight.peers, "targets"),
    "checks received": lambda flight: (flight.peers, "checks"),
    "arbitration": lambda flight: (flight.agent.arbitration, "step"),
    "packets of the peers": lambda flight: (flight.agent.consensus, "receive"),
    "late peers received": lambda flight: (flight.peers, "receive_late"),
    "traffic received": lambda flight: (flight.peers, "traffic"),
    "telemetry drained": lambda flight: (flight.link, "drain"),
    "response to a failure, its telemetry": lambda flight: (flight.loop.response, "receive"),
    "perception": lambda flight: (flight.agent.perception, "step"),
    "preflight": lambda flight: (flight.agent.preflight, "step"),
    "phases, observed": lambda flight: (flight.agent.phases, "observe"),
    "consensus": lambda flight: (flight.agent.consensus, "step"),
    "guidance": lambda flight: (flight.agent.guidance, "step"),
    "safety": lambda flight: (flight.agent.safeguard, "step"),
    "dispatcher": lambda flight: (flight.agent.dispatcher, "step"),
    "phases": lambda flight: (flight.agent.phases, "step"),
    "parameter requests": lambda flight: (flight.agent.preflight, "ask"),
    "setpoint": lambda flight: (flight.agent.setpoint, "step"),
    "distant peers": lambda flight: (flight.agent.distant_peers, "step"),
    "response to a failure, its setpoint": lambda flight: (flight.loop.response, "sent"),
    "setpoint encoded": lambda flight: (flight.translator, "attitude_target"),
    "request encoded": lambda flight: (flight.translator, "request"),
    "setpoint sent": lambda flight: (flight.link, "command"),
    "latency measured": lambda flight: (flight.loop.meter, "add_command"),
    "request sent": lambda flight: (flight.link, "request"),
    "late ticks logged": lambda flight: (flight.loop.late, "cycle"),
    "tick measured": lambda flight: (flight.loop.meter, "tick"),
    "report": lambda flight: (flight.agent.reporter, "step"),
    "replies composed": lambda flight: (flight.agent.arbitration, "replies"),
    "reply": lambda flight: (flight.peers, "reply"),
    "response to a failure, its packet": lambda flight: (flight.loop.response, "publishes"),
    "peer packet published": lambda flight: (flight.peers, "publish_peer"),
    "rates of the peers changed": lambda flight: (flight.peers, "set_low_rate_peers"),
    "phase measured": lambda flight: (flight.loop.meter, "phase_after_tick"),
    "timing reported": lambda flight: (flight.loop.meter, "timing"),
    "status published": lambda flight: (flight.peers, "publish_status"),
    "status line": lambda flight: (flight.loop.notifier, "status"),
    "rejections logged": lambda flight: (flight.loop.rejections, "update"),
    "event logged": lambda flight: (flight.loop.events, "log"),
    "watchdog fed": lambda flight: (flight.loop.notifier, "complete_cycle"),
}
SETPOINT_FAILS = ("setpoint encoded", "setpoint sent")
REQUEST_FAILS = ("request encoded", "request sent")
AT_A_COMMAND = (
    *REQUEST_FAILS,
    "arbitration",
    "dispatcher",
    "replies composed",
    "event logged",
)  # in a quiet tick these do nothing
LAST_PACKET_TICKS = 2  # the last packet of a report that fails is of the tick before


def set_modes(flight: FailingFlight) -> int:
    return sum(message.command == SET_MODE for message in flight.autopilot.commands)


def tilt(flight: FailingFlight) -> float:
    return float(max(abs(component) for component in flight.last_target.q[1:3]))


def called(owner: type, method: str) -> set[tuple[str, str]]:
    """(attribute, method) of each call of `self.attribute.method` in a method and in those of the class that it calls."""
    found = set()
    for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(getattr(owner, method))))):
        match node:
            case ast.Call(func=ast.Attribute(ast.Attribute(ast.Name("self"), attribute), name)):
                found.add((attribute, name))
            case ast.Call(func=ast.Attribute(ast.Name("self"), name)):
                found |= called(owner, name)
    return found


def test_each_call_of_a_tick_is_among_the_stages() -> None:
    """But for the parts of the agent, whose stages are, the recorder, whose defects end the recording alone, and the clock
    of a law from outside, which no built-in law has.
    """
    flight = FailingFlight(AutopilotKind.PX4)
    listed = [stage(flight) for stage in STAGES.values()]
    without_recorder, without_timer = (None, "tick"), (None, "read_s")
    parts = [(flight.agent, part) for part in ("prepare", "decide", "report")]
    calls = [(getattr(flight.loop, attribute), method) for attribute, method in called(ControlLoop, "tick")]
    calls += [
        (getattr(flight.agent, attribute), method) for _, part in parts for attribute, method in called(Agent, part)
    ]
    for apart in (without_recorder, without_timer, *parts):
        assert apart in calls
    missing = [call for call in calls if call not in [without_recorder, without_timer, *parts, *listed]]
    assert missing == []


@BOTH
@pytest.mark.parametrize("stage", STAGES)
def test_a_failing_stage_levels_the_vehicle_and_requests_hold(
    kind: AutopilotKind, stage: str, caplog: pytest.LogCaptureFixture
) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.north_m_s = 2.0
    flight.ticks(0.4)
    assert tilt(flight) > 0.03  # it leans against its velocity, by 4 degrees
    sent, requested = len(flight.autopilot.targets), set_modes(flight)
    flight.inject(*STAGES[stage](flight))
    if stage in AT_A_COMMAND:
        flight.tick(CommandName.HOLD)
        flight.ticks(BRAKES_WITHIN_S)
    flight.ticks(2.0)
    assert flight.failed_s is not None
    assert flight.ended_s is not None
    assert flight.ended_s - flight.failed_s <= HAND_OVER_WITHIN_S + 2 * PERIOD_S
    assert [r.levelname for r in caplog.records if "AGENT_FAILED: Fault" in r.getMessage()] == ["CRITICAL"]
    if stage in SETPOINT_FAILS:
        assert len(flight.autopilot.targets) == sent  # what sends them is what failed
    else:
        assert tilt(flight) < LEVEL
        assert flight.last_target.thrust == pytest.approx(0.5, rel=0.2)  # the hover thrust estimated so far
    if stage in REQUEST_FAILS:
        return  # the level setpoints are all that can be sent; the autopilot's failsafe follows
    assert set_modes(flight) == requested + 1
    assert flight.holds
    if stage != "status published":
        event = flight.peers.reports[-1].status.last_event
        assert event is not None
        assert event.code is Code.AGENT_FAILED


@BOTH
@pytest.mark.parametrize("stage", [stage for stage in STAGES if stage != "peer packet published"])
def test_the_peers_of_a_failing_agent_learn_that_it_brakes(kind: AutopilotKind, stage: str) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.north_m_s = 2.0
    flight.ticks(0.4)
    peers = PeerTable(4, {3: True, 4: False}, flight.peers.packets[-1].packet.sender.formation_hash, 0.3, LIMITS, ())
    # This autopilot has a velocity and stays where it is: a peer would be in doubt of it after 0.9 s.
    peers.fold(flight.peers.packets[-1:], 0)
    last = peers.known[3].packet
    assert last.phase is P.FORMATION
    assert last.motion.acceleration_enu_m_s2 != ZERO3
    published, sent = len(flight.peers.packets), len(flight.autopilot.targets)
    flight.inject(*STAGES[stage](flight))
    if stage in AT_A_COMMAND:
        flight.tick(CommandName.HOLD)
    while flight.failed_s is None:
        flight.tick()
    released = [one.packet for one in flight.peers.packets[published:] if one.packet.phase is P.RELEASE]
    packet = released[-1]
    assert packet.motion.acceleration_enu_m_s2 == ZERO3
    assert (packet.change, packet.rft) == (None, None)
    peers.fold(flight.peers.packets[published:], 0)
    assert peers.rejected == {}
    state = peers.known[3]
    assert state.packet == packet
    assert flight.failed_s - state.measured_s <= LAST_PACKET_TICKS * PERIOD_S + last.motion.state_age_s + 1e-6
    assert stage in SETPOINT_FAILS or flight.peers.published_before[-1] > sent  # the level setpoint goes first


@BOTH
def test_a_packet_that_cannot_be_published_costs_no_level_setpoint(kind: AutopilotKind) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.refuses[SET_MODE] = (mavlink.MAV_RESULT_FAILED,)
    flight.inject(flight.peers, "publish_peer")
    sent = len(flight.autopilot.targets)
    flight.ticks(0.3)
    assert (
        len(flight.autopilot.targets) - sent == round(0.3 / PERIOD_S) + 1
    )  # both that of the law and a level one at first
    assert tilt(flight) < LEVEL


@BOTH
@pytest.mark.parametrize("after_ticks", [1, 3, 8])
@pytest.mark.parametrize("name", [CommandName.HOLD, CommandName.LAND, CommandName.RETURN])
def test_a_failure_while_formation_is_left_levels_and_requests_hold(
    kind: AutopilotKind, name: CommandName, after_ticks: int
) -> None:
    """The stream goes on for CLEARED_S and until the autopilot has taken over, whatever the phase is called."""
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.north_m_s = 4.0
    flight.ticks(0.5)
    flight.tick(name)
    flight.ticks((after_ticks - 1) * PERIOD_S)
    assert (
        flight.agent.phase
        is {CommandName.HOLD: P.RELEASE, CommandName.LAND: P.LAND, CommandName.RETURN: P.RETURN}[name]
    )
    assert after_ticks > 1 or tilt(flight) > 0.03
    sent, requested = len(flight.autopilot.targets), set_modes(flight)
    flight.inject(flight.agent.guidance, "step")
    flight.ticks(1.0)
    assert len(flight.autopilot.targets) > sent
    assert tilt(flight) < LEVEL
    assert set_modes(flight) == requested + 1
    assert flight.holds
    assert flight.ended_s is not None
    assert flight.peers.packets[-1].packet.phase is P.RELEASE


@BOTH
@pytest.mark.parametrize("name", [CommandName.LAND, CommandName.RETURN])
def test_a_landing_or_return_that_has_begun_is_not_ended(kind: AutopilotKind, name: CommandName) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.tick(name)
    flight.ticks(CLEARED_S + 0.2)
    sent, commands = len(flight.autopilot.targets), len(flight.autopilot.commands)
    mode = flight.autopilot.custom_mode
    flight.inject(flight.agent.guidance, "step")
    flight.ticks(1.0)
    assert (len(flight.autopilot.targets), len(flight.autopilot.commands)) == (sent, commands)
    assert flight.autopilot.custom_mode == mode
    assert flight.ended_s == flight.failed_s


@BOTH
def test_a_pilot_who_ends_a_landing_in_its_first_moments_keeps_the_vehicle(kind: AutopilotKind) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.tick(CommandName.LAND)
    flight.autopilot.custom_mode = MANUAL[kind]
    sent, requested = len(flight.autopilot.targets), set_modes(flight)
    flight.inject(flight.agent.guidance, "step")
    flight.ticks(1.0)
    assert (len(flight.autopilot.targets), set_modes(flight)) == (sent, requested)
    assert flight.autopilot.custom_mode == MANUAL[kind]


def test_a_failure_while_hold_is_requested_without_a_stream_repeats_the_request() -> None:
    """A take-off that was ended: ArduCopter flies itself in GUIDED, and level setpoints would let it sink."""
    flight = FailingFlight(AutopilotKind.ARDUPILOT).fly_to(P.TAKEOFF)
    flight.autopilot.refuses[SET_MODE] = (mavlink.MAV_RESULT_FAILED,)
    flight.tick(CommandName.HOLD)
    assert flight.agent.phase is P.RELEASE
    sent, requested = len(flight.autopilot.targets), set_modes(flight)
    flight.inject(flight.agent.guidance, "step")
    flight.ticks(0.2)
    assert len(flight.autopilot.targets) == sent
    assert set_modes(flight) - requested == 2


@BOTH
def test_level_setpoints_and_requests_are_repeated_until_the_autopilot_holds(kind: AutopilotKind) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.refuses[SET_MODE] = (mavlink.MAV_RESULT_FAILED,)
    requested = set_modes(flight)
    flight.inject(flight.agent.consensus, "step")
    flight.ticks(0.3)
    assert set_modes(flight) - requested in (3, 4)
    assert flight.ended_s is None
    del flight.autopilot.refuses[SET_MODE]
    flight.ticks(0.2)
    assert flight.holds
    assert flight.ended_s is not None


@BOTH
def test_an_autopilot_that_refuses_hold_gets_silence_after_the_last_level_setpoint(kind: AutopilotKind) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.refuses[SET_MODE] = (mavlink.MAV_RESULT_FAILED,)
    flight.inject(flight.agent.consensus, "step")
    flight.ticks(1.0)
    assert flight.failed_s is not None
    assert flight.ended_s is not None
    assert flight.ended_s - flight.failed_s == pytest.approx(HAND_OVER_WITHIN_S, abs=2 * PERIOD_S)
    assert tilt(flight) < LEVEL


@BOTH
@pytest.mark.parametrize("seen", ["before the fault", "in the tick of the fault", "after the fault"])
def test_a_pilot_who_has_taken_over_keeps_the_vehicle(kind: AutopilotKind, seen: str) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.refuses[SET_MODE] = (mavlink.MAV_RESULT_FAILED,)  # the agent's hold is not what ends the mode
    pilots_mode = MANUAL[kind]
    if seen == "before the fault":
        flight.autopilot.custom_mode = pilots_mode
        flight.tick()
    flight.inject(flight.agent.guidance, "step")
    if seen == "in the tick of the fault":
        flight.autopilot.custom_mode = pilots_mode
    if seen == "after the fault":
        flight.tick()
        flight.autopilot.custom_mode = pilots_mode
    sent, requested = len(flight.autopilot.targets), set_modes(flight)
    flight.ticks(1.0)
    assert (len(flight.autopilot.targets), set_modes(flight)) == (sent, requested)
    assert flight.autopilot.custom_mode == pilots_mode
    assert flight.ended_s is not None


@BOTH
@pytest.mark.parametrize("phase", [P.OBSERVE, P.PREPARE, P.READY, P.ARM, P.ARMED, P.TAKEOFF, P.HOLD])
def test_a_failure_outside_formation_sends_nothing(kind: AutopilotKind, phase: FlightPhase) -> None:
    """The autopilot flies itself or stands on the ground; ArduCopter is in GUIDED all the while."""
    flight = FailingFlight(kind).fly_to(phase)
    sent, requested = len(flight.autopilot.targets), set_modes(flight)
    flight.inject(flight.agent.guidance, "step")
    flight.ticks(1.0)
    assert flight.ended_s == flight.failed_s
    assert (len(flight.autopilot.targets), set_modes(flight)) == (sent, requested)


@BOTH
def test_a_failure_while_the_autopilot_takes_the_stream_requests_hold(kind: AutopilotKind) -> None:
    flight = FailingFlight(kind).fly_to(P.HOLD)
    flight.autopilot.custom_mode = HOLD[kind]
    flight.tick()
    flight.autopilot.refuses[SET_MODE] = (mavlink.MAV_RESULT_FAILED,)  # OFFBOARD or GUIDED is still under way
    flight.ticks(0.1)
    flight.form()
    assert flight.agent.phase is P.ENGAGE
    flight.inject(flight.agent.guidance, "step")
    flight.tick()
    request = flight.autopilot.commands[-1]
    wanted = HOLD[kind]
    main, sub = int(request.param2), int(request.param3)
    assert (main << 16 | sub << 24 if kind is AutopilotKind.PX4 else main) == wanted


@BOTH
def test_blind_after_the_failure_nothing_is_repeated(kind: AutopilotKind) -> None:
    """Without telemetry a pilot's change of mode would remain unseen."""
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.refuses[SET_MODE] = (mavlink.MAV_RESULT_FAILED,)
    flight.inject(flight.agent.guidance, "step")
    flight.tick()
    flight.inject(flight.link, "drain")  # the decoder fails as well
    sent = len(flight.autopilot.targets)
    flight.ticks(1.0)
    assert len(flight.autopilot.targets) - sent <= 6
    assert flight.ended_s is not None
