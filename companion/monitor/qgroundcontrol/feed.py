"""Sends a fleet to one ground station by UDP. Nothing that it sends back is executed or passed on.

Each vehicle is a system with its vehicle id. A silent vehicle is not sent any more: the ground station shows its link as lost.
"""

from __future__ import annotations

import contextlib
import re
import socket
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import inf
from typing import Self

from companion.config.fleet import FleetConfig, GeodeticOrigin
from companion.ground.fleet_status import SILENT_AFTER_S
from companion.link.endpoint import LinkError, encoded_host
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.monitor.qgroundcontrol.messages import (
    denial,
    flag_message,
    position_messages,
    shown_flags,
    state_messages,
)
from companion.types.flight import HealthFlag
from companion.types.status import Status
from companion.wire.ground import StatusReport

POSITIONS_EVERY_S, STATES_EVERY_S = 0.2, 1.0
DATAGRAMS_PER_STEP, READ_BYTES = 64, 4096
DENIALS_PER_STEP = 10
TEXTS_PER_STEP = 3  # of one vehicle; each flag at most once in TEXT_AGAIN_S
TEXT_AGAIN_S = 10.0
COMMANDS = (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT)


@dataclass(slots=True)
class _System:
    """One vehicle as the ground station sees it."""

    codec: MavlinkCodec
    status: Status
    received_s: float
    positions_due_s: float = -inf
    states_due_s: float = -inf
    texts_s: dict[HealthFlag, float] = field(default_factory=dict)  # when each flag was last sent
    raised: frozenset[HealthFlag] = frozenset()  # flags that were sent and are still raised


class FleetFeed:
    """Call `forward` some ten times a second. It never blocks.

    Counters: `sent` datagrams, `ignored` messages from the ground station, `denied` commands among them, `foreign` statuses of
    another fleet.
    """

    def __init__(self, endpoint: str, fleet: FleetConfig) -> None:
        """`endpoint` is like udpout:127.0.0.1:14550. The fleet file has the origin of the positions. Raises LinkError."""
        self._fleet = fleet.name
        self._origin = fleet.origin.as_tuple() if isinstance(fleet.origin, GeodeticOrigin) else None
        self._socket = _socket_towards(endpoint)
        self._systems: dict[int, _System] = {}
        self._reader = MavlinkCodec(255, 0)
        self._began_s, self._stepped_s = inf, -inf
        self.sent = self.ignored = self.denied = self.foreign = 0

    def forward(self, reports: Iterable[tuple[float, StatusReport]], now_s: float) -> None:
        """Take in the reports that came since the last call, with their times of arrival; send what is due."""
        if now_s < self._stepped_s:  # a recording goes back: what is known is of its future
            self._systems.clear()
        for received_s, report in reports:
            self.take(report.status, received_s)
        self.step(now_s)

    def take(self, status: Status, now_s: float) -> None:
        """The newest status of a vehicle, received at this time."""
        if status.fleet != self._fleet:
            self.foreign += 1
            return
        system = self._systems.get(status.vehicle_id)
        if system is None:
            codec = MavlinkCodec(status.vehicle_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
            self._systems[status.vehicle_id] = _System(codec, status, now_s)
        else:
            system.status, system.received_s = status, now_s

    def step(self, now_s: float) -> None:
        """Send what is due, and drain what the ground station sent."""
        self._stepped_s, self._began_s = now_s, min(self._began_s, now_s)
        time_ms = int((now_s - self._began_s) * 1e3) % 2**32
        for system in self._systems.values():
            if now_s - system.received_s <= SILENT_AFTER_S:
                self._send(system, _due(system, self._origin, now_s, time_ms))
        self._drain()

    def close(self) -> None:
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send(self, system: _System, messages: Iterable[MavlinkMessage]) -> None:
        """In one datagram. A ground station that does not listen yet, or a full buffer: packets are lost, as on any link."""
        datagram = b"".join(system.codec.encode(message) for message in messages)
        if datagram:
            with contextlib.suppress(OSError):
                self._socket.send(datagram)
                self.sent += 1

    def _drain(self) -> None:
        denials = 0
        for _ in range(DATAGRAMS_PER_STEP):
            try:
                data = self._socket.recv(READ_BYTES)
            except BlockingIOError:
                return
            except OSError:
                continue  # ICMP error for a datagram sent earlier
            for message in self._reader.decode(data):
                self.ignored += 1
                system = self._systems.get(getattr(message, "target_system", 0))
                if system and message.get_msgId() in COMMANDS:
                    self.denied += 1
                    denials += 1
                    if denials <= DENIALS_PER_STEP:
                        answer = denial(message.command, message.get_srcSystem(), message.get_srcComponent())
                        self._send(system, [answer])


def _due(
    system: _System, origin_deg_deg_m: tuple[float, float, float] | None, now_s: float, time_ms: int
) -> list[MavlinkMessage]:
    """The messages of a vehicle that are due now; notes in `system` that they are sent."""
    messages: list[MavlinkMessage] = []
    if now_s >= system.states_due_s:
        system.states_due_s = _next_s(system.states_due_s, now_s, STATES_EVERY_S)
        messages += state_messages(system.status)
    if now_s >= system.positions_due_s:
        system.positions_due_s = _next_s(system.positions_due_s, now_s, POSITIONS_EVERY_S)
        messages += position_messages(system.status, now_s - system.received_s, origin_deg_deg_m, time_ms)
    return messages + _texts(system, now_s)


def _next_s(due_s: float, now_s: float, period_s: float) -> float:
    """A step that comes late delays no later message: the rate stays."""
    return due_s + period_s if now_s < due_s + period_s else now_s + period_s


def _texts(system: _System, now_s: float) -> list[MavlinkMessage]:
    """STATUSTEXT of flags that are new. A flag that comes and goes is not repeated at once."""
    raised = shown_flags(system.status)
    system.raised &= raised
    new = [
        flag
        for flag in HealthFlag
        if flag in raised - system.raised and now_s - system.texts_s.get(flag, -inf) >= TEXT_AGAIN_S
    ][:TEXTS_PER_STEP]
    system.raised |= frozenset(new)
    system.texts_s.update(dict.fromkeys(new, now_s))
    return [flag_message(flag, system.status.armed) for flag in new]


def _socket_towards(endpoint: str) -> socket.socket:
    """Connected: the kernel drops datagrams from any other address."""
    parts = re.fullmatch("udpout:(?P<host>.+):(?P<port>[0-9]{1,5})", endpoint)
    if not parts or not 0 < int(parts["port"]) <= 65_535:
        raise LinkError("expected udpout:HOST:PORT, like udpout:127.0.0.1:14550")
    host = encoded_host(parts["host"].strip("[]"))
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, int(parts["port"]), type=socket.SOCK_DGRAM)[0]
    except socket.gaierror as error:
        raise LinkError(f'no address found for "{parts["host"]}"; give an IP address') from error
    udp = socket.socket(family, kind, protocol)
    udp.setblocking(False)
    try:
        udp.connect(address)
    except OSError as error:
        udp.close()
        raise LinkError(f"{error.strerror or error}; check the network") from error
    return udp
