"""Port offsets at which all ports of a simulated fleet are free. Every test process has a range of its own."""

from __future__ import annotations

import os
import socket
from collections.abc import Sequence

from sitl.links.ports import LOOPBACK, ports_of

SINGLE_VEHICLES = range(640, 900, 4)
FLEETS = range(1000, 3400, 10)
LARGEST_FLEET = 5


def free_fleet_offset() -> int:
    """For a fleet of up to LARGEST_FLEET vehicles of either make."""
    return _free_offset(FLEETS, LARGEST_FLEET, slots=40)


def free_vehicle_offset() -> int:
    """For vehicle 1 alone."""
    return _free_offset(SINGLE_VEHICLES, 1, slots=len(SINGLE_VEHICLES))


def _free_offset(offsets: Sequence[int], vehicles: int, slots: int) -> int:
    """The search begins in one of `slots` places, by process id: test processes that run at once do not take the same ports."""
    first = os.getpid() % slots * (len(offsets) // slots)
    for offset in (*offsets[first:], *offsets[:first]):
        if all(_is_free(vehicle_id, offset) for vehicle_id in range(1, vehicles + 1)):
            return offset
    raise AssertionError("no free ports")


def _is_free(vehicle_id: int, offset: int) -> bool:
    ports = ports_of(vehicle_id, offset)
    wanted = [(socket.SOCK_DGRAM, port) for port in (ports.onboard, ports.companion, ports.ground_link, ports.zenoh)]
    wanted += [(socket.SOCK_STREAM, port) for port in (ports.tcp, ports.zenoh)]
    try:
        for kind, port in wanted:
            with socket.socket(socket.AF_INET, kind) as probe:
                if kind is socket.SOCK_STREAM:
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind((LOOPBACK, port))
    except OSError:
        return False
    return True
