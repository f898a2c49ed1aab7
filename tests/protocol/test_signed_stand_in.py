"""MAVLink signing over real sockets: ArduCopter enforces the key that it was given, PX4 1.16 has no signing.

A ground station gives the key by SETUP_SIGNING; what the agent makes of the autopilot then depends on its own key alone.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import msgspec
import pytest

from common import until
from companion.ground.session import FleetSession
from companion.mavlink.codec import (
    EPOCH_UNIX_S,
    SIGNATURE_CODES,
    UNITS_PER_S,
    MavlinkCodec,
    MavlinkMessage,
    SigningKey,
    mavlink,
)
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.status import Status
from processes import AgentFiles, StandInProcess, agent, agent_files, companion, stand_in

SECRET, OTHER_SECRET = bytes(range(1, 33)), bytes(range(33, 65))
COPTER = "stand_in: {autopilot: ardupilot, armable_after_s: 1, sensors: ideal, parameters: {GUID_OPTIONS: 8}}\n"
PX4 = "stand_in: {sensors: ideal}\n"
ASK = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)


def key(secret: bytes) -> SigningKey:
    return SigningKey(secret, 7, time.time)


def give_key(secret: bytes) -> MavlinkMessage:
    return mavlink.MAVLink_setup_signing_message(1, 1, list(secret), int((time.time() - EPOCH_UNIX_S) * UNITS_PER_S))


class GroundStation:
    """Receives all packets, signed or not; sends with the codec, and so the key, that a call names."""

    def __init__(self, link: socket.socket) -> None:
        self._link, self._codec = link, MavlinkCodec(255, 190)
        link.settimeout(20.0)

    @classmethod
    def by_tcp(cls, process: StandInProcess) -> Self:
        return cls(socket.create_connection(("127.0.0.1", process.ports.tcp)))

    @classmethod
    def by_udp(cls, process: StandInProcess) -> Self:
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        link.connect(("127.0.0.1", process.ports.ground_link))
        return cls(link)

    def close(self) -> None:
        self._link.close()

    def send(self, message: MavlinkMessage, by: MavlinkCodec) -> None:
        self._link.sendall(by.encode(message))

    def wait(self, kind: str, signed: bool) -> MavlinkMessage:
        """The next message of this kind with, or without, a signature."""
        end_s = time.monotonic() + 20.0
        while time.monotonic() < end_s:
            for message in self._codec.decode(self._link.recv(4096)):
                is_signed = bool(message.get_msgbuf()[2] & mavlink.MAVLINK_IFLAG_SIGNED)
                if message.get_type() == kind and is_signed == signed:
                    return message
        raise AssertionError(f"no {kind} came")


@contextmanager
def copter_with_a_key(folder: Path) -> Iterator[tuple[StandInProcess, GroundStation]]:
    with stand_in(folder, COPTER) as process:
        station = GroundStation.by_tcp(process)
        try:
            station.wait("HEARTBEAT", signed=False)
            station.send(give_key(SECRET), MavlinkCodec(255, 190))
            station.wait("HEARTBEAT", signed=True)
            yield process, station
        finally:
            station.close()


def files_of(folder: Path, process: StandInProcess, secret: bytes | None) -> AgentFiles:
    files = agent_files(folder, f"udpin:127.0.0.1:{process.ports.companion}")
    if secret is not None:
        (folder / "mavlink.key").write_text(secret.hex() + "\n", encoding="ascii")
        (folder / "mavlink.key").chmod(0o600)
        words = files.file.read_text(encoding="utf-8")
        files.file.write_text(words + "signing: {key_file: mavlink.key}\n", encoding="utf-8")
    return files


def order(session: FleetSession, name: CommandName, phase: FlightPhase) -> Status:
    """Repeat a command until the vehicle is in that phase; that status."""
    reported: list[Status] = []

    def is_there() -> bool:
        reported.extend(report.status for report in session.drain())
        if reported and reported[-1].phase is phase:
            return True
        session.command([1], name, 1.0)
        time.sleep(0.3)
        return False

    until(is_there, 60.0)
    return reported[-1]


# ---------------------------------------------------------------- autopilots


def test_a_copter_with_a_key_answers_only_packets_signed_with_it(tmp_path: Path) -> None:
    with copter_with_a_key(tmp_path) as (_, station):
        for number, by in enumerate((None, key(OTHER_SECRET), key(SECRET))):
            ask = mavlink.MAVLink_param_request_read_message(
                1, 1, (b"GUID_OPTIONS", b"GUID_TIMEOUT", b"RTL_ALT")[number], -1
            )
            station.send(ask, MavlinkCodec(255, 190, by))
        assert station.wait("PARAM_VALUE", signed=True).param_id == "RTL_ALT"  # the first answer


@pytest.mark.parametrize("secret", [SECRET, OTHER_SECRET], ids=["its key", "another key"])
def test_a_px4_does_not_sign_and_accepts_any_signature(tmp_path: Path, secret: bytes) -> None:
    with stand_in(tmp_path, PX4) as process:
        station = GroundStation.by_udp(process)
        station.send(give_key(SECRET), MavlinkCodec(255, 190))
        station.send(ASK, MavlinkCodec(255, 190, key(secret)))
        assert station.wait("COMMAND_ACK", signed=False).result == mavlink.MAV_RESULT_ACCEPTED
        station.close()


# ---------------------------------------------------------------- agents


def test_with_the_right_key_an_agent_arms_a_copter_that_enforces_it(tmp_path: Path) -> None:
    with copter_with_a_key(tmp_path) as (process, _):
        files = files_of(tmp_path, process, SECRET)
        with agent(files) as running, FleetSession("processtest", (files.zenoh,)) as session:
            running.wait_for_log("heartbeat of autopilot 1")
            order(session, CommandName.PREPARE, FlightPhase.READY)
            status = order(session, CommandName.ARM, FlightPhase.ARMED)
            until(lambda: process.newest.armed)
            assert not set(SIGNATURE_CODES) & set(status.rejected)


def test_with_the_right_key_the_doctor_reads_a_copter_that_enforces_it(tmp_path: Path) -> None:
    with copter_with_a_key(tmp_path) as (process, _):
        done = companion("doctor", "--config", str(files_of(tmp_path, process, SECRET).file), "--json")
    found = {finding["subject"]: finding["found"] for finding in msgspec.json.decode(done.stdout)["findings"]}
    assert found["GUID_OPTIONS"] == "8 (thrust is thrust)"
    assert not found["positions"].startswith("0.0")  # they were requested


def test_a_copter_with_another_key_is_rejected(tmp_path: Path) -> None:
    with copter_with_a_key(tmp_path) as (process, _):
        done = companion("agent", "--config", str(files_of(tmp_path, process, OTHER_SECRET).file), "--wait-s", "2")
    assert done.returncode == 3
    assert "its packets are signed with another key" in done.stderr.splitlines()[-1]


def test_an_agent_without_a_key_moves_nothing_and_reports_the_cause(tmp_path: Path) -> None:
    with copter_with_a_key(tmp_path) as (process, _):
        before = process.first_truth()
        files = files_of(tmp_path, process, None)
        with agent(files) as running, FleetSession("processtest", (files.zenoh,)) as session:
            running.wait_for_log("the autopilot signs its packets and may ignore unsigned ones: set signing")
            for _ in range(3):
                session.command([1], CommandName.PREPARE, 1.0)
                session.command([1], CommandName.ARM, 1.0)
                time.sleep(0.5)
            phases = {report.status.phase for report in session.drain()}
        assert (process.newest.mode, process.newest.armed) == (before.mode, False)
        assert phases
        assert not {FlightPhase.READY, FlightPhase.ARMED} & phases


@pytest.mark.parametrize("configuration", [PX4, COPTER], ids=["a PX4", "a copter without a key"])
def test_an_agent_with_a_key_rejects_an_autopilot_that_does_not_sign(tmp_path: Path, configuration: str) -> None:
    with stand_in(tmp_path, configuration) as process:
        done = companion("agent", "--config", str(files_of(tmp_path, process, SECRET).file), "--wait-s", "2")
    assert done.returncode == 3
    assert "its packets are not signed; give it the key" in done.stderr.splitlines()[-1]
    assert "PX4 1.16 cannot sign" in done.stderr
