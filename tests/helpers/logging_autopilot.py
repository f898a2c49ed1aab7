"""A stand-in on a real UDP socket, with logs written by a test and a link that loses packets."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from random import Random

from background import Background
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.types.autopilot import AutopilotKind
from sitl.autopilots.autopilot import DT_S
from sitl.autopilots.logs import FlightLog
from sitl.autopilots.types import AUTOPILOT_TYPES
from sitl.vehicle.config import AutopilotFile, StandIn

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
