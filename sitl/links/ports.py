"""Ports derived from vehicle ids, as the simulations of PX4 and ArduPilot derive them: instance i is id - 1.

`offset` is added to all of them, so that several fleets can fly on one machine.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

LOOPBACK = "127.0.0.1"
GROUND_STATION_PORT = 14550  # where QGroundControl listens
MAX_PORT_OFFSET = 40_000  # the ports of vehicle 250 are still valid


@dataclass(frozen=True, slots=True)
class Ports:
    """UDP and TCP ports of one vehicle."""

    onboard: int  # UDP, autopilot, link to the companion computer
    companion: int  # UDP, companion computer: the autopilot sends to it from the start
    ground_link: int  # UDP, autopilot, link to a ground station
    tcp: int  # TCP, autopilot, ArduPilot only; a real one has two more links
    tcp_agent: int  # its second
    tcp_true_position: int  # its third
    true_position: int  # UDP, to which a real PX4 sends its true position
    true_source: int  # UDP, from which it does so
    zenoh: int  # TCP and UDP, agent


def ports_of(vehicle_id: int, offset: int = 0) -> Ports:
    instance = vehicle_id - 1 + offset
    return Ports(
        onboard=14580 + instance,
        companion=14540 + instance,
        ground_link=18570 + instance,
        tcp=5760 + 10 * (vehicle_id - 1) + offset,
        tcp_agent=5762 + 10 * (vehicle_id - 1) + offset,
        tcp_true_position=5763 + 10 * (vehicle_id - 1) + offset,
        true_position=19410 + instance,
        true_source=19450 + instance,
        zenoh=7447 + vehicle_id + offset,
    )


@dataclass(frozen=True, slots=True)
class CapturePorts:
    """UDP ports of the motion-capture system of a fleet."""

    natnet: int  # commands and frames
    data: int  # frames, at clients
    truth: int  # true poses of the stand-ins


def capture_ports(offset: int) -> CapturePorts:
    return CapturePorts(21_510 + offset, 21_511 + offset, 21_512 + offset)


def states_group(vehicle_ids: Iterable[int], offset: int) -> str:
    """Multicast group and port for the states of a fleet: a UDP port of its own, that of the agent with the lowest id."""
    return f"239.255.77.1:{ports_of(min(vehicle_ids), offset).zenoh}"


def zenoh_endpoint(vehicle_id: int, offset: int) -> str:
    """Zenoh endpoint on which the vehicle's agent listens."""
    return f"tcp/{LOOPBACK}:{ports_of(vehicle_id, offset).zenoh}"
