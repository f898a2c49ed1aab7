"""Free ports that no other test process takes: each is locked until the process that took it ends.

A probe alone does not suffice: another test process finds the same port free before this one has bound it.
"""

from __future__ import annotations

import fcntl
import os
import socket
import tempfile
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import BinaryIO

from sitl.links.ports import LOOPBACK, ports_of

PortOfKind = tuple[socket.SocketKind, int]

SINGLE_PORTS = range(22_000, 32_000)  # above the ports of fleets, below those that the kernel gives to connections
SINGLE_VEHICLES = range(640, 900, 4)
FLEETS = range(1000, 3400, 10)
LARGEST_FLEET = 5
TCP_LOCKS_BEGIN = 65_536  # byte of the lock file: port for UDP, this and the port for TCP


def free_port(kind: socket.SocketKind) -> int:
    """A port of its own for each call."""
    for port in _single_ports():
        if _take([(kind, port)]):
            return port
    raise AssertionError(f"no free port up to {SINGLE_PORTS.stop - 1}")


def free_fleet_offset() -> int:
    """For a fleet of up to LARGEST_FLEET vehicles of either make. The next call may return the same, once they have ended."""
    return _free_offset(FLEETS, LARGEST_FLEET)


def free_vehicle_offset() -> int:
    """For vehicle 1 alone. The next call may return the same, once its process has ended."""
    return _free_offset(SINGLE_VEHICLES, 1)


@cache
def _single_ports() -> Iterator[int]:
    return iter(SINGLE_PORTS)


def _free_offset(offsets: Iterable[int], vehicles: int) -> int:
    for offset in offsets:
        if _take([port for vehicle_id in range(1, vehicles + 1) for port in _of_vehicle(vehicle_id, offset)]):
            return offset
    raise AssertionError("no free ports")


def _of_vehicle(vehicle_id: int, offset: int) -> list[PortOfKind]:
    ports = ports_of(vehicle_id, offset)
    udp = [(socket.SOCK_DGRAM, port) for port in (ports.onboard, ports.companion, ports.ground_link, ports.zenoh)]
    return udp + [(socket.SOCK_STREAM, port) for port in (ports.tcp, ports.zenoh)]


def _take(ports: Iterable[PortOfKind]) -> bool:
    """Lock them all for this process, if all are free."""
    return all(_is_free(kind, port) and _lock(kind, port) for kind, port in ports)


def _is_free(kind: socket.SocketKind, port: int) -> bool:
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind is socket.SOCK_STREAM:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # closed connections of the last test linger
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            return False
    return True


def _lock(kind: socket.SocketKind, port: int) -> bool:
    try:
        fcntl.lockf(
            _lock_file(),
            fcntl.LOCK_EX | fcntl.LOCK_NB,
            1,
            port + (TCP_LOCKS_BEGIN if kind is socket.SOCK_STREAM else 0),
        )
    except OSError:
        return False
    return True


@cache  # open until the process ends: closing it would release the locks
def _lock_file() -> BinaryIO:
    path = Path(tempfile.gettempdir()) / f"test-ports-{os.getuid()}.lock"
    path.touch(mode=0o600)
    return path.open("r+b")
