"""Signing as the real programs have it, over real sockets: ArduCopter enforces a key that it was given, PX4 1.16 has none.

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
from agent_process import AgentFiles, agent, agent_files, companion, until
from stand_in_process import StandInProcess, stand_in

from companion.ground.session import FleetSession
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.mavlink.signing import EPOCH_UNIX_S, REASONS, UNITS_PER_S, SigningKey
from companion.types import CommandName, FlightPhase, Status

SECRET, OTHER_SECRET = bytes(range(1, 33)), bytes(range(33, 65))
COPTER = "stand_in: {autopilot: ardupilot, armable_after_s: 3, sensors: ideal, parameters: {GUID_OPTIONS: 8}}\n"
PX4 = "stand_in: {sensors: ideal}\n"
ASK = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)


def key(secret: bytes) -> SigningKey:
    return SigningKey(secret, 7, time.time)


def give_key(secret: bytes) -> MavlinkMessage:
    return mavlink.MAVLink_setup_signing_message(1, 1, list(secret), int((time.time() - EPOCH_UNIX_S) * UNITS_PER_S))


class GroundStation:
    """Hears all, whoever signed it; what it says is signed as each codec that it says it with."""

    def __init__(self, link: socket.socket) -> None:
        self._link, self._heard = link, MavlinkCodec(255, 190)
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

    def say(self, message: MavlinkMessage, by: MavlinkCodec) -> None:
        self._link.sendall(by.encode(message))

    def wait(self, kind: str, signed: bool) -> MavlinkMessage:
        """The next one of this kind that is signed, or that is not."""
        end_s = time.monotonic() + 20.0
        while time.monotonic() < end_s:
            for message in self._heard.decode(self._link.recv(4096)):
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
            station.say(give_key(SECRET), MavlinkCodec(255, 190))
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
    """Give a command until it has led to that phase; the status that says so."""
    told: list[Status] = []

    def is_there() -> bool:
        told.extend(report.status for report in session.drain())
        if told and told[-1].phase is phase:
            return True
        session.command([1], name, 1.0)
        time.sleep(0.3)
        return False

    until(is_there, 60.0)
    return told[-1]


# ---------------------------------------------------------------- what the autopilots do


def test_a_copter_that_was_given_a_key_answers_nobody_without_it(tmp_path: Path) -> None:
    with copter_with_a_key(tmp_path) as (_, station):
        for number, by in enumerate((None, key(OTHER_SECRET), key(SECRET))):
            ask = mavlink.MAVLink_param_request_read_message(
                1, 1, (b"GUID_OPTIONS", b"GUID_TIMEOUT", b"RTL_ALT")[number], -1
            )
            station.say(ask, MavlinkCodec(255, 190, by))
        assert station.wait("PARAM_VALUE", signed=True).param_id == "RTL_ALT"  # the first that was answered at all


@pytest.mark.parametrize("secret", [SECRET, OTHER_SECRET], ids=["its key", "another key"])
def test_a_px4_signs_nothing_and_lets_whatever_is_signed_pass(tmp_path: Path, secret: bytes) -> None:
    with stand_in(tmp_path, PX4) as process:
        station = GroundStation.by_udp(process)
        station.say(give_key(SECRET), MavlinkCodec(255, 190))
        station.say(ASK, MavlinkCodec(255, 190, key(secret)))
        assert station.wait("COMMAND_ACK", signed=False).result == mavlink.MAV_RESULT_ACCEPTED
        station.close()


# ---------------------------------------------------------------- what an agent makes of it


def test_with_the_right_key_an_agent_arms_a_copter_that_enforces_it(tmp_path: Path) -> None:
    with copter_with_a_key(tmp_path) as (process, _):
        files = files_of(tmp_path, process, SECRET)
        with agent(files) as running, FleetSession.open("processtest", (files.zenoh,)) as session:
            running.wait_for_log("heartbeat of autopilot 1")
            order(session, CommandName.PREPARE, FlightPhase.READY)
            status = order(session, CommandName.ARM, FlightPhase.ARMED)
            until(lambda: process.truth()[-1].armed)
            assert not set(REASONS) & set(status.rejected)


def test_with_the_right_key_the_doctor_reads_a_copter_that_enforces_it(tmp_path: Path) -> None:
    with copter_with_a_key(tmp_path) as (process, _):
        done = companion("doctor", "--config", str(files_of(tmp_path, process, SECRET).file), "--json")
    found = {finding["subject"]: finding["found"] for finding in msgspec.json.decode(done.stdout)["findings"]}
    assert found["GUID_OPTIONS"] == "8 (thrust is thrust)"
    assert not found["positions"].startswith("0.0")  # it was asked for them


def test_with_another_key_no_copter_is_believed(tmp_path: Path) -> None:
    with copter_with_a_key(tmp_path) as (process, _):
        done = companion("agent", "--config", str(files_of(tmp_path, process, OTHER_SECRET).file), "--wait-s", "3")
    assert done.returncode == 3
    assert "its packets are signed with another key" in done.stderr.splitlines()[-1]


def test_without_a_key_an_agent_moves_nothing_and_says_what_is_wrong(tmp_path: Path) -> None:
    with copter_with_a_key(tmp_path) as (process, _):
        before = process.truth()[-1]
        files = files_of(tmp_path, process, None)
        with agent(files) as running, FleetSession.open("processtest", (files.zenoh,)) as session:
            running.wait_for_log("the autopilot signs its packets and may ignore this agent's: set signing")
            for _ in range(3):
                session.command([1], CommandName.PREPARE, 1.0)
                session.command([1], CommandName.ARM, 1.0)
                time.sleep(0.5)
            phases = {report.status.phase for report in session.drain()}
        assert (process.truth()[-1].mode, process.truth()[-1].armed) == (before.mode, False)
        assert phases
        assert not {FlightPhase.READY, FlightPhase.ARMED} & phases


@pytest.mark.parametrize("configuration", [PX4, COPTER], ids=["a PX4", "a copter without a key"])
def test_an_agent_with_a_key_hears_nobody_who_does_not_sign(tmp_path: Path, configuration: str) -> None:
    with stand_in(tmp_path, configuration) as process:
        done = companion("agent", "--config", str(files_of(tmp_path, process, SECRET).file), "--wait-s", "3")
    assert done.returncode == 3
    assert "its packets are not signed; give it the key" in done.stderr.splitlines()[-1]
    assert "PX4 1.16 cannot sign" in done.stderr
