"""`companion init`: the fleet file and the vehicle files of real vehicles, which agree with each other."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from msgspec import Struct

from companion.config.file import ConfigError, convert, refuse
from companion.config.fleet import GeodeticOrigin
from companion.config.new_formation import (
    NewFormation,
    PlannedFormation,
    ProblemsOf,
    check_choices,
    commented,
    inline,
    planned_formation,
    settings_lines,
    vehicle_lines,
    write_new,
)
from companion.config.validation import Problem
from companion.config.vehicle import load_agent
from companion.types.autopilot import AutopilotKind

ZENOH_PORT = 7447
LOOPBACK = ("127.0.0.1", "localhost")
ID_IN_PATTERN = re.compile(r"\{id(?:\+(\d{1,5}))?\}")
HOVER_PARAMETER = {AutopilotKind.PX4: "MPC_THR_HOVER", AutopilotKind.ARDUPILOT: "MOT_THST_HOVER"}
LAND_AFTER_S = 60.0
NEXT = """\
wrote {files} in {folder}
next:
  1. In fleet.yaml check origin, fence and slots; in each vehicle file mavlink and hover_thrust_norm.
  2. companion analyze {fleet}
  3. Copy fleet.yaml and its own file to each vehicle:
{copies}
  4. On each vehicle: companion doctor --config /etc/companion/vehicle-ID.yaml
     then:            systemctl enable --now companion@ID
  5. On the ground:   companion monitor --connect {endpoint}
"""


class NewFleet(Struct, frozen=True, kw_only=True):
    """The choices for real vehicles. `addresses` and `mavlink`: one for each vehicle, or one pattern with {id} or {id+N}."""

    formation: NewFormation
    origin: GeodeticOrigin | Literal["indoor"]
    addresses: Sequence[str]
    mavlink: Sequence[str]
    hover_thrust_norm: float
    autopilot: AutopilotKind | None = None


class Endpoint(Struct, frozen=True):
    """Where the agent of a vehicle is reached by the other agents."""

    host: str
    port: int

    def to_connect(self) -> str:
        return f"tcp/{self.host}:{self.port}"

    def to_listen(self) -> str:
        return f"tcp/{self.host if self.host in LOOPBACK else '0.0.0.0'}:{self.port}"


def new_fleet(new: NewFleet, folder: Path, problems_of: ProblemsOf) -> str:
    """Writes fleet.yaml and vehicle-N.yaml, checks them by loading them, returns what to do next. Raises ConfigError."""
    check_choices(new.formation, "companion init")
    endpoints = _endpoints(new)
    mavlink = _per_vehicle(new.mavlink, new.formation.vehicles, "--mavlink")
    planned = planned_formation(new.formation, problems_of, new.origin)
    vehicles = {
        folder / f"vehicle-{i}.yaml": vehicle_text(new, planned, i, mavlink[i - 1], endpoints) for i in endpoints
    }
    texts = {folder / "fleet.yaml": fleet_text(new, planned)} | vehicles
    write_new(texts, check=lambda: [load_agent(path) for path in vehicles])
    return _next_steps(folder, endpoints)


def fleet_text(new: NewFleet, planned: PlannedFormation) -> str:
    """The whole fleet file."""
    fleet = planned.fleet
    indoor = new.origin == "indoor"
    successors = [commented(f"successors: {inline(list(fleet.successors))}", "become leader in this order")]
    lines = [
        "# The settings that all vehicles share. Every vehicle needs the same file: its hash is part of every packet.",
        "# Lengths are in metres in the fleet frame, ENU: x east, y north, z up from the origin.",
        commented(f"name: {fleet.name}", "name of the fleet on the network"),
        commented(f"origin: {inline(fleet.origin)}", "zero of the fleet frame, on the field"),
        *(
            []
            if indoor
            else [commented("altitude_source: takeoff", "z is zero where each vehicle is armed: level ground")]
        ),
        *([] if indoor else [commented("ground_spread_m: 3.0", "altitudes by GPS differ by a metre or two")]),
        commented("vehicles:", "the slots are offsets from the reference: x east, y north, z up"),
        *vehicle_lines(fleet.vehicles),
        *settings_lines(planned, new.formation),
        commented(f"  max_tilt_deg: {fleet.envelope.max_tilt_deg:g}", "no setpoint tilts more than this"),
        *(successors if fleet.successors else []),
        commented(f"land_after_s: {LAND_AFTER_S:g}", "time in hold without a leader, then each vehicle lands"),
        commented("leave_below_percent: 25", "with less battery a vehicle leaves the formation and lands"),
    ]
    return "\n".join(lines) + "\n"


def vehicle_text(
    new: NewFleet, planned: PlannedFormation, vehicle_id: int, mavlink: str, endpoints: dict[int, Endpoint]
) -> str:
    """One whole vehicle file. Each agent connects to those with lower ids, so that every pair has one connection."""
    member = planned.fleet.member(vehicle_id)
    leads = member is not None and member.can_lead
    parameters = HOVER_PARAMETER[new.autopilot] if new.autopilot else ", ".join(HOVER_PARAMETER.values())
    others = [endpoint.to_connect() for i, endpoint in endpoints.items() if i < vehicle_id]
    reference = inline(planned.reference)
    lines = [
        f"# The settings of vehicle {vehicle_id}. Its agent: companion agent --config vehicle-{vehicle_id}.yaml",
        commented(f"id: {vehicle_id}", "MAVLink system id of the autopilot (MAV_SYS_ID, SYSID_THISMAV)"),
        commented("fleet: fleet.yaml", "relative to this file"),
        commented(f"mavlink: {mavlink}", "or udpin:HOST:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD"),
        *([commented(f"autopilot: {new.autopilot}", "no other is accepted")] if new.autopilot else []),
        commented(
            f"hover_thrust_norm: {new.hover_thrust_norm:g}",
            f"initial value ({parameters}); estimated in flight",
        ),
        commented("zenoh:", "addresses in the radio network of the fleet"),
        f"  listen: [{endpoints[vehicle_id].to_listen()}]",
        *([commented(f"  connect: [{', '.join(others)}]", "tried until they answer")] if others else []),
        *(
            ["# The trajectory of the formation. Vehicles that may lead hold it, all of them the same."]
            if leads
            else []
        ),
        *([f"reference: {reference}"] if leads else []),
    ]
    return "\n".join(lines) + "\n"


def _next_steps(folder: Path, endpoints: dict[int, Endpoint]) -> str:
    copies = "\n".join(
        f"     scp {folder / 'fleet.yaml'} {folder / f'vehicle-{i}.yaml'} {endpoint.host}:/etc/companion/"
        for i, endpoint in endpoints.items()
    )
    files = f"fleet.yaml and vehicle-1.yaml to vehicle-{len(endpoints)}.yaml"
    fleet = folder / "fleet.yaml"
    return NEXT.format(files=files, folder=folder, fleet=fleet, copies=copies, endpoint=endpoints[1].to_connect())


def _endpoints(new: NewFleet) -> dict[int, Endpoint]:
    """The endpoint of each vehicle by id. Raises ConfigError for what is no address, or used twice."""
    endpoints: dict[int, Endpoint] = {}
    problems = []
    for vehicle_id, address in enumerate(_per_vehicle(new.addresses, new.formation.vehicles, "--address"), start=1):
        found = re.fullmatch(r"([A-Za-z0-9._-]+)(?::(\d{1,5}))?", address)
        if not found or not 0 < int(found[2] or ZENOH_PORT) < 65536:
            problems.append(Problem("--address", f"{address!r}: expected HOST or HOST:PORT"))
            continue
        endpoint = Endpoint(found[1], int(found[2] or ZENOH_PORT))
        if endpoint in endpoints.values():
            hint = "give each vehicle its own, or a pattern with {id}"
            problems.append(Problem("--address", f"{address!r}: is that of two vehicles; {hint}"))
        endpoints[vehicle_id] = endpoint
    refuse("companion init", dict.fromkeys(problems))
    return endpoints


def _filled(pattern: str, vehicle_id: int) -> str:
    return ID_IN_PATTERN.sub(lambda found: str(vehicle_id + int(found[1] or 0)), pattern)


def _per_vehicle(values: Sequence[str], count: int, option: str) -> list[str]:
    """One value for each vehicle: as given, or by the pattern. Raises ConfigError."""
    if len(values) == 1:
        return [_filled(values[0], vehicle_id) for vehicle_id in range(1, count + 1)]
    if len(values) != count:
        text = (
            f"{len(values)} given for {count} vehicles; expected one for each, or one pattern like 192.168.10.{{id+10}}"
        )
        refuse("companion init", [Problem(option, text)])
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
