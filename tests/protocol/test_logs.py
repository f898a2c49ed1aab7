"""`companion logs` as a real process: real sockets, the log plugin of mavsdk, logs compared byte by byte."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from subprocess import CompletedProcess

import pytest
from pymavlink.DFReader import DFReader_binary

from common import until
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.types.autopilot import AutopilotKind
from processes import AgentFiles, StandInProcess, agent_files, companion, stand_in
from sitl.autopilots.ardupilot.modes import CopterMode
from sitl.autopilots.autopilot import DT_S
from sitl.autopilots.link_end import FORCE
from sitl.autopilots.logs import FlightLog
from sitl.autopilots.px4.logs import MAGIC
from sitl.autopilots.types import AUTOPILOT_TYPES
from sitl.vehicle.config import AutopilotFile, StandIn
from wire_autopilots import Background

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
FIRST_ID = {PX4: 0, ARDUPILOT: 1}
SUFFIX = {PX4: "ulg", ARDUPILOT: "bin"}
LOGS = tuple(Random(7).randbytes(size) for size in (46_080, 1, 50_003, 0))  # one whole chunk of mavsdk, and others

both = pytest.mark.parametrize("kind", [PX4, ARDUPILOT])


WRITTEN_UTC_S = 1_790_000_000  # 2026-09-21 14:13:20 UTC


@dataclass
class LoggingAutopilot(Background):
    """Vehicle 1, sending to `port` of this machine. `loss` is the share of packets lost in each direction."""

    kind: AutopilotKind
    port: int
    logs: Sequence[bytes]
    loss: float = 0.0
    utc_at_start_s: float = WRITTEN_UTC_S
    lost_entries: int = 0  # this many LOG_ENTRYs are lost first
    armed: bool = False
    arms_after_packets: float = float("inf")  # of LOG_DATA
    silent_after_packets: float = float("inf")
    received: list[MavlinkMessage] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()
        file = AutopilotFile(id=1, stand_in=StandIn(autopilot=self.kind, sensors="ideal", armable_after_s=0.0))
        self._autopilot = AUTOPILOT_TYPES[self.kind].vehicle(file, DT_S)
        self._autopilot.flight_logs.utc_at_start_s = self.utc_at_start_s
        self._autopilot.flight_logs.files = [FlightLog(bytearray(log), 60.0 * i) for i, log in enumerate(self.logs)]
        self._end = AUTOPILOT_TYPES[self.kind].onboard_link(self._autopilot)
        self._client = MavlinkCodec(255, 190)  # decodes received packets
        self._lottery = Random(4)
        self._data_packets = 0
        self._socket = self.udp_socket()
        self._socket.setblocking(False)

    def requests(self, kind: str) -> list[MavlinkMessage]:
        """The received messages of this type."""
        return [message for message in self.received if message.get_type() == kind]

    def run(self) -> None:
        next_s = time.monotonic()
        while not self.ended.wait(max(0.0, next_s - time.monotonic())):
            next_s = max(next_s + DT_S, time.monotonic() - 10 * DT_S)
            self._listen()
            self._autopilot.step()
            self._autopilot.flight_logs.write(self._autopilot)
            self._autopilot.armed = self.armed or self._data_packets > self.arms_after_packets
            for packet in self._end.due():
                self._send(packet)
            self._autopilot.texts.clear()

    def _listen(self) -> None:
        while True:
            try:
                data = self._socket.recv(4096)
            except BlockingIOError:
                return
            except ConnectionError:
                continue  # no receiver yet
            if self._lottery.random() < self.loss:
                continue
            self.received += self._client.decode(data)
            for answer in self._end.receive(data):
                self._send(answer)

    def _send(self, packet: bytes) -> None:
        self._data_packets += packet[7] == mavlink.MAVLINK_MSG_ID_LOG_DATA
        if packet[7] == mavlink.MAVLINK_MSG_ID_LOG_ENTRY and self.lost_entries:
            self.lost_entries -= 1
            return
        if self._data_packets > self.silent_after_packets or self._lottery.random() < self.loss:
            return
        try:
            self._socket.sendto(packet, ("127.0.0.1", self.port))
        except (BlockingIOError, ConnectionError):
            return  # lost


def logs(files: AgentFiles, *options: str, timeout_s: float = 100.0) -> CompletedProcess[str]:
    return companion("logs", "--config", str(files.file), *options, timeout_s=timeout_s)


def folder_of(files: AgentFiles) -> Path:
    return files.file.parent / "logs"


@dataclass(frozen=True)
class Waiting:
    """Commands that wait twenty seconds for an answer. They do so beside the other tests of this file."""

    silent_link: Future[CompletedProcess[str]]
    silent_files: AgentFiles
    no_logs: Future[CompletedProcess[str]]


@pytest.fixture(scope="module", autouse=True)
def waiting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Waiting]:
    silent, empty = (agent_files(tmp_path_factory.mktemp(name)) for name in ("silent_link", "no_logs"))

    def from_a_link_that_goes_silent() -> CompletedProcess[str]:
        with LoggingAutopilot(PX4, silent.udp_port, [bytes(1_000_000)], silent_after_packets=1000):
            return logs(silent, "--get", "last", "--out", str(folder_of(silent)))

    def from_a_px4_without_logs() -> CompletedProcess[str]:
        with LoggingAutopilot(PX4, empty.udp_port, []):
            return logs(empty)

    with ThreadPoolExecutor() as pool:
        yield Waiting(pool.submit(from_a_link_that_goes_silent), silent, pool.submit(from_a_px4_without_logs))


@both
def test_logs_are_listed_and_downloaded_byte_by_byte(kind: AutopilotKind, tmp_path: Path) -> None:
    files, first = agent_files(tmp_path), FIRST_ID[kind]
    with LoggingAutopilot(kind, files.udp_port, LOGS) as autopilot:
        listed = json.loads(logs(files, "--json").stdout)
        assert listed["autopilot"] == kind
        assert [log["id"] for log in listed["logs"]] == [first, first + 1, first + 2, first + 3]
        assert [log["size_bytes"] for log in listed["logs"]] == [len(log) for log in LOGS]
        assert [log["date_utc"] for log in listed["logs"]][:2] == ["2026-09-21T14:13:20Z", "2026-09-21T14:14:20Z"]

        got = logs(files, "--get", "all", "--out", str(folder_of(files)), "--json")
    assert got.returncode == 0, got.stderr
    printed = json.loads(got.stdout)
    assert [Path(log["file"]).read_bytes() for log in printed["logs"]] == list(LOGS)
    assert Path(printed["logs"][0]["file"]).name == f"vehicle-1_2026-09-21_14-13-20_log-{first}.{SUFFIX[kind]}"
    assert len(list(folder_of(files).iterdir())) == len(LOGS)
    assert "log" in got.stderr  # progress goes to stderr
    assert autopilot.requests("LOG_ERASE") == []
    beats = autopilot.requests("HEARTBEAT")
    assert mavlink.MAV_TYPE_GCS not in {beat.type for beat in beats}  # the command is no ground station


@both
def test_packets_lost_by_the_link_are_requested_again(kind: AutopilotKind, tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    with LoggingAutopilot(kind, files.udp_port, LOGS, loss=0.1) as autopilot:
        result = logs(files, "--get", str(FIRST_ID[kind] + 2), "--out", str(folder_of(files)))
    assert result.returncode == 0, result.stderr
    (file,) = folder_of(files).iterdir()
    assert file.read_bytes() == LOGS[2]
    assert len(autopilot.requests("LOG_REQUEST_DATA")) > 3  # one for each chunk without losses


@both
def test_a_list_without_its_first_entry_is_requested_again(kind: AutopilotKind, tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    with LoggingAutopilot(kind, files.udp_port, LOGS, lost_entries=1) as autopilot:
        result = logs(files, "--json")
    assert result.returncode == 0, result.stderr
    assert [log["size_bytes"] for log in json.loads(result.stdout)["logs"]] == [len(log) for log in LOGS]
    assert len(autopilot.requests("LOG_REQUEST_LIST")) > 1


def test_the_list_of_an_autopilot_without_the_time(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    with LoggingAutopilot(PX4, files.udp_port, LOGS[:2], utc_at_start_s=0.0):
        result = logs(files)
        logs(files, "--get", "last", "--out", str(folder_of(files)))
    assert result.returncode == 0
    assert result.stdout.splitlines()[2:] == [
        "    0  unknown                 46.1 kB",
        "    1  unknown                     1 B",
    ]
    assert [file.name for file in folder_of(files).iterdir()] == ["vehicle-1_log-1.ulg"]


def test_an_armed_vehicle_is_refused(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    with LoggingAutopilot(PX4, files.udp_port, LOGS, armed=True) as autopilot:
        result = logs(files, "--get", "all", "--out", str(folder_of(files)))
    assert result.returncode == 1
    assert result.stderr == "vehicle 1: it is armed: land and disarm it first\n"
    assert autopilot.requests("LOG_REQUEST_LIST") + autopilot.requests("LOG_REQUEST_DATA") == []
    assert list(folder_of(files).iterdir()) == []


@both
def test_arming_ends_a_download(kind: AutopilotKind, tmp_path: Path) -> None:
    files, log = agent_files(tmp_path), bytes(5_000_000)  # takes seconds, so a HEARTBEAT reports the arming in time
    with LoggingAutopilot(kind, files.udp_port, [log], arms_after_packets=1000):
        result = logs(files, "--get", "last", "--out", str(folder_of(files)))
    assert result.returncode == 1
    assert result.stderr.endswith(f"vehicle 1: log {FIRST_ID[kind]}: it is armed: land and disarm it first\n")
    assert list(folder_of(files).iterdir()) == []


def test_ctrl_c_ends_the_transfer_and_leaves_no_file(tmp_path: Path) -> None:
    files, log_file = agent_files(tmp_path), tmp_path / "logs.log"
    with LoggingAutopilot(PX4, files.udp_port, [bytes(50_000_000)]) as autopilot, log_file.open("wb") as log:
        command = ["logs", "--config", str(files.file), "--get", "last", "--out", str(folder_of(files))]
        process = subprocess.Popen([sys.executable, "-m", "companion", *command], stdout=log, stderr=log)
        try:
            until(lambda: len(autopilot.requests("LOG_REQUEST_DATA")) > 3)
            (half,) = folder_of(files).iterdir()
            assert half.name.endswith(".ulg.part")
            asked_to_end = len(autopilot.requests("LOG_REQUEST_END"))  # mavsdk starts with one
            process.send_signal(signal.SIGINT)
            assert process.wait(10.0) == 130
        finally:
            process.kill()
            process.wait()
        until(lambda: len(autopilot.requests("LOG_REQUEST_END")) > asked_to_end)
    assert "interrupted" in log_file.read_text(encoding="utf-8")
    assert list(folder_of(files).iterdir()) == []


def test_existing_files_are_never_overwritten(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    folder = folder_of(files)
    with LoggingAutopilot(PX4, files.udp_port, LOGS[:2]) as autopilot:
        assert logs(files, "--get", "0", "--out", str(folder)).returncode == 0
        (file,) = folder.iterdir()
        asked = len(autopilot.requests("LOG_REQUEST_DATA"))
        (folder / f"{file.name}.part").write_bytes(b"of a process that was killed")

        again = logs(files, "--get", "0", "--out", str(folder))
        assert again.returncode == 0
        assert f"log 0: {file} exists already" in again.stdout
        assert len(autopilot.requests("LOG_REQUEST_DATA")) == asked

        file.write_bytes(b"another one")
        refused = logs(files, "--get", "all", "--out", str(folder))
    assert refused.returncode == 1
    assert f"log 0: {file} exists already, with 11 bytes instead of 46080" in refused.stderr
    assert file.read_bytes() == b"another one"


def test_missing_logs_are_named(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    with LoggingAutopilot(ARDUPILOT, files.udp_port, LOGS):
        unknown = logs(files, "--get", "2", "9", "--out", str(folder_of(files)))
    assert unknown.returncode == 1
    assert unknown.stderr == "vehicle 1: no log 9; there are 1 to 4\n"
    assert list(folder_of(files).iterdir()) == []
    with LoggingAutopilot(ARDUPILOT, files.udp_port, []):
        none = logs(files)
    assert none.returncode == 1
    assert none.stderr == "vehicle 1: it has no logs\n"


def test_a_link_that_goes_silent_leaves_no_partial_log(waiting: Waiting) -> None:
    result = waiting.silent_link.result()
    assert result.returncode == 1
    assert "vehicle 1: log 0: no data for 20 s; no HEARTBEAT for 5 s\n" in result.stderr
    assert list(folder_of(waiting.silent_files).iterdir()) == []


def test_a_px4_without_logs_does_not_answer(waiting: Waiting) -> None:
    none = waiting.no_logs.result()
    assert none.returncode == 1
    assert none.stderr == "vehicle 1: no answer to the request for its list; PX4 does not answer where it has no logs\n"


def test_a_bad_folder_and_a_missing_autopilot_are_named(tmp_path: Path) -> None:
    files = agent_files(tmp_path)
    in_the_way = tmp_path / "file"
    in_the_way.touch()
    result = logs(files, "--get", "last", "--out", str(in_the_way))
    assert result.returncode == 2
    assert result.stderr == f"--out {in_the_way}: File exists; name a folder that can be written to\n"
    silent = logs(files, "--wait-s", "1")
    assert silent.returncode == 3
    assert "no HEARTBEAT of system 1 in 1 s; nothing arrived" in silent.stderr
    assert logs(files, "--get", "newest").returncode == 2


class Pilot:
    """Arms and flies a stand-in process, and reads its log independently of mavsdk."""

    def __init__(self, process: StandInProcess, udp: socket.socket) -> None:
        self._udp, self._codec = udp, MavlinkCodec(1, 191)
        udp.bind(("127.0.0.1", process.ports.companion))
        self._autopilot = ("127.0.0.1", process.ports.onboard)

    def ask(self, message: MavlinkMessage, kind: str) -> MavlinkMessage:
        """Send a message; the first answer of this type."""
        self._udp.setblocking(False)
        with suppress(BlockingIOError):
            while self._codec.decode(self._udp.recv(4096)):
                pass  # a full receive buffer would drop the answer
        self._udp.settimeout(2.0)
        self._udp.sendto(self._codec.encode(message), self._autopilot)
        end_s = time.monotonic() + 10.0
        while time.monotonic() < end_s:
            for answer in self._codec.decode(self._udp.recv(4096)):
                if answer.get_type() == kind:
                    return answer
        raise AssertionError(f"no {kind}")

    def command(self, number: int, *parameters: float) -> None:
        padded = [*parameters, *[0.0] * (7 - len(parameters))]
        ack = self.ask(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded), "COMMAND_ACK")
        assert ack.result == mavlink.MAV_RESULT_ACCEPTED

    def log(self, number: int) -> bytes:
        entry = self.ask(mavlink.MAVLink_log_request_list_message(1, 1, number, number), "LOG_ENTRY")
        content = b""
        while len(content) < entry.size:
            data = self.ask(mavlink.MAVLink_log_request_data_message(1, 1, number, len(content), 90), "LOG_DATA")
            assert data.ofs == len(content)
            content += bytes(data.data[: data.count])
        return content


@both
def test_the_log_of_a_flight(kind: AutopilotKind, tmp_path: Path) -> None:
    configuration = f"id: 1\nstand_in: {{sensors: ideal, armable_after_s: 0, autopilot: {kind}}}\n"
    with stand_in(tmp_path, configuration) as process:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            pilot = Pilot(process, udp)
            until(lambda: len(process.truth()) > 50)  # started: it keeps a mode from now on
            if kind is ARDUPILOT:
                pilot.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, CopterMode.GUIDED)
            pilot.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
            until(lambda: process.newest.armed)
            pilot.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0 if kind is ARDUPILOT else 490.0)
            until(lambda: process.newest.z_m > 1.0, 30.0)
            pilot.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, FORCE)
            process.wait_until_disarmed()
        files = agent_files(tmp_path, f"udpin:127.0.0.1:{process.ports.companion}")
        result = logs(files, "--get", "last", "--out", str(folder_of(files)))
        listed = json.loads(logs(files, "--json").stdout)["logs"]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            expected = Pilot(process, udp).log(FIRST_ID[kind])
    assert result.returncode == 0, result.stderr
    (file,) = folder_of(files).iterdir()
    assert file.read_bytes() == expected
    assert len(listed) == 1  # an ArduPilot read too early would have started another
    assert file.name.startswith("vehicle-1_20")
    if kind is PX4:
        assert expected.startswith(MAGIC)
        assert expected.count(b"vehicle_local_position:uint64_t timestamp;float x;") == 1
    else:
        heights_m = []
        reader = DFReader_binary(str(file))
        while row := reader.recv_match(type="POS"):
            heights_m.append(row.RelHomeAlt)
        assert max(heights_m) == pytest.approx(max(row.z_m for row in process.truth()), abs=0.2)
        assert heights_m[0] == pytest.approx(0.0, abs=0.1)
