"""Where the agents of a fleet listen and connect, and whether strangers can reach that."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Annotated

from msgspec import Meta

from companion.config.fleet import FleetConfig
from companion.config.validation import Problem
from companion.config.values import NetworkAddress, Section

LOOPBACK = re.compile(r"localhost|127(\.\d{1,3}){3}|\[?::1\]?")
STRANGERS = (
    "strangers who reach it could command the vehicle; expected an identity (companion provision), or security: none in"
    " the fleet file, or an address of this machine alone, like 127.0.0.1"
)


class ZenohEndpoints(Section, frozen=True):
    """Endpoints of the vehicle's Zenoh session, like `tcp/192.168.1.11:7447`. Multicast scouting is off."""

    listen: Annotated[tuple[str, ...], Meta(description="endpoints where the agent accepts connections")] = ()
    connect: Annotated[tuple[str, ...], Meta(description="endpoints of other vehicles, tried until they answer")] = ()


class DatagramEndpoints(Section, frozen=True):
    """Peer states as UDP datagrams instead of over Zenoh, for radio links that lose packets; the same in all vehicles."""

    listen: Annotated[
        NetworkAddress, Meta(description="address and port where the agent receives, like `0.0.0.0:7447`")
    ]
    send_to: Annotated[
        tuple[NetworkAddress, ...],
        Meta(min_length=1, description="where the other vehicles listen; one broadcast address reaches them all"),
    ]


def endpoints_of(fleet: FleetConfig, vehicle_id: int, secured: bool) -> ZenohEndpoints:
    """Endpoints of one vehicle by the addresses of the fleet file; none without an address.

    Each agent connects to those with lower ids, so that every pair has one connection.
    """
    protocol = protocol_of(fleet, secured)
    addresses = {member.id: member.address for member in fleet.vehicles if member.address is not None}
    if vehicle_id not in addresses:
        return ZenohEndpoints()
    host, _, port = addresses[vehicle_id].rpartition(":")
    listen = f"{host if LOOPBACK.fullmatch(host) else '0.0.0.0'}:{port}"
    lower = [address for i, address in addresses.items() if i < vehicle_id]
    return ZenohEndpoints((f"{protocol}/{listen}",), tuple(f"{protocol}/{address}" for address in lower))


def datagrams_of(fleet: FleetConfig, vehicle_id: int) -> DatagramEndpoints | None:
    """Multicast of the fleet file, on the network interface that has the vehicle's address; None without."""
    if fleet.multicast is None:
        return None
    address = next((member.address for member in fleet.vehicles if member.id == vehicle_id), None)
    host = address.rpartition(":")[0] if address else "0.0.0.0"
    return DatagramEndpoints(f"{host}:{fleet.multicast.rpartition(':')[2]}", (fleet.multicast,))


def ground_endpoints(fleet: FleetConfig, secured: bool) -> tuple[str, ...]:
    """Where the ground connects: to every address of the fleet file; empty where it has none."""
    protocol = protocol_of(fleet, secured)
    return tuple(f"{protocol}/{member.address}" for member in fleet.vehicles if member.address is not None)


def protocol_of(fleet: FleetConfig, secured: bool) -> str:
    """Zenoh's name of the protocol."""
    return "tls" if fleet.transport == "tcp" and secured else fleet.transport


def network_problems(
    fleet: FleetConfig,
    vehicle_id: int,
    zenoh: ZenohEndpoints | None,
    datagrams: DatagramEndpoints | None,
    secured: bool,
) -> Iterator[Problem]:
    """What others reach over a network needs an identity, or the fleet's word that it has none."""
    if secured:
        return
    if fleet.transport == "quic" and zenoh is None:
        yield Problem("identity", "missing; transport quic needs the certificate that companion provision makes")
    if fleet.security == "none":
        return
    used = zenoh or endpoints_of(fleet, vehicle_id, secured)
    for kind, endpoints in (("listen", used.listen), ("connect", used.connect)):
        for endpoint in endpoints:
            if reaches_network(endpoint.partition("/")[2]):
                yield Problem(f"zenoh.{kind}" if zenoh else "identity", f'"{endpoint}": {STRANGERS}')
    sent = datagrams or datagrams_of(fleet, vehicle_id)
    for address in (sent.listen, *sent.send_to) if sent else ():
        if reaches_network(address):
            yield Problem("datagrams" if datagrams else "identity", f'"{address}": {STRANGERS}')


def reaches_network(address: str) -> bool:
    """Whether HOST:PORT, with Zenoh's metadata behind it, is reached from other machines."""
    return not LOOPBACK.fullmatch(re.split("[?#]", address)[0].rpartition(":")[0])
