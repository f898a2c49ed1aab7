"""Are the ports of a fleet free? Asked before anything is started."""

from __future__ import annotations

import socket
from collections.abc import Iterable, Iterator

from companion.types import AutopilotKind
from sitl.ending import UnusableError
from sitl.manners import MANNERS
from sitl.ports import GROUND_STATION_PORT, LOOPBACK, ports_of

WantedPort = tuple[socket.SocketKind, int, str]  # its number, and what for


class PortInUseError(UnusableError):
    """str() is one line: which port, what wants it, what to do."""


def check_ports(vehicle_ids: Iterable[int], kind: AutopilotKind, port_offset: int) -> None:
    """Try every port of these vehicles, stand-ins and agents. Raises PortInUseError."""
    _check([port for i in vehicle_ids for port in _ports_of_vehicle(i, kind, port_offset)], port_offset)


def check_agents_ports(vehicle_ids: Iterable[int], port_offset: int) -> None:
    """Try the ports of the agents alone; the ways to their autopilots are not ours to choose. Raises PortInUseError."""
    _check([_zenoh_port(i, port_offset) for i in vehicle_ids], port_offset)


def _ports_of_vehicle(vehicle_id: int, kind: AutopilotKind, port_offset: int) -> Iterator[WantedPort]:
    ports = ports_of(vehicle_id, port_offset)
    if MANNERS[kind].tcp_link:
        yield socket.SOCK_STREAM, ports.tcp, f"autopilot {vehicle_id}"
    yield socket.SOCK_DGRAM, ports.onboard, f"autopilot {vehicle_id} towards its agent"
    yield socket.SOCK_DGRAM, ports.companion, f"agent {vehicle_id} towards its autopilot"
    yield socket.SOCK_DGRAM, ports.ground_link, f"autopilot {vehicle_id} towards a ground station"
    yield _zenoh_port(vehicle_id, port_offset)


def _zenoh_port(vehicle_id: int, port_offset: int) -> WantedPort:
    return socket.SOCK_STREAM, ports_of(vehicle_id, port_offset).zenoh, f"Zenoh of agent {vehicle_id}"


def _check(ports: Iterable[WantedPort], port_offset: int) -> None:
    wanted = {(socket.SOCK_DGRAM, GROUND_STATION_PORT): "a ground station"}
    for kind, port, purpose in ports:
        if other := wanted.get((kind, port)):
            raise PortInUseError(
                f"port {port} is wanted by {purpose} and by {other}; take other ports with --port-offset"
                f" {port_offset + 100}, or ids that lie less far apart"
            )
        wanted[kind, port] = purpose
        _try(kind, port, purpose, port_offset)


def _try(kind: socket.SocketKind, port: int, purpose: str, port_offset: int) -> None:
    protocol = "UDP" if kind is socket.SOCK_DGRAM else "TCP"
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind is socket.SOCK_STREAM:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # the last flight's closed connections linger
        try:
            probe.bind((LOOPBACK, port))
        except OSError as error:
            raise PortInUseError(
                f"{protocol} port {port}, wanted by {purpose}, cannot be used ({error.strerror}); another fleet may be"
                f" flying: wait for it, or take other ports with --port-offset {port_offset + 100}"
            ) from error
