"""Ports of a fleet: checked before anything starts, and reserved against another fleet that starts at the same moment."""

from __future__ import annotations

import fcntl
import os
import socket
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from companion.types.autopilot import AutopilotKind
from companion.types.errors import UnusableError
from sitl.autopilots.types import AUTOPILOT_TYPES
from sitl.links.ports import GROUND_STATION_PORT, LOOPBACK, ports_of

WantedPort = tuple[socket.SocketKind, int, str]  # kind, number, purpose
OFFSETS = range(0, 10_000, 100)  # tried in this order when no offset is given
TCP_LOCKS_BEGIN = 65_536  # byte of the lock file: port for UDP, this and the port for TCP


class PortInUseError(UnusableError):
    """A port cannot be used. str() is one line: which port, its purpose, what to do."""


@contextmanager
def reserved_ports(autopilots: Mapping[int, AutopilotKind | None], offset: int | None) -> Iterator[int]:
    """Reserve the ports of agents and their stand-ins until the block ends; yields the port offset.

    `autopilots`: by id. Of None, an external autopilot, only the agent's ports are reserved. Without `offset` the first of
    OFFSETS is taken with which all ports are free. Raises PortInUseError.
    """
    with _lock_file().open("r+b") as file:  # closing it releases the locks, as the end of the process does
        yield _first_free_offset(autopilots, OFFSETS if offset is None else (offset,), file)


def _first_free_offset(autopilots: Mapping[int, AutopilotKind | None], offsets: Iterable[int], file: BinaryIO) -> int:
    first_error: PortInUseError | None = None
    for offset in offsets:
        try:
            ports = [port for i, kind in autopilots.items() for port in _ports_of_vehicle(i, kind, offset)]
            _check(ports, offset)
            _lock(ports, offset, file)
        except PortInUseError as error:
            first_error = first_error or error
        else:
            return offset
    assert first_error is not None  # there is at least one offset
    raise first_error


def _ports_of_vehicle(vehicle_id: int, kind: AutopilotKind | None, port_offset: int) -> Iterator[WantedPort]:
    ports = ports_of(vehicle_id, port_offset)
    if kind is not None:
        if AUTOPILOT_TYPES[kind].tcp_link:
            for port in (ports.tcp, ports.tcp_agent, ports.tcp_true_position):
                yield socket.SOCK_STREAM, port, f"autopilot {vehicle_id}"
        yield socket.SOCK_DGRAM, ports.onboard, f"autopilot {vehicle_id} towards its agent"
        yield socket.SOCK_DGRAM, ports.companion, f"agent {vehicle_id} towards its autopilot"
        yield socket.SOCK_DGRAM, ports.ground_link, f"autopilot {vehicle_id} towards a ground station"
        for port in (ports.true_position, ports.true_source):
            yield socket.SOCK_DGRAM, port, f"the true position of vehicle {vehicle_id}"
    for protocol in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
        yield protocol, ports.zenoh, f"Zenoh of agent {vehicle_id}"


def _check(ports: Iterable[WantedPort], port_offset: int) -> None:
    wanted = {(socket.SOCK_DGRAM, GROUND_STATION_PORT): "a ground station"}
    for kind, port, purpose in ports:
        if other := wanted.get((kind, port)):
            raise PortInUseError(
                f"port {port} is wanted by {purpose} and by {other}; take other ports with --port-offset"
                f" {port_offset + 100}, or ids that lie less than 40 apart"
            )
        wanted[kind, port] = purpose
        _try(kind, port, purpose, port_offset)


def _try(kind: socket.SocketKind, port: int, purpose: str, port_offset: int) -> None:
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind is socket.SOCK_STREAM:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # closed connections of the last flight linger
        try:
            probe.bind((LOOPBACK, port))
        except OSError as error:
            raise _in_use(kind, port, purpose, port_offset, str(error.strerror)) from error


def _lock(ports: Iterable[WantedPort], port_offset: int, file: BinaryIO) -> None:
    """One byte of the lock file per port: a fleet that has reserved its ports may not have bound them yet."""
    for kind, port, purpose in ports:
        byte = port + (TCP_LOCKS_BEGIN if kind is socket.SOCK_STREAM else 0)
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
        except OSError as error:
            fcntl.lockf(file, fcntl.LOCK_UN)
            raise _in_use(kind, port, purpose, port_offset, "reserved by another fleet") from error


def _lock_file() -> Path:
    """Shared by all fleets of this user on this machine."""
    path = Path(tempfile.gettempdir()) / f"sitl-ports-{os.getuid()}.lock"
    path.touch(mode=0o600)
    return path


def _in_use(kind: socket.SocketKind, port: int, purpose: str, port_offset: int, why: str) -> PortInUseError:
    protocol = "UDP" if kind is socket.SOCK_DGRAM else "TCP"
    return PortInUseError(
        f"{protocol} port {port}, wanted by {purpose}, cannot be used ({why}); another fleet may be"
        f" flying: wait for it, or take other ports with --port-offset {port_offset + 100}"
    )
