"""A real `companion agent` process: MAVLink over real UDP on one side, real Zenoh on the other."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from common import until
from companion.ground.session import FleetSession
from companion.link.fleet.zenoh_session import open_session
from companion.mavlink.codec import mavlink
from companion.mavlink.translator import Translator
from companion.types.commands import CommandName, CommandReply
from companion.types.errors import EXIT_DEFECT
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from companion.wire.keys import command_key, peer_key
from companion.wire.messages import WIRE_VERSION, StatusReport
from processes import AgentFiles, Running, agent, agent_files, companion, faulty_agent
from wire_autopilots import LOITER, OFFBOARD, HoveringAutopilot


@pytest.fixture
def files(tmp_path: Path) -> AgentFiles:
    return agent_files(tmp_path)


@contextmanager
def ground(files: AgentFiles) -> Iterator[FleetSession]:
    with FleetSession("processtest", (files.zenoh,)) as session:
        yield session


def newest(session: FleetSession) -> StatusReport:
    reports: list[StatusReport] = []
    until(lambda: reports.extend(session.drain()) or reports)
    return reports[-1]


def command(session: FleetSession, name: CommandName) -> CommandReply:
    reply = session.command([1], name, timeout_s=10.0)[1]
    assert reply is not None
    return reply


def wait_for_phase(session: FleetSession, phase: FlightPhase) -> StatusReport:
    reports: list[StatusReport] = []
    until(lambda: reports.extend(session.drain()) or (reports and reports[-1].status.phase is phase))
    return reports[-1]


def into_formation(session: FleetSession, process: Running) -> None:
    process.wait_for_log("heartbeat of autopilot 1")
    until(lambda: command(session, CommandName.HOLD).accepted)
    wait_for_phase(session, FlightPhase.HOLD)
    assert command(session, CommandName.FORM).accepted
    wait_for_phase(session, FlightPhase.FORMATION)


# ---------------------------------------------------------------- in flight


def test_the_agent_observes_until_commanded_and_ends_at_once(files: AgentFiles) -> None:
    with HoveringAutopilot(1, files.udp_port) as autopilot, agent(files) as process, ground(files) as session:
        process.wait_for_log("heartbeat of autopilot 1")
        assert newest(session).status.phase is FlightPhase.OBSERVE
        assert process.stop() == 0
        assert autopilot.target_times_s == []
        assert [m.to_dict() for m in autopilot.commands(mavlink.MAV_CMD_DO_SET_MODE)] == []
    assert "SIGTERM in phase observe: stopping" in process.log
    assert "Traceback" not in process.log


def test_the_agent_requests_telemetry_and_sends_a_heartbeat(files: AgentFiles) -> None:
    with HoveringAutopilot(1, files.udp_port) as autopilot, agent(files):
        until(lambda: [m for m in autopilot.received if m.get_type() == "HEARTBEAT"])
        asked = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        until(lambda: autopilot.commands(asked))
        until(lambda: mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED in [m.param1 for m in autopilot.commands(asked)])
        beat = next(m for m in autopilot.received if m.get_type() == "HEARTBEAT")
        assert (beat.get_srcSystem(), beat.type) == (1, mavlink.MAV_TYPE_ONBOARD_CONTROLLER)
        assert autopilot.commands(asked)[0].target_system == 1


def test_the_agent_requests_telemetry_again_while_positions_are_missing(files: AgentFiles) -> None:
    with HoveringAutopilot(1, files.udp_port, positions=False) as autopilot, agent(files) as process:
        first = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED
        requests = lambda: [m for m in autopilot.commands(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL) if m.param1 == first]  # noqa: E731
        until(lambda: len(requests()) >= 2)
        process.wait_for_log("too few positions: requesting again")
        autopilot.positions = True
        process.wait_for_log("all telemetry arrives", timeout_s=30.0)


def test_in_formation_every_position_is_answered_and_none_without_positions(files: AgentFiles) -> None:
    with HoveringAutopilot(1, files.udp_port) as autopilot, agent(files) as process, ground(files) as session:
        into_formation(session, process)
        before = len(autopilot.target_times_s)
        until(lambda: len(autopilot.target_times_s) > before + 100)
        timing = wait_for_phase(session, FlightPhase.FORMATION).timing
        assert timing.rss_mb < 60.0
        assert timing.telemetry_to_command_us.p50 > 0.0

        autopilot.positions = False
        time.sleep(0.2)  # what is on its way arrives
        sent = len(autopilot.target_times_s)
        time.sleep(0.6)
        assert len(autopilot.target_times_s) == sent  # no setpoint is repeated
        assert newest(session).status.motion.state_age_s > 0.3  # the agent still ticks and reports


def test_a_mode_set_by_a_pilot_ends_the_stream(files: AgentFiles) -> None:
    with HoveringAutopilot(1, files.udp_port) as autopilot, agent(files) as process, ground(files) as session:
        into_formation(session, process)
        autopilot.mode = (3, 0)  # POSCTL
        wait_for_phase(session, FlightPhase.OBSERVE)
        sent = len(autopilot.target_times_s)
        time.sleep(0.3)
        assert len(autopilot.target_times_s) == sent
        assert autopilot.mode == (3, 0)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_in_formation_hands_over_to_hold_of_the_autopilot(files: AgentFiles, number: int) -> None:
    with HoveringAutopilot(1, files.udp_port) as autopilot, agent(files) as process, ground(files) as session:
        into_formation(session, process)
        assert autopilot.mode == OFFBOARD
        assert process.stop(number) == 0
        assert autopilot.mode == LOITER
    assert "formation -> release" in process.log
    assert "ends in phase hold" in process.log


def test_the_agent_ends_also_when_the_autopilot_refuses_hold(files: AgentFiles) -> None:
    with HoveringAutopilot(1, files.udp_port) as autopilot, agent(files) as process, ground(files) as session:
        into_formation(session, process)
        autopilot.accepts_modes = False
        assert process.stop() == 0
        assert autopilot.mode == OFFBOARD
        assert autopilot.commands(mavlink.MAV_CMD_DO_SET_MODE)[-1].param2 == LOITER[0]  # requested


def test_rejected_packets_are_counted_reported_and_logged_once_a_second(files: AgentFiles) -> None:
    with (
        HoveringAutopilot(1, files.udp_port),
        agent(files) as process,
        ground(files) as session,
        closing(open_session((), (files.zenoh,))) as rogue,
    ):
        newest(session)
        key = f"{Code.WIRE_VERSION_DIFFERS} {WIRE_VERSION + 1}"
        start_s = time.monotonic()

        def disturbed() -> bool:
            rogue.put(peer_key("processtest", 2), bytes((WIRE_VERSION + 1,)) + b"whatever")
            return newest(session).status.rejected.get(key, 0) >= 30

        until(disturbed, timeout_s=60.0)
        reply = session.command([1], CommandName.HOLD, 10.0)[1]
        assert reply is not None  # the agent still works
        rogue.put(command_key("processtest", 1, "rogue"), b"nonsense")
        until(lambda: f"{Code.WIRE_VERSION_DIFFERS} 110" in newest(session).status.rejected)
        seconds = time.monotonic() - start_s
    lines = [line for line in process.log.splitlines() if key in line]
    assert 1 <= len(lines) <= seconds + 2
    assert "rejected" in lines[0]


def test_a_defect_in_decoding_ends_the_process(files: AgentFiles, tmp_path: Path) -> None:
    (tmp_path / "switch").touch()
    with (
        HoveringAutopilot(1, files.udp_port),
        faulty_agent(files, Translator.telemetry, tmp_path / "switch") as process,
    ):
        assert process.process.wait(20.0) == EXIT_DEFECT
    assert "ZeroDivisionError: injected" in process.log
    assert process.log.count("Traceback") == 1  # not one per datagram


# ---------------------------------------------------------------- errors


def one_line(result: subprocess.CompletedProcess[str]) -> str:
    """The last line of standard error, which has no traceback."""
    assert "Traceback" not in result.stderr
    assert result.stdout == ""
    return result.stderr.strip().splitlines()[-1]


def test_without_an_autopilot_the_agent_ends_with_3(files: AgentFiles) -> None:
    result = companion("agent", "--config", str(files.file), "--wait-s", "0.5")
    line = one_line(result)
    assert result.returncode == 3
    assert f'{files.file}: mavlink: "udpin:127.0.0.1:{files.udp_port}": no HEARTBEAT of system 1 in 0.5 s' in line
    assert "nothing arrived" in line


def test_the_autopilot_of_another_vehicle_is_named(files: AgentFiles) -> None:
    with HoveringAutopilot(7, files.udp_port):
        result = companion("agent", "--config", str(files.file), "--wait-s", "1.5")
    assert result.returncode == 3
    assert "received system 7 instead; correct the id here or in the autopilot (MAV_SYS_ID)" in one_line(result)


def test_an_autopilot_of_another_kind_is_named(files: AgentFiles) -> None:
    with HoveringAutopilot(1, files.udp_port, autopilot=mavlink.MAV_AUTOPILOT_INVALID):
        result = companion("agent", "--config", str(files.file), "--wait-s", "1.5")
    assert result.returncode == 3
    assert "MAV_AUTOPILOT 8, expected 12 (PX4)" in one_line(result)


def test_a_tcp_port_without_an_autopilot_is_named(tmp_path: Path) -> None:
    files = agent_files(tmp_path, mavlink="tcp:127.0.0.1:24999")
    result = companion("agent", "--config", str(files.file), "--wait-s", "0.5")
    assert result.returncode == 3
    assert "no program listens at tcp:127.0.0.1:24999; is the autopilot running?" in one_line(result)


def test_a_udp_port_in_use_ends_the_agent_with_2(files: AgentFiles) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", files.udp_port))
        result = companion("agent", "--config", str(files.file))
    assert result.returncode == 2
    assert (
        f'{files.file}: mavlink: "udpin:127.0.0.1:{files.udp_port}": UDP port {files.udp_port} is in use'
        in one_line(result)
    )


def test_a_zenoh_port_in_use_ends_the_agent_with_2(files: AgentFiles) -> None:
    with closing(open_session((files.zenoh,), ())):
        result = companion("agent", "--config", str(files.file))
    assert result.returncode == 2
    assert f'{files.file}: zenoh.listen: "{files.zenoh}": the port is in use' in one_line(result)


@pytest.mark.parametrize(
    ("mavlink_value", "words"),
    [
        ("serial:/dev/ttyNotThere:57600", "there is no serial device /dev/ttyNotThere"),
        ("udpin:192.0.2.7:14540", "this machine has no such address"),
        ("udpin:14540", "mavlink"),
        ("carrier-pigeon:1:2", "mavlink"),
    ],
)
def test_an_endpoint_that_cannot_be_opened_ends_the_agent_with_2(
    tmp_path: Path, mavlink_value: str, words: str
) -> None:
    files = agent_files(tmp_path, mavlink=mavlink_value)
    result = companion("agent", "--config", str(files.file))
    assert result.returncode == 2
    assert words in one_line(result)
    assert f"{files.file}: mavlink:" in one_line(result)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["agent", "--config", "/no/such/vehicle.yaml"], "/no/such/vehicle.yaml: cannot be read"),
        (["agent"], "--config"),
        (["agent", "--config", "x.yaml", "--wait-s", "soon"], "'soon', expected seconds"),
        (["agent", "--config", "x.yaml", "--wait-s", "nan"], "'nan', expected seconds"),
        (["fly"], "agent"),
        ([], "COMMAND"),
        (["monitor", "--connect", "nonsense", "--once"], '"nonsense": expected PROTOCOL/HOST:PORT'),
        (["monitor", "--fleet", "a/b", "--once"], "expected the name in a fleet file"),
    ],
)
def test_bad_arguments_end_the_agent_with_2(arguments: list[str], words: str) -> None:
    result = companion(*arguments)
    assert result.returncode == 2
    assert words in one_line(result)


@pytest.mark.parametrize("command_name", [[], ["agent"], ["monitor"]])
def test_help_has_examples_and_exit_codes(command_name: list[str]) -> None:
    result = companion(*command_name, "--help")
    assert result.returncode == 0
    assert "exit codes" in result.stdout
    if command_name:
        assert "examples:" in result.stdout


def test_the_agent_imports_no_ground_tools() -> None:
    program = (
        "import sys, companion.app\n"
        "heavy = {'numpy', 'matplotlib', 'rich', 'mavsdk', 'lxml', 'pymavlink', 'sitl'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=30)


def test_a_vehicle_with_a_wrong_hover_thrust_is_refused_formation(files: AgentFiles) -> None:
    with HoveringAutopilot(1, files.udp_port) as autopilot, agent(files) as process, ground(files) as session:
        autopilot.parameters["COM_OBL_RC_ACT"] = 7.0
        process.wait_for_log("refusal: COM_OBL_RC_ACT: 7 (disarm: it falls)")
        until(lambda: command(session, CommandName.HOLD).accepted)
        wait_for_phase(session, FlightPhase.HOLD)
        reply = command(session, CommandName.FORM)
        assert (reply.accepted, reply.code) == (False, Code.AUDIT_REFUSAL)
        assert "set COM_OBL_RC_ACT to 5" in reply.reason
        assert autopilot.target_times_s == []
        autopilot.parameters["COM_OBL_RC_ACT"] = 5.0
        until(lambda: command(session, CommandName.FORM).accepted)
        wait_for_phase(session, FlightPhase.FORMATION)
