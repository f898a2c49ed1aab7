"""MAVLink log protocol of the stand-ins against measurements on PX4 1.16 and ArduCopter 4.7, and the logs they write."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import pytest
from pymavlink.DFReader import DFReader_binary

from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.types.autopilot import AutopilotKind
from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.modes import CopterMode
from sitl.autopilots.autopilot import DT_S, Autopilot
from sitl.autopilots.link_end import LinkEnd
from sitl.autopilots.logs import FlightLog
from sitl.autopilots.px4.autopilot import Px4
from sitl.autopilots.px4.logs import MAGIC
from sitl.autopilots.types import AUTOPILOT_TYPES
from sitl.vehicle.config import AutopilotFile, StandIn

M = mavlink
ALL = 0xFFFF
LOGS = (bytes(range(200)), b"", bytes(100))


class Client:
    """A log client on one link of an autopilot, by bytes."""

    def __init__(self, end: LinkEnd) -> None:
        self._end = end
        self._codec = MavlinkCodec(255, 190)

    def ask(self, request: MavlinkMessage) -> list[MavlinkMessage]:
        """Answers to the request, and the log messages of the next step."""
        data = b"".join(self._end.receive(self._codec.encode(request)))
        return self._logs_in(data) + self.listen()

    def listen(self) -> list[MavlinkMessage]:
        """Log messages of one step."""
        return self._logs_in(b"".join(self._end.due()))

    def _logs_in(self, data: bytes) -> list[MavlinkMessage]:
        kinds = ("LOG_ENTRY", "LOG_DATA", "STATUSTEXT")
        return [message for message in self._codec.decode(data) if message.get_type() in kinds]

    def list(self, start: int = 0, end: int = ALL, target: int = 1) -> list[MavlinkMessage]:
        return self.ask(M.MAVLink_log_request_list_message(target, 1, start, end))

    def data(self, number: int, offset: int, count: int) -> list[MavlinkMessage]:
        return self.ask(M.MAVLink_log_request_data_message(1, 1, number, offset, count))

    def end(self) -> list[MavlinkMessage]:
        return self.ask(M.MAVLink_log_request_end_message(1, 1))

    def erase(self) -> list[MavlinkMessage]:
        return self.ask(M.MAVLink_log_erase_message(1, 1))


def px4(logs: Sequence[bytes] = LOGS) -> tuple[Px4, Client, Client]:
    autopilot, *clients = autopilot_with(AutopilotKind.PX4, logs)
    assert isinstance(autopilot, Px4)
    return autopilot, *clients


def copter(logs: Sequence[bytes] = LOGS) -> tuple[ArduCopter, Client, Client]:
    autopilot, *clients = autopilot_with(AutopilotKind.ARDUPILOT, logs)
    assert isinstance(autopilot, ArduCopter)
    return autopilot, *clients


def autopilot_with(kind: AutopilotKind, logs: Sequence[bytes]) -> tuple[Autopilot, Client, Client]:
    """An autopilot with these logs, and clients on two of its links."""
    file = AutopilotFile(stand_in=StandIn(autopilot=kind, sensors="ideal", armable_after_s=0.0))
    autopilot = AUTOPILOT_TYPES[kind].vehicle(file, DT_S)
    autopilot.flight_logs.utc_at_start_s = 1000.0
    autopilot.flight_logs.files = [FlightLog(bytearray(log), 10.0 * (i + 1)) for i, log in enumerate(logs)]
    fly(autopilot, 1.0)
    clients = [
        Client(AUTOPILOT_TYPES[kind].onboard_link(autopilot)),
        Client(AUTOPILOT_TYPES[kind].ground_link(autopilot)),
    ]
    for client in clients:
        client.listen()
    return autopilot, clients[0], clients[1]


def fly(autopilot: Autopilot, seconds: float) -> None:
    for _ in range(round(seconds / DT_S)):
        autopilot.step()
        autopilot.flight_logs.write(autopilot)
    autopilot.texts.clear()


def entries(messages: Sequence[MavlinkMessage]) -> list[tuple[int, int, int, int, int]]:
    assert {message.get_type() for message in messages} <= {"LOG_ENTRY"}
    return [(m.id, m.num_logs, m.last_log_num, m.time_utc, m.size) for m in messages]


def data(messages: Sequence[MavlinkMessage]) -> list[tuple[int, int, int]]:
    assert {message.get_type() for message in messages} <= {"LOG_DATA"}
    return [(m.id, m.ofs, m.count) for m in messages]


def texts(messages: Sequence[MavlinkMessage]) -> list[str]:
    return [message.text for message in messages if message.get_type() == "STATUSTEXT"]


# ---------------------------------------------------------------- PX4


def test_px4_lists_from_0_and_reports_the_requested_end() -> None:
    _, client, _ = px4()
    assert entries(client.list()) == [(0, 3, 3, 1010, 200), (1, 3, 3, 1020, 0), (2, 3, 3, 1030, 100)]
    assert [entry[:3] for entry in entries(client.list(1, 1))] == [(1, 3, 1), (2, 3, 1)]  # the end is ignored
    assert client.list(3, 5) == []
    assert len(client.list(target=9)) == 3  # the target is ignored, too


def test_px4_does_not_answer_when_it_has_no_logs() -> None:
    _, client, _ = px4(())
    assert client.list() == []


def test_px4_sends_whole_packets_to_the_end_of_the_log_at_once() -> None:
    _, client, _ = px4()
    client.list()
    whole = client.data(0, 0, 46_080)
    assert data(whole) == [(0, 0, 90), (0, 90, 90), (0, 180, 20)]
    assert b"".join(bytes(m.data[: m.count]) for m in whole) == LOGS[0]
    assert data(client.data(0, 45, 10)) == [(0, 45, 90)]  # more than requested
    assert client.listen() == []


def test_px4_does_not_answer_when_data_are_missing_or_not_listed() -> None:
    _, client, other = px4()
    assert client.data(0, 0, 90) == []
    client.list()
    assert client.data(9, 0, 90) == []
    assert client.data(0, 200, 90) == []
    assert other.data(0, 0, 90) == []  # each link has its own list
    assert len(client.data(0, 0, 90)) == 1


def test_px4_sends_logs_when_armed_and_on_two_links() -> None:
    autopilot, client, other = px4()
    assert autopilot.arm(forced=True) is None
    fly(autopilot, 0.1)
    assert len(client.list()) == len(other.list()) == 4  # with the log that has just begun
    assert len(client.data(0, 0, 90)) == len(other.data(2, 0, 90)) == 1


# ---------------------------------------------------------------- ArduPilot


def test_ardupilot_lists_from_1_and_dates_the_newest_log_now() -> None:
    autopilot, client, _ = copter()
    now_s = 1000 + int(autopilot.time_s)
    assert entries(client.list()) == [(1, 3, 3, 1010, 200), (2, 3, 3, 1020, 0), (3, 3, 3, now_s, 100)]
    assert [entry[:3] for entry in entries(client.list(2, 2))] == [(2, 3, 2)]
    assert client.list(target=9) == []


def test_ardupilot_sends_an_empty_entry_when_it_has_no_logs() -> None:
    _, client, _ = copter(())
    assert entries(client.list()) == [(0, 0, 0, 0, 0)]


def test_ardupilot_lists_until_the_end_request_when_the_start_is_past_the_last_log() -> None:
    _, client, _ = copter()
    first = entries(client.list(4, 4))
    assert first[0] == (4, 3, 3, 0, 0)
    assert all(client.listen() for _ in range(20))
    assert texts(client.list()) == ["Log download in progress"]
    assert client.end() == []
    assert len(client.list()) == 3


def test_ardupilot_sends_the_requested_bytes_and_ends_with_a_short_packet() -> None:
    _, client, _ = copter()
    assert data(client.data(1, 0, 100)) == [(1, 0, 90), (1, 90, 10)]  # without a list before
    assert data(client.data(1, 45, 46_080)) == [(1, 45, 90), (1, 135, 65)]
    assert data(client.data(1, 10**9, 90)) == [(1, 10**9, 0)]
    assert client.data(0, 0, 90) == client.data(4, 0, 90) == []


def test_ardupilot_sends_some_packets_per_step_on_one_link() -> None:
    _, client, other = copter([bytes(46_080)])
    first = client.data(1, 0, 46_080)
    assert 0 < len(first) < 512
    assert client.data(1, 0, 90)[0].ofs == len(first) * 90  # the second request was dropped without an answer
    assert texts(other.data(1, 0, 90)) == ["Log download in progress"]
    rest = [message for _ in range(20) for message in client.listen()]
    assert rest[-1].ofs + rest[-1].count == 46_080
    assert data(other.data(1, 0, 90)) == [(1, 0, 90)]


def test_ardupilot_sends_logs_only_when_disarmed() -> None:
    autopilot, client, _ = copter([bytes(46_080)])
    client.data(1, 0, 46_080)
    autopilot.set_mode(CopterMode.GUIDED)
    assert autopilot.arm() == []
    autopilot.texts.clear()
    assert client.listen() == []  # the transfer in progress is paused
    assert texts(client.list()) == ["Disarm for log download"]
    assert client.list() == client.data(1, 0, 90) == []  # the text is sent once
    autopilot.disarm(forced=True)
    autopilot.texts.clear()
    assert client.listen()
    client.end()
    assert autopilot.arm() == []
    autopilot.texts.clear()
    assert texts(client.list()) == ["Disarm for log download"]


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_no_log_is_left_after_erasing(kind: AutopilotKind) -> None:
    autopilot, client, _ = autopilot_with(kind, LOGS)
    client.list()
    client.erase()
    assert autopilot.flight_logs.files == []
    assert client.data(2, 0, 90) == []


# ---------------------------------------------------------------- contents


def test_px4_writes_a_ulog_from_arming_to_disarming() -> None:
    autopilot, _, _ = px4(())
    fly(autopilot, 4.0)
    assert autopilot.flight_logs.files == []
    armed_s = autopilot.time_s
    assert autopilot.arm() is None
    fly(autopilot, 3.0)
    autopilot.disarm(forced=True)
    fly(autopilot, 3.0)
    assert autopilot.arm() is None
    fly(autopilot, 1.0)
    first, second = autopilot.flight_logs.files
    positions, attitudes = rows_of(bytes(first.content))
    assert len(positions) == len(attitudes) == pytest.approx(30, abs=1)
    assert len(rows_of(bytes(second.content))[0]) == pytest.approx(10, abs=1)
    assert first.written_s == pytest.approx(armed_s + 3.0, abs=0.2)
    times_us = [struct.unpack("<Q", row[:8])[0] for row in positions]
    assert times_us == sorted(times_us)
    assert times_us[0] / 1e6 == pytest.approx(armed_s, abs=0.05)
    quaternion = struct.unpack("<4f", attitudes[0][8:])
    assert sum(part * part for part in quaternion) == pytest.approx(1.0, abs=1e-5)


def test_ardupilot_begins_another_log_when_the_current_one_is_read() -> None:
    autopilot, client, other = copter(())
    autopilot.set_mode(CopterMode.GUIDED)
    assert autopilot.arm() == []
    fly(autopilot, 2.0)
    autopilot.disarm(forced=True)
    fly(autopilot, 5.0)
    autopilot.texts.clear()
    (log,) = autopilot.flight_logs.files
    size_bytes = len(log.content)
    client.list()
    fly(autopilot, 1.0)
    assert len(log.content) > size_bytes  # listing does not end the log
    size_bytes = len(log.content)
    client.data(1, 0, 46_080)
    fly(autopilot, 20.0)
    assert len(log.content) == size_bytes
    assert len(autopilot.flight_logs.files) == 2
    client.data(1, 0, 90)
    other.data(2, 0, 90)
    fly(autopilot, 2.0)
    assert len(autopilot.flight_logs.files) == 2  # 15 s after disarming no log is written


def rows_of(ulog: bytes) -> tuple[list[bytes], list[bytes]]:
    """Data rows of vehicle_local_position and vehicle_attitude, by the definitions in the file."""
    assert ulog.startswith(MAGIC)
    topics: dict[int, str] = {}
    rows: dict[str, list[bytes]] = {"vehicle_local_position": [], "vehicle_attitude": []}
    at = 16
    while at < len(ulog):
        length, kind = struct.unpack_from("<HB", ulog, at)
        payload = ulog[at + 3 : at + 3 + length]
        at += 3 + length
        if kind == ord("A"):
            topics[struct.unpack_from("<H", payload, 1)[0]] = payload[3:].decode()
        elif kind == ord("D"):
            rows[topics[struct.unpack_from("<H", payload)[0]]].append(payload[2:])
    assert at == len(ulog)
    return rows["vehicle_local_position"], rows["vehicle_attitude"]


def test_ardupilot_writes_a_bin_until_15_s_after_disarming(tmp_path: Path) -> None:
    autopilot, _, _ = copter(())
    autopilot.set_mode(CopterMode.GUIDED)
    assert autopilot.arm() == []
    assert autopilot.take_off(2.0)
    fly(autopilot, 8.0)
    height_m = autopilot.quad.position_enu_m[2]
    assert height_m > 1.0
    autopilot.disarm(forced=True)
    fly(autopilot, 20.0)
    (log,) = autopilot.flight_logs.files
    file = tmp_path / "log.bin"
    file.write_bytes(log.content)
    reader = DFReader_binary(str(file))
    rows = []
    while row := reader.recv_match(type=["POS", "ATT"]):
        rows.append(row)
    positions = [row for row in rows if row.get_type() == "POS"]
    assert len(positions) == len(rows) / 2 == pytest.approx(230, abs=3)
    assert max(row.RelHomeAlt for row in positions) == pytest.approx(height_m, abs=0.2)
    assert positions[0].Lat == pytest.approx(47.397742, abs=1e-5)
