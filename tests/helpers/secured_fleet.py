"""A fleet of real processes with identities, in formation: TLS between the agents, and a ground with its certificate."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from math import dist
from pathlib import Path

from commanding_ground import Ground
from companion.ground.session import FleetSession
from companion.link.own_identity import load
from companion.security.identity import Identity
from companion.security.names import parse_common_name
from companion.security.provisioning import provision_new
from fleet_ports import free_fleet_offset
from repository import ROOT
from sitl.flight.files import truth_path, write_files
from sitl.flight.processes.fleet import Fleet
from sitl.flight.scenario import Scenario, load_scenario
from sitl.links.ports import ports_of

IDS = (1, 2, 3, 4)
LEADER, FOLLOWERS = 1, (2, 3, 4)
OTHERS = ("ground-anna", "ground-ben", "monitor-tower", "target-main", "traffic-adsb")
OVERRIDES = (
    "fleet.law.name=cooperative",
    "fleet.takeoff_height_m=2.0",
    "fleet.separation_m=1.0",
    "reference={kind: circle, centre_enu_m: [-6.0, 0.0, 2.0], radius_m: 6.0, period_s: 30.0}",
)


@dataclass(frozen=True)
class SecuredFleet:
    """A flying fleet. `keys` is the provisioned folder."""

    scenario: Scenario
    folder: Path
    keys: Path
    port_offset: int
    session: FleetSession
    ground: Ground

    def identity(self, name: str) -> Identity:
        return load(self.identity_folder(name), {})

    def identity_folder(self, name: str) -> Path:
        return self.keys / "copy" / name / "identity"

    def port(self, vehicle_id: int) -> int:
        return ports_of(vehicle_id, self.port_offset).zenoh

    def endpoints(self, protocol: str = "tls") -> list[str]:
        return [f"{protocol}/127.0.0.1:{self.port(i)}" for i in IDS]

    def largest_error_m(self, since_s: float) -> float:
        """Largest true error of a follower's place beside the leader since this time of the monotonic clock."""
        tracks = {i: self._track(i, since_s) for i in IDS}
        slots = {member.id: member.slot_enu_m for member in self.scenario.fleet.vehicles}
        times = set.intersection(*(set(track) for track in tracks.values()))
        assert len(times) > 50, "a second of truth"
        return max(
            dist(_minus(tracks[i][at], tracks[LEADER][at]), _minus(slots[i], slots[LEADER]))
            for i in FOLLOWERS
            for at in times
        )

    def _track(self, vehicle_id: int, since_s: float) -> dict[int, tuple[float, float, float]]:
        lines = truth_path(self.folder, vehicle_id).read_text(encoding="ascii").splitlines(keepends=True)
        return {
            round(float(row["monotonic_s"]) / 0.02): (float(row["x_m"]), float(row["y_m"]), float(row["z_m"]))
            for row in csv.DictReader(line for line in lines if line.endswith("\n"))
            if float(row["monotonic_s"]) > since_s
        }


def _minus(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(p - q for p, q in zip(a, b, strict=True))


def provisioned_copy(folder: Path, keys: Path, age: timedelta = timedelta(0), days: int = 30) -> None:
    """Identities in `keys` for the fleet whose files are in `folder`."""
    keys.mkdir()
    (keys / "fleet.yaml").write_bytes((folder / "fleet.yaml").read_bytes())
    for i in IDS:
        (keys / f"vehicle-{i}.yaml").write_bytes((folder / f"vehicle_{i}.yaml").read_bytes())
    names = [parse_common_name(name) for name in OTHERS]
    provision_new(keys, names, names[0], days, datetime.now(UTC) - age)


@contextmanager
def secured_fleet(folder: Path) -> Iterator[SecuredFleet]:
    """The processes of a fleet in formation, ended with the block."""
    scenario = load_scenario(ROOT / "config" / "scenarios" / "platoon.yaml", OVERRIDES)
    offset, keys = free_fleet_offset(), folder / "keys"
    write_files(scenario, folder, offset)
    provisioned_copy(folder, keys)
    for i in IDS:
        file = folder / f"vehicle_{i}.yaml"
        text = file.read_text(encoding="utf-8")
        assert "identity: null" in text
        file.write_text(text.replace("identity: null", f"identity: keys/copy/vehicle-{i}/identity"), encoding="utf-8")
    endpoints = [f"tls/127.0.0.1:{ports_of(i, offset).zenoh}" for i in IDS]
    with (
        Fleet.start_written(scenario, folder, offset),
        FleetSession("*", endpoints, identity=load(keys / "copy" / "ground-anna" / "identity", {})) as session,
    ):
        fleet = SecuredFleet(scenario, folder, keys, offset, session, Ground(session))
        fleet.ground.listen(0.5)
        fleet.ground.fly_to_formation(IDS)
        fleet.ground.listen(3.0)
        yield fleet
