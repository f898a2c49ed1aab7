"""A fleet of real processes with identities, in formation: TLS between the agents, and a ground with its certificate."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import dist
from pathlib import Path

from commanding_ground import Ground
from companion.config.vehicle import protocol_of
from companion.ground.session import FleetSession
from companion.link.fleet.identity import load
from companion.security.identity import Identity
from own_ports import free_fleet_offset
from repository import ROOT
from sitl.flight.files import truth_path, write_files
from sitl.flight.identities import identity_folder, provision, use_identities
from sitl.flight.processes import FleetProcesses, stand_ins_together
from sitl.flight.scenario import Scenario, load_scenario
from sitl.links.ports import ports_of

IDS = (1, 2, 3, 4)
LEADER, FOLLOWERS = 1, (2, 3, 4)
OTHERS = ("ground-anna", "ground-ben", "monitor-tower", "target-main", "traffic-adsb")
OVERRIDES = (
    "fleet.law.name=cooperative",
    "fleet.takeoff_height_m=2.0",
    "stand_in.armable_after_s=1",
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
    protocol: str  # Zenoh's name: tls or quic
    session: FleetSession
    ground: Ground

    def identity(self, name: str) -> Identity:
        return load(self.identity_folder(name), {})

    def identity_folder(self, name: str) -> Path:
        return identity_folder(self.keys, name)

    def port(self, vehicle_id: int) -> int:
        return ports_of(vehicle_id, self.port_offset).zenoh

    def endpoints(self, protocol: str | None = None) -> list[str]:
        return [f"{protocol or self.protocol}/127.0.0.1:{self.port(i)}" for i in IDS]

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


@contextmanager
def secured_fleet(folder: Path, *overrides: str) -> Iterator[SecuredFleet]:
    """The processes of a fleet in formation, ended with the block. `overrides` are those of the scenario."""
    scenario = load_scenario(ROOT / "config" / "scenarios" / "platoon.yaml", (*OVERRIDES, *overrides))
    protocol = protocol_of(scenario.fleet, secured=True)
    offset, keys = free_fleet_offset(), folder / "keys"
    write_files(scenario, folder, offset)
    provision(scenario, folder, keys, OTHERS)
    use_identities(scenario, folder, keys)
    endpoints = [f"{protocol}/127.0.0.1:{ports_of(i, offset).zenoh}" for i in IDS]
    with (
        FleetProcesses.start_written(scenario, folder, offset, stand_ins_together(scenario)),
        FleetSession("*", endpoints, identity=load(identity_folder(keys, OTHERS[0]), {})) as session,
    ):
        fleet = SecuredFleet(scenario, folder, keys, offset, protocol, session, Ground(session))
        fleet.ground.listen(0.5)
        fleet.ground.fly_to_formation(IDS)
        fleet.ground.listen(3.0)
        yield fleet
