"""A vehicle file: what is one vehicle's own. It names its fleet file; only that of one that may lead holds a reference."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from companion.config.fleet import FleetConfig, FormationMember, load_fleet
from companion.config.kind import read_as
from companion.config.reference import Reference, check_reference
from companion.config.values import Drag, HoverThrust, Section, VehicleId
from companion.config_file import ConfigError, convert
from companion.types import AutopilotKind, Role


class ZenohEndpoints(Section, frozen=True):
    """Explicit endpoints, like "tcp/192.168.1.11:7447". Multicast scouting stays off."""

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()


class Signing(Section, frozen=True):
    """MAVLink 2 signing between agent and autopilot, which needs the same key.

    One of `key_file` (a path, relative to the vehicle file) and `credential` (of the systemd service, by LoadCredential).
    """

    key_file: str | None = None
    credential: (
        Annotated[str, Meta(pattern="^[A-Za-z0-9_.-]+$", description="a name of letters, digits, _, . and -")] | None
    ) = None
    link_id: Annotated[int, Meta(ge=0, le=255)] = 0


MavlinkEndpoint = Annotated[
    str,
    Meta(
        pattern="^(udpin|tcp|serial):.+:[0-9]+$",
        description="udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD, like serial:/dev/ttyAMA0:921600",
    ),
]


class VehicleConfig(Section, frozen=True):
    """What is one vehicle's own.

    `mavlink`: "udpin:HOST:PORT" (listen), "tcp:HOST:PORT" (connect) or "serial:DEVICE:BAUD".
    `fleet`: path of the fleet file, relative to this file.
    `autopilot`: whose manners it must have; where it is left out its HEARTBEAT says so.
    `ground_station`: "udpout:HOST:PORT", where the autopilot's MAVLink is passed on to.
    `hover_thrust_norm` is where the agent begins; it finds the right one in flight, as far as the fleet's law lets it.
    `drag_1_s`: drag per mass and speed, which damps the vehicle and is left to do that. Too low a number takes some of this
    damping away, and the formation swings a little; too high a number adds some. 0.25 is of a small open quadrotor.
    """

    id: VehicleId
    fleet: str
    mavlink: MavlinkEndpoint
    hover_thrust_norm: HoverThrust
    drag_1_s: Drag = 0.25
    autopilot: AutopilotKind | None = None
    zenoh: ZenohEndpoints = ZenohEndpoints()
    reference: Reference | None = None
    signing: Signing | None = None
    ground_station: Annotated[
        str, Meta(pattern="^(udpout:.+:[0-9]{1,9})?$", description="udpout:HOST:PORT, like udpout:192.168.1.50:14550")
    ] = ""


@dataclass(frozen=True, slots=True)
class AgentConfig:
    """A vehicle file together with its fleet file, checked against each other."""

    vehicle: VehicleConfig
    fleet: FleetConfig
    member: FormationMember


def load_agent(path: Path) -> AgentConfig:
    """Read a vehicle file and the fleet file that it names. Raises ConfigError."""
    vehicle = convert(path, read_as(path, "vehicle"), VehicleConfig)
    _check_signing(path, vehicle.signing)
    fleet_path = path.parent / vehicle.fleet
    if not fleet_path.is_file():
        where = f"looked for {fleet_path}; the path is relative to the vehicle file"
        raise ConfigError(path, "fleet", f'"{vehicle.fleet}": no such file; {where}')
    fleet = load_fleet(fleet_path)
    member = fleet.member(vehicle.id)
    if member is None:
        ids = ", ".join(str(m.id) for m in fleet.vehicles)
        raise ConfigError(path, "id", f"{vehicle.id} has no slot in {fleet_path}; expected one of {ids}")
    if member.can_lead and vehicle.reference is None:
        leads = "leads" if member.role is Role.LEADER else "may lead"
        raise ConfigError(
            path, "reference", f"missing; vehicle {vehicle.id} {leads} and needs the reference trajectory (RFT)"
        )
    if not member.can_lead and vehicle.reference is not None:
        raise ConfigError(
            path,
            "reference",
            f"vehicle {vehicle.id} follows; only a leader may know the RFT, take this section out"
            f" (or let it lead: may_lead: true in {fleet_path})",
        )
    if vehicle.reference is not None:
        check_reference(path, fleet, vehicle.reference)
    return AgentConfig(vehicle, fleet, member)


def _check_signing(file: Path, signing: Signing | None) -> None:
    if signing is not None and (signing.key_file is None) == (signing.credential is None):
        raise ConfigError(file, "signing", "expected one of key_file and credential, where the key is")
