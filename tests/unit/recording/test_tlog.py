"""A .tlog is read by pymavlink, with the times and packets of both directions."""

from __future__ import annotations

from pathlib import Path

import pytest
from pymavlink import mavutil

from agent_on_bytes import FailingFlight
from companion.link.autopilot_link import AutopilotLink
from companion.mavlink.codec import MavlinkCodec
from companion.mavlink.translator import Translator
from companion.recording.writing import WritingAtOnce
from companion.types.autopilot import AttitudeTarget, AutopilotKind
from recordings import BEGAN_S, BEGAN_UNIX_S, recorder


class Wire:
    """A link that sends nowhere, and is free every second time."""

    def __init__(self, _endpoint: str, _received: object, _all_read: object, _beside: object) -> None:
        self.sent: list[bytes] = []

    def send(self, data: bytes) -> None:
        self.sent.append(data)

    def offer(self, data: bytes) -> bool:
        self.sent.append(data)
        return len(self.sent) % 2 == 0


def test_mavutil_reads_a_tlog(tmp_path: Path) -> None:
    recording = recorder(tmp_path, WritingAtOnce(), tlog=True)
    flight = FailingFlight(AutopilotKind.PX4, recording)
    translator = Translator(3)
    for _ in range(120):
        for packet in packets(translator, flight):
            recording.mavlink(packet, flight.now_s + 0.02)
        flight.tick()
    recording.close()
    log = mavutil.mavlink_connection(str(tmp_path / "vehicle_3_0001_001.tlog"))
    times_s, kinds = [], set()
    while message := log.recv_match():
        times_s.append(message._timestamp)
        kinds.add(message.get_type())
    assert {"HEARTBEAT", "LOCAL_POSITION_NED", "ATTITUDE_QUATERNION"} <= kinds
    assert "BAD_DATA" not in kinds
    assert times_s == sorted(times_s)
    assert times_s[0] == pytest.approx(BEGAN_UNIX_S + flight.now_s - BEGAN_S - 120 * 0.02 + 0.02, abs=1e-5)


def packets(translator: Translator, flight: FailingFlight) -> list[bytes]:
    """What the autopilot sends now, as the link hands it on."""
    sent = flight.autopilot.send()
    translator.telemetry(sent, flight.now_s)
    return [packet.data for packet in translator.packets]


def test_only_what_was_sent_is_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("companion.link.autopilot_link.open_link", Wire)
    recorded: list[bytes] = []
    translator = Translator(3, AutopilotKind.PX4)
    record = lambda packet, _now_s: recorded.append(packet)  # noqa: E731
    link = AutopilotLink(3, "", translator, lambda _arrived_s: None, lambda _code: None, record)
    link.command(AttitudeTarget(0.0, 0.0, 0.0, 0.5), 1.0)
    assert link.offer(b"sent")
    assert not link.offer(b"link is busy")
    setpoint, offered = recorded
    assert MavlinkCodec(3, 1).decode(setpoint)[0].get_type() == "SET_ATTITUDE_TARGET"
    assert offered == b"sent"


def test_without_the_setting_no_packet_is_kept(tmp_path: Path) -> None:
    assert not recorder(tmp_path, WritingAtOnce()).records_mavlink
    assert recorder(tmp_path, WritingAtOnce(), tlog=True).records_mavlink
