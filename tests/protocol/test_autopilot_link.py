"""Requests of telemetry streams until they arrive. A real UDP socket, a scripted autopilot."""

from __future__ import annotations

import asyncio
import socket
import time
from collections import Counter
from contextlib import closing
from math import nan

import pytest

from companion.link import autopilot_link
from companion.link.autopilot_link import SAMPLES_KEPT, AutopilotLink
from companion.mavlink.autopilot_types import DIALECTS
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.mavlink.translator import Translator
from companion.types.autopilot import AutopilotKind, PositionSample, Telemetry
from companion.types.notices import Code

HOST = "127.0.0.1"
MORE_THAN_ASKED = 5.0  # so that a busy machine does not make a stream that is there pass for one that is not
PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
SAMPLES = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: mavlink.MAVLink_heartbeat_message(
        2, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 4, 4, 3
    ),
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: mavlink.MAVLink_local_position_ned_message(0, 0, 0, 0, 0, 0, 0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: mavlink.MAVLink_attitude_quaternion_message(0, 1, 0, 0, 0, 0, 0, 0),
    mavlink.MAVLINK_MSG_ID_CURRENT_MODE: mavlink.MAVLink_current_mode_message(0, 6 << 16, 6 << 16),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: mavlink.MAVLink_attitude_target_message(0, 0, [1, 0, 0, 0], 0, 0, 0, 0.5),
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: mavlink.MAVLink_extended_sys_state_message(0, 2),
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, 0, 90, 0, 0, 0, 0, 0, 0),
}
HEARTBEAT = mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, 0, 6 << 16, 4, 3)
WANTED = {
    k: {i for i, interval_us in m.STREAMS_US.items() if interval_us > 0 and i in SAMPLES} for k, m in DIALECTS.items()
}


class ScriptedAutopilot:
    """Sends a stream only after a request; the first request for `deaf_to` is lost."""

    def __init__(self, kind: AutopilotKind, port: int, deaf_to: int) -> None:
        self._kind = kind
        self.asked: list[int] = []
        self.interval_s: dict[int, float] = {}
        self._deaf_to = deaf_to
        self._port = port
        self._codec = MavlinkCodec(3, mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    async def run(self) -> None:
        start_s, sent = time.monotonic(), dict.fromkeys(SAMPLES, 0)
        if self._kind is ARDUPILOT:
            self._send(SAMPLES[mavlink.MAVLINK_MSG_ID_HEARTBEAT])  # sent once a second without a request; here, once
        while True:
            if self._kind is PX4:
                self._send(HEARTBEAT)  # every 5 ms: its mode must not pass for the stream
            for message_id, interval_s in self.interval_s.items():
                while sent[message_id] * interval_s < MORE_THAN_ASKED * (time.monotonic() - start_s):
                    self._send(SAMPLES[message_id])
                    sent[message_id] += 1
            await asyncio.sleep(0.005)
            self._listen()

    def close(self) -> None:
        self._socket.close()

    def _send(self, message: MavlinkMessage) -> None:
        self._socket.sendto(self._codec.encode(message), (HOST, self._port))

    def _listen(self) -> None:
        while True:
            try:
                data = self._socket.recv(4096)
            except BlockingIOError:
                return
            for message in self._codec.decode(data):
                if message.get_type() == "COMMAND_LONG" and int(message.param1) in SAMPLES:
                    self._asked(int(message.param1), message.param2)

    def _asked(self, message_id: int, interval_us: float) -> None:
        self.asked.append(message_id)
        if message_id != self._deaf_to or self.asked.count(message_id) > 1:
            self.interval_s[message_id] = interval_us * 1e-6


def ignore(_reason: str) -> None:
    """Ignores its arguments."""


def test_damaged_packets_are_counted_once_by_reason() -> None:
    async def scenario() -> Counter[str]:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
            autopilot.bind((HOST, 0))
            port = autopilot.getsockname()[1]
        rejected: Counter[str] = Counter()
        codec = MavlinkCodec(3, mavlink.MAV_COMP_ID_AUTOPILOT1)
        damaged = bytearray(codec.encode(HEARTBEAT))
        damaged[12] ^= 0xFF
        nowhere = codec.encode(mavlink.MAVLink_attitude_quaternion_message(0, nan, 0, 0, 0, 0, 0, 0))
        longer = codec.encode(mavlink.MAVLink_attitude_quaternion_message(0, 2, 0, 0, 0, 0, 0, 0))
        reject = lambda reason: rejected.update([reason])  # noqa: E731
        with (
            closing(AutopilotLink(3, f"udpin:{HOST}:{port}", Translator(3), lambda _arrived_s: None, reject)) as link,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot,
        ):
            task = asyncio.create_task(link.receive())
            for data in (bytes(damaged), nowhere, longer, codec.encode(HEARTBEAT)):
                autopilot.sendto(data, (HOST, port))
            async with asyncio.timeout(5.0):
                while not link.is_connected:
                    await asyncio.sleep(0.01)
            task.cancel()
        return rejected

    rejected = asyncio.run(scenario())
    assert rejected.pop(Code.MAVLINK_UNREADABLE) >= 1
    assert rejected == {Code.ATTITUDE_INVALID: 2}


def test_a_flood_between_two_ticks_is_bounded_and_the_newest_samples_remain() -> None:
    async def scenario() -> tuple[tuple[Telemetry, ...], Counter[str]]:
        rejected: Counter[str] = Counter()
        reject = lambda reason: rejected.update([reason])  # noqa: E731
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((HOST, 0))
            port = probe.getsockname()[1]
        codec, sent = MavlinkCodec(3, mavlink.MAV_COMP_ID_AUTOPILOT1), 2 * SAMPLES_KEPT
        with (
            closing(AutopilotLink(3, f"udpin:{HOST}:{port}", Translator(3), lambda _arrived_s: None, reject)) as link,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot,
        ):
            task = asyncio.create_task(link.receive())
            for boot_ms in range(sent):
                message = mavlink.MAVLink_local_position_ned_message(boot_ms, 0, 0, 0, 0, 0, 0)
                autopilot.sendto(codec.encode(message), (HOST, port))
                if boot_ms % 32 == 0:
                    await asyncio.sleep(0.001)
            async with asyncio.timeout(10.0):
                while rejected[Code.TELEMETRY_OVERLOAD] < sent - SAMPLES_KEPT:
                    await asyncio.sleep(0.01)
            task.cancel()
            return link.drain(), rejected

    samples, rejected = asyncio.run(scenario())
    assert [sample.boot_time_s for sample in samples if isinstance(sample, PositionSample)] == [
        n / 1000 for n in range(SAMPLES_KEPT, 2 * SAMPLES_KEPT)
    ]
    assert rejected == {Code.TELEMETRY_OVERLOAD: SAMPLES_KEPT}


@pytest.mark.parametrize(("kind", "lost"), [(kind, lost) for kind, wanted in WANTED.items() for lost in sorted(wanted)])
def test_stream_request_is_repeated_only_when_lost(
    kind: AutopilotKind, lost: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(autopilot_link, "STREAM_CHECK_PERIOD_S", 0.5)

    async def scenario() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((HOST, 0))
            port = probe.getsockname()[1]
        with (
            closing(AutopilotLink(3, f"udpin:{HOST}:{port}", Translator(3), lambda _arrived_s: None, ignore)) as link,
            closing(ScriptedAutopilot(kind, port, lost)) as autopilot,
        ):
            tasks = [asyncio.create_task(job) for job in (autopilot.run(), link.receive(), link.keep_streams())]
            async with asyncio.timeout(5.0):
                while lost not in autopilot.interval_s:
                    await asyncio.sleep(0.01)
            async with asyncio.timeout(20.0):  # a busy machine may starve a stream now and then, not for ever
                asked = -1
                while asked != len(autopilot.asked):
                    asked = len(autopilot.asked)
                    await asyncio.sleep(2.2 * autopilot_link.STREAM_CHECK_PERIOD_S)
            assert autopilot.interval_s.keys() == WANTED[kind]
            for task in tasks:
                task.cancel()

    asyncio.run(scenario())
