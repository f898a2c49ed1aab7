"""`companion init`: the fleet file and the vehicle files of real vehicles, which agree with each other."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from ipaddress import IPv4Address, ip_network
from pathlib import Path
from typing import Literal

from msgspec import Struct
from msgspec.structs import replace

from companion.config.file import ConfigError, convert, refuse
from companion.config.fleet import GeodeticOrigin
from companion.config.new_formation import (
    NewFormation,
    PlannedFormation,
    ProblemsOf,
    add_comment,
    check_choices,
    inline,
    planned_formation,
    settings_lines,
    vehicle_lines,
    write_new,
)
from companion.config.validation import Problem
from companion.config.vehicle import load_agent, reaches_network
from companion.types.autopilot import AutopilotKind
from companion.types.values import quoted

ZENOH_PORT, MULTICAST_PORT = 7447, 7446
SEGMENT_BITS = 24  # addresses with so many equal bits are taken to be in one network segment
ID_IN_PATTERN = re.compile(r"\{id(?:\+(\d{1,5}))?\}")
LAND_AFTER_S = 60.0
GPS_SEPARATION_M, GPS_SEPARATION_OF_SPACING = 2.5, 0.5  # ordinary GPS is off by a metre, of two vehicles each
NEXT = """\
wrote {files} in {folder}
{states}
next:
  1. In fleet.yaml check origin, fence, slots and separation_m; in each vehicle file mavlink and hover_thrust_norm.
  2. companion analyze {folder}/fleet.yaml
{then}"""
SECURED = """\
  3. companion provision new {folder}
     It makes the keys of vehicles and ground, and says what to copy to each of them.
"""
OPEN = """\
  3. Copy fleet.yaml and its own file to each vehicle:
{copies}
  4. On each vehicle: companion doctor --config /etc/companion/vehicle-ID.yaml
     then:            systemctl enable --now companion@ID
  5. On the ground:   companion fleet use {folder}/fleet.yaml && companion monitor
"""


class StatesWay(Struct, frozen=True):
    """How the vehicles exchange their states: the multicast group, None for Zenoh, and why."""

    multicast: str | None
    why: str

    @property
    def line(self) -> str:
        """Which way was chosen, and how to change it."""
        if self.multicast:
            return f"states: datagrams to {self.multicast}, as {self.why}; over Zenoh without multicast in fleet.yaml"
        return f"states: over Zenoh, as {self.why}; multicast in fleet.yaml makes them datagrams (docs/transports.md)"


class NewFleet(Struct, frozen=True, kw_only=True):
    """The choices for real vehicles. `addresses` and `mavlink`: one for each vehicle, or one pattern with {id} or {id+N}.

    `hover_parameters` are the names of the parameter with the hover thrust.
    """

    formation: NewFormation
    origin: GeodeticOrigin | Literal["indoor"]
    addresses: Sequence[str]
    mavlink: Sequence[str]
    hover_thrust_norm: float
    autopilot: AutopilotKind | None = None
    security: Literal["none"] | None = None
    hover_parameters: Mapping[AutopilotKind, str]

    def needs_identities(self, addresses: Mapping[int, str]) -> bool:
        """Where strangers could reach the vehicles, and the choice is not to let them."""
        return self.security is None and any(reaches_network(address) for address in addresses.values())


def new_fleet(new: NewFleet, folder: Path, problems_of: ProblemsOf) -> str:
    """Writes fleet.yaml and vehicle-N.yaml, checks them by loading them, returns what to do next. Raises ConfigError."""
    check_choices(new.formation, "companion init")
    addresses = _addresses(new)
    mavlink = _per_vehicle(new.mavlink, new.formation.vehicles, "--mavlink")
    way = states_way(addresses.values())
    planned = _in_network(planned_formation(new.formation, problems_of, new.origin), addresses, new.security, way)
    planned = replace(planned, fleet=replace(planned.fleet, separation_m=_separation_m(new, planned)))
    secured = new.needs_identities(addresses)
    vehicles = {folder / f"vehicle-{i}.yaml": vehicle_text(new, planned, i, mavlink[i - 1], secured) for i in addresses}
    texts = {folder / "fleet.yaml": fleet_text(new, planned, way)} | vehicles
    write_new(texts, check=lambda: [load_agent(path) for path in vehicles])
    return _next_steps(folder, addresses, secured, way)


def states_way(addresses: Collection[str]) -> StatesWay:
    """Datagrams where the addresses, HOST:PORT, are in one segment of a local network: nothing passes multicast on."""
    hosts: list[IPv4Address] = []
    for address in addresses:
        name = address.rpartition(":")[0]
        try:
            hosts.append(IPv4Address(name))
        except ValueError:
            return StatesWay(None, f"{quoted(name)} is no IPv4 address")
    if all(host.is_loopback for host in hosts):
        return StatesWay(None, "all vehicles are on one computer")
    segment = ip_network((hosts[0], SEGMENT_BITS), strict=False)
    if not all(host in segment for host in hosts):
        return StatesWay(None, f"not all addresses are in {segment}, that of vehicle 1")
    if not segment.is_private:  # 100.64.0.0/10 of overlay networks is none either
        return StatesWay(None, f"{segment} is no local network")
    *_, third, last = hosts[0].packed  # a group of its own for each fleet of the segment
    return StatesWay(f"239.255.{third}.{last}:{MULTICAST_PORT}", f"all addresses are in {segment}")


def _in_network(
    planned: PlannedFormation, addresses: Mapping[int, str], security: Literal["none"] | None, way: StatesWay
) -> PlannedFormation:
    """The plan with the address of each vehicle, its security and the way of its states."""
    members = tuple(replace(member, address=addresses[member.id]) for member in planned.fleet.vehicles)
    fleet = replace(planned.fleet, vehicles=members, security=security, multicast=way.multicast)
    return replace(planned, fleet=fleet)


def _separation_m(new: NewFleet, planned: PlannedFormation) -> float:
    """Of the plan, which is that of a simulation; outdoors more, for the errors of GPS."""
    if new.origin == "indoor":
        return planned.fleet.separation_m
    return round(min(GPS_SEPARATION_M, GPS_SEPARATION_OF_SPACING * new.formation.spacing_m), 2)


def fleet_text(new: NewFleet, planned: PlannedFormation, way: StatesWay) -> str:
    """The whole fleet file."""
    fleet = planned.fleet
    outdoors = new.origin != "indoor"
    slots = "slots are offsets from the reference: x east, y north, z up; addresses in the fleet's network"
    lines = (
        "# The settings that all vehicles share. Every vehicle needs the same file: its hash is part of every packet.",
        "# Lengths are in metres in the fleet frame, ENU: x east, y north, z up from the origin.",
        add_comment(f"name: {fleet.name}", "name of the fleet on the network"),
        add_comment(f"origin: {inline(fleet.origin)}", "zero of the fleet frame, on the field"),
        outdoors and add_comment("altitude_source: takeoff", "z is zero where each vehicle is armed: level ground"),
        outdoors and add_comment("ground_spread_m: 3.0", "altitudes by GPS differ by a metre or two"),
        fleet.security
        and add_comment("security: none", "no identities: all who reach the network can command the fleet"),
        way.multicast
        and add_comment(f"multicast: {way.multicast}", f"states as datagrams: {way.why} (docs/transports.md)"),
        add_comment("vehicles:", slots),
        *vehicle_lines(fleet.vehicles),
        *settings_lines(planned, new.formation),
        add_comment(f"  max_tilt_deg: {fleet.envelope.max_tilt_deg:g}", "no setpoint tilts more than this"),
        fleet.successors
        and add_comment(f"successors: {inline(list(fleet.successors))}", "become leader in this order"),
        add_comment(f"land_after_s: {LAND_AFTER_S:g}", "time in hold without a leader, then each vehicle lands"),
        add_comment("leave_below_percent: 25", "with less battery a vehicle leaves the formation and lands"),
    )
    return _text_of(lines)


def vehicle_text(new: NewFleet, planned: PlannedFormation, vehicle_id: int, mavlink: str, secured: bool) -> str:
    """One whole vehicle file."""
    member = planned.fleet.member(vehicle_id)
    leads = member is not None and member.can_lead
    named = new.hover_parameters
    parameters = named[new.autopilot] if new.autopilot else ", ".join(named.values())
    hover = f"hover_thrust_norm: {new.hover_thrust_norm:g}"
    lines = (
        f"# The settings of vehicle {vehicle_id}. Its agent: companion agent --config vehicle-{vehicle_id}.yaml",
        add_comment(f"id: {vehicle_id}", "MAVLink system id of the autopilot (MAV_SYS_ID, SYSID_THISMAV)"),
        add_comment("fleet: fleet.yaml", "relative to this file"),
        add_comment(f"mavlink: {mavlink}", "or udpin:HOST:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD"),
        new.autopilot and add_comment(f"autopilot: {new.autopilot}", "no other is accepted"),
        add_comment(hover, f"initial value ({parameters}); estimated in flight"),
        secured and add_comment("identity: identity", "folder beside this file, from companion provision"),
        leads and "# The trajectory of the formation. Vehicles that may lead hold it, all of them the same.",
        leads and f"reference: {inline(planned.reference)}",
    )
    return _text_of(lines)


def _text_of(lines: Iterable[object]) -> str:
    """A file of these lines, without those that a condition before them leaves out."""
    return "".join(f"{line}\n" for line in lines if line)


def _next_steps(folder: Path, addresses: Mapping[int, str], secured: bool, way: StatesWay) -> str:
    copies = "\n".join(
        f"     scp {folder / 'fleet.yaml'} {folder / f'vehicle-{i}.yaml'} {address.rpartition(':')[0]}:/etc/companion/"
        for i, address in addresses.items()
    )
    files = f"fleet.yaml and vehicle-1.yaml to vehicle-{len(addresses)}.yaml"
    then = (SECURED if secured else OPEN).format(folder=folder, copies=copies)
    return NEXT.format(files=files, folder=folder, states=way.line, then=then)


def _addresses(new: NewFleet) -> dict[int, str]:
    """HOST:PORT of each vehicle by id. Raises ConfigError for what is no address, or used twice."""
    addresses: dict[int, str] = {}
    problems = []
    for vehicle_id, given in enumerate(_per_vehicle(new.addresses, new.formation.vehicles, "--address"), start=1):
        found = re.fullmatch(r"([A-Za-z0-9._-]+)(?::(\d{1,5}))?", given)
        if not found or not 0 < int(found[2] or ZENOH_PORT) < 65536:
            problems.append(Problem("--address", f"{quoted(given)}: expected HOST or HOST:PORT"))
            continue
        address = f"{found[1]}:{int(found[2] or ZENOH_PORT)}"
        if address in addresses.values():
            hint = "give each vehicle its own, or a pattern with {id}"
            problems.append(Problem("--address", f"{quoted(given)}: is that of two vehicles; {hint}"))
        addresses[vehicle_id] = address
    refuse("companion init", dict.fromkeys(problems))
    return addresses


def _per_vehicle(values: Sequence[str], count: int, option: str) -> list[str]:
    """One value for each vehicle: as given, or by the pattern. Raises ConfigError."""
    if len(values) == 1:
        fill = ID_IN_PATTERN.sub
        return [fill(lambda id_: str(i + int(id_[1] or 0)), values[0]) for i in range(1, count + 1)]  # noqa: B023
    if len(values) != count:
        expected = "one for each, or one pattern like 192.168.10.{id+10}"
        raise ConfigError("companion init", option, f"{len(values)} given for {count} vehicles; expected {expected}")
    return list(values)


def origin_of(words: Sequence[str]) -> GeodeticOrigin | Literal["indoor"]:
    """The origin from the words of a command line. Raises ConfigError."""
    if list(words) == ["indoor"]:
        return "indoor"
    try:
        latitude_deg, longitude_deg, altitude_amsl_m = map(float, words)
    except ValueError:
        text = f"{' '.join(words)}: expected LATITUDE LONGITUDE ALTITUDE_AMSL in degrees and metres, or indoor"
        raise ConfigError("companion init", "--origin", text) from None
    given = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "altitude_amsl_m": altitude_amsl_m}
    return convert(Path("companion init --origin"), given, GeodeticOrigin)
