"""A vehicle file: the settings of one vehicle, and where its agent listens and connects.

It names its fleet file; that of a vehicle that may lead has a reference.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from companion.config.file import ConfigError, convert, read_as
from companion.config.fleet import FleetConfig, FormationMember
from companion.config.fleet_check import load_fleet
from companion.config.named_files import read_named
from companion.config.reference import Reference
from companion.config.reference_check import reference_problems
from companion.config.validation import Problem, each
from companion.config.values import (
    Drag,
    HoverThrust,
    NetworkAddress,
    Section,
    Text,
    VehicleId,
    about,
    is_multicast,
    written,
)
from companion.types.autopilot import AutopilotKind
from companion.types.flight import Role

LOOPBACK = re.compile(r"localhost|127(\.\d{1,3}){3}|\[?::1\]?")
STRANGERS = (
    "strangers who reach it could command the vehicle; expected an identity (companion provision), or security: none in"
    " the fleet file, or an address of this machine alone, like 127.0.0.1"
)


class ZenohEndpoints(Section, frozen=True):
    """Endpoints of the vehicle's Zenoh session, like `tcp/192.168.1.11:7447`. Multicast scouting is off.

    listen: endpoints where the agent accepts connections
    connect: endpoints of other vehicles, tried until they answer
    """

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()


class DatagramEndpoints(Section, frozen=True):
    """Peer states as UDP datagrams instead of over Zenoh, for radio links that lose packets; the same in all vehicles.

    listen: address and port where the agent receives, like `0.0.0.0:7447`
    send_to: where the other vehicles listen; one broadcast address reaches them all
    """

    listen: NetworkAddress
    send_to: Annotated[tuple[NetworkAddress, ...], Meta(min_length=1)]


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
        on_loopback = sent is not None and not reaches_network(sent.listen) and is_multicast(address)
        if reaches_network(address) and not on_loopback:
            yield Problem("datagrams" if datagrams else "identity", f'"{address}": {STRANGERS}')


def reaches_network(address: str) -> bool:
    """Whether HOST:PORT, with Zenoh's metadata behind it, is reached from other machines."""
    return not LOOPBACK.fullmatch(re.split("[?#]", address)[0].rpartition(":")[0])


CredentialName = Annotated[str, written("^[A-Za-z0-9_.-]+$", "a name of letters, digits, _, . and -")]


class Signing(Section, frozen=True):
    """MAVLink 2 signing between agent and autopilot, which needs the same key: one of `key_file` and `credential`.

    key_file: file of the key; the path is relative to the vehicle file
    credential: name of the systemd credential with the key (LoadCredential)
    link_id: link id of the signed packets
    """

    key_file: str | None = None
    credential: CredentialName | None = None
    link_id: Annotated[int, Meta(ge=0, le=255)] = 0


class RecordingSettings(Section, frozen=True):
    """What the agent records of each flight, and how much of the disk that may use.

    enabled: `false`: nothing is recorded
    folder: folder of the recordings, relative to the vehicle file; without it `recordings` in the state folder of the
        systemd unit, and without a unit nothing is recorded
    keep_mb: what all files in the folder may use; the oldest flights are removed first
    part_mb: size at which another file is begun
    tlog: `true`: also a `.tlog` of the raw MAVLink in both directions, some 0.8 MB a minute
    """

    enabled: bool = True
    folder: Text | None = None
    keep_mb: Annotated[int, Meta(ge=2, le=1_000_000)] = 2000
    part_mb: Annotated[int, Meta(ge=1, le=100_000)] = 50
    tlog: bool = False


MAVLINK_FORMAT = "udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD, like serial:/dev/ttyAMA0:921600"
MavlinkEndpoint = Annotated[
    str,
    written("^(udpin|tcp|serial):.+:[0-9]+$", MAVLINK_FORMAT),
    about(
        "MAVLink endpoint of the autopilot: `udpin:HOST:PORT` (listen), `tcp:HOST:PORT` (connect) or"
        " `serial:DEVICE:BAUD`"
    ),
]


class VehicleConfig(Section, frozen=True):
    """Settings of one vehicle.

    fleet: path of the fleet file, relative to the vehicle file
    hover_thrust_norm: initial hover thrust (PX4: MPC_THR_HOVER, ArduPilot: MOT_THST_HOVER); estimated in flight
    drag_1_s: linear drag over mass, which damps the vehicle; a leader feeds it forward along its reference; 0.25 is
        that of a small open quadrotor
    autopilot: required autopilot; without a value the one of its HEARTBEAT
    accept_uncontrolled_descent: `true`: formation also where the vehicle sinks when the setpoints end (PX4:
        `COM_OBL_RC_ACT` 0 to 2), as a pilot stands by
    identity: folder of the vehicle's certificate, made by `companion provision`; the path is relative to the vehicle
        file
    zenoh: instead of the addresses in the fleet file, for networks with translation
    datagrams: instead of `multicast` of the fleet file: one address for each vehicle
    reference: the trajectory of the formation (RFT): required for a vehicle that may lead, refused for others
    ground_station: `udpout:HOST:PORT` to which the autopilot's MAVLink is forwarded
    """

    id: VehicleId
    fleet: str
    mavlink: MavlinkEndpoint
    hover_thrust_norm: HoverThrust
    drag_1_s: Drag = 0.25
    autopilot: AutopilotKind | None = None
    accept_uncontrolled_descent: bool = False
    identity: Text | None = None
    zenoh: ZenohEndpoints | None = None
    datagrams: DatagramEndpoints | None = None
    reference: Reference | None = None
    signing: Signing | None = None
    recording: RecordingSettings = RecordingSettings()
    ground_station: Annotated[
        str, written("^(udpout:.+:[0-9]{1,9})?$", "udpout:HOST:PORT, like udpout:192.168.1.50:14550")
    ] = ""


@dataclass(frozen=True, slots=True)
class AgentConfig:
    """A vehicle file together with its fleet file, checked against each other."""

    vehicle: VehicleConfig
    fleet: FleetConfig
    member: FormationMember

    @property
    def zenoh(self) -> ZenohEndpoints:
        """Those of the vehicle file; without them by the addresses of the fleet file."""
        secured = self.vehicle.identity is not None
        return self.vehicle.zenoh or endpoints_of(self.fleet, self.vehicle.id, secured)

    @property
    def datagrams(self) -> DatagramEndpoints | None:
        """Those of the vehicle file; without them the multicast of the fleet file, if it has any."""
        return self.vehicle.datagrams or datagrams_of(self.fleet, self.vehicle.id)


def load_agent(path: Path) -> AgentConfig:
    """Read a vehicle file and the fleet file that it names. Raises ConfigError with the errors of both."""
    fleets: list[FleetConfig] = []
    errors: list[ConfigError] = []

    def problems(vehicle: VehicleConfig) -> Iterator[Problem]:
        yield from each(_signing_problems(vehicle))
        yield from each(_recording_problems(vehicle.recording))
        fleet_path = path.parent / vehicle.fleet
        if not fleet_path.is_file():
            where = f"looked for {fleet_path}; the path is relative to the vehicle file"
            yield Problem("fleet", f'"{vehicle.fleet}": no such file; {where}')
            return
        try:
            fleets.append(load_fleet(fleet_path))
        except ConfigError as error:
            errors.append(error)
        else:
            yield from membership_problems(vehicle, fleets[0], fleet_path)
            secured = vehicle.identity is not None
            yield from each(network_problems(fleets[0], vehicle.id, vehicle.zenoh, vehicle.datagrams, secured))

    try:
        vehicle = convert(path, read_named(read_as(path, "vehicle"), path), VehicleConfig, problems)
    except ConfigError as error:
        errors.insert(0, error)
    if errors:
        raise ConfigError.of(errors)
    member = fleets[0].member(vehicle.id)
    assert member is not None, "a vehicle without a slot is a problem of its file"
    return AgentConfig(vehicle, fleets[0], member)


def _signing_problems(vehicle: VehicleConfig) -> Iterator[Problem]:
    signing = vehicle.signing
    if signing is not None and (signing.key_file is None) == (signing.credential is None):
        yield Problem("signing", "expected one of key_file and credential, where the key is")


def _recording_problems(recording: RecordingSettings) -> Iterator[Problem]:
    if recording.keep_mb < 2 * recording.part_mb:
        expected = f"at least {2 * recording.part_mb}, twice part_mb"
        yield Problem("recording.keep_mb", f"{recording.keep_mb}; expected {expected}")


def membership_problems(vehicle: VehicleConfig, fleet: FleetConfig, fleet_path: Path) -> Iterator[Problem]:
    """The vehicle must have a slot in its fleet, and a reference exactly if it may lead."""
    member = fleet.member(vehicle.id)
    if member is None:
        ids = ", ".join(str(m.id) for m in fleet.vehicles)
        yield Problem("id", f"{vehicle.id} has no slot in {fleet_path}; expected one of {ids}")
    elif member.can_lead and vehicle.reference is None:
        leads = "leads" if member.role is Role.LEADER else "may lead"
        yield Problem("reference", f"missing; vehicle {vehicle.id} {leads} and needs the reference trajectory (RFT)")
    elif not member.can_lead and vehicle.reference is not None:
        yield Problem(
            "reference",
            f"vehicle {vehicle.id} follows; only a vehicle that may lead holds the RFT, take this section out"
            f" (or set may_lead: true in {fleet_path})",
        )
    if vehicle.reference is not None:
        yield from each(reference_problems(fleet, vehicle.reference))
