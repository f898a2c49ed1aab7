"""The file of `companion mocap`: which camera system there is, its axes, and which body is which vehicle."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from companion.config.file import ConfigError, convert, read_yaml
from companion.config.fleet import FleetConfig
from companion.config.fleet_check import load_fleet
from companion.config.validation import Problem, each
from companion.config.values import Section, Text, VehicleId, written
from companion.geometry.capture_axes import CaptureAxes, CaptureAxis, UpAxis

Host = Annotated[str, written(r"^[A-Za-z0-9._-]+$", "an IPv4 address or a name, like 192.168.1.5")]


class MocapFile(Section, frozen=True, kw_only=True):
    """A camera system and its rigid bodies.

    fleet: the fleet file, relative to this file
    system: `natnet`: OptiTrack, read by the package natnet, on every machine; `optitrack`, `vicon`, `qualisys`, `vrpn`:
        read by the package motioncapture, which exists for amd64 only
    host: the computer of the camera system
    port: its command port; without a value the usual one
    up: the axis of the capture frame that points up
    forward: the axis of the capture frame that points to the fleet's x, east; of each body it is the nose
    turn_deg: angle from east to `forward`, counterclockwise from above, for a capture frame that stands askew
    bodies: the vehicle of each rigid body, by its name in the camera system
    rate_hz: largest number of poses per second and vehicle; without a value each frame is published
    latency_s: age of a frame when it arrives, for systems that do not report it
    """

    fleet: Text
    system: Literal["natnet", "optitrack", "vicon", "qualisys", "vrpn"]
    host: Host
    port: Annotated[int, Meta(ge=1, le=65_535)] | None = None
    up: UpAxis
    forward: CaptureAxis
    turn_deg: Annotated[float, Meta(ge=-180, le=180)] = 0.0
    bodies: Annotated[dict[Text, VehicleId], Meta(min_length=1, max_length=250)]
    rate_hz: Annotated[float, Meta(ge=10, le=1000)] | None = None
    latency_s: Annotated[float, Meta(ge=0, le=0.5)] = 0.0

    @property
    def axes(self) -> CaptureAxes:
        return CaptureAxes.of(self.up, self.forward, self.turn_deg)


def load_mocap(path: Path) -> tuple[MocapFile, FleetConfig, Path]:
    """The file, and the fleet that it names with its path. Raises ConfigError."""
    file = convert(path, read_yaml(path), MocapFile, lambda read: each(_axes(read), _ids(read)))
    fleet_path = path.parent / file.fleet
    if not fleet_path.is_file():
        where = f"looked for {fleet_path}; the path is relative to this file"
        raise ConfigError(path, "fleet", f'"{file.fleet}": no such file; {where}')
    fleet = load_fleet(fleet_path)
    if fleet.origin != "indoor":
        raise ConfigError(fleet_path, "origin", "expected indoor, where the capture frame is that of the fleet")
    for name, vehicle_id in file.bodies.items():
        if fleet.member(vehicle_id) is None:
            known = ", ".join(str(member.id) for member in fleet.vehicles)
            raise ConfigError(path, f"bodies.{name}", f"{vehicle_id}: no such vehicle in {fleet_path}; it has {known}")
    return file, fleet, fleet_path


def _axes(file: MocapFile) -> Iterator[Problem]:
    if file.forward.removeprefix("-") == file.up:
        yield Problem("forward", f"{file.forward}: expected another axis than that of up, {file.up}")


def _ids(file: MocapFile) -> Iterator[Problem]:
    owners: dict[int, str] = {}
    for name, vehicle_id in file.bodies.items():
        if vehicle_id in owners:
            yield Problem(
                f"bodies.{name}", f"{vehicle_id} is the vehicle of {owners[vehicle_id]} already; give each its own"
            )
        owners.setdefault(vehicle_id, name)
