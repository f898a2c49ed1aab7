"""Status reports of many vehicles in formation over real Zenoh, without vehicles: a load for `companion monitor`.

`python -m tests.bench.monitor_load --vehicles 50 --port 7448` publishes until Ctrl-C. The reports are those of a fleet in
formation on a circle; batteries run down, so that alarms come in time.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from math import dist, pi, sin
from pathlib import Path

import msgspec
import yaml
import zenoh

from companion.analysis.response import settled_prcs
from companion.config.fleet import FleetConfig
from companion.config.new_formation import NewFormation, planned_formation
from companion.config.planned_flight import neighbour_graph
from companion.config.reference import Reference
from companion.laws import neighbour_weights
from companion.link.fleet.zenoh_session import EndpointError, open_session
from companion.types.autopilot import LandedState, PositionError
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.formation import FlownSlot, HeldReference, LeaderBeacon
from companion.types.notices import Code, Notice
from companion.types.status import (
    AgentIdentity,
    AutopilotReport,
    ControlReport,
    FormationReport,
    LeadershipReport,
    MotionReport,
    NearestVehicle,
    NeighbourReport,
    SafetyReport,
    SeparationReport,
    Status,
)
from companion.types.values import Vector3
from companion.wire.keys import status_key
from companion.wire.messages import Percentiles, StatusReport, Timing, encode

SPACING_M = 6.0
OFF_SLOT_M, SWAY_S = 0.3, 7.0  # how far, and with which period, a vehicle moves about its slot
FULL_PERCENT, LAST_PERCENT, PERCENT_PER_S = 95.0, 35.0, 1.0 / 15.0
LOW_PERCENT = 25.0
EVENT_EVERY_S = 60.0
TIMING = Timing(50.0, 0, 0, Percentiles(210.0, 640.0, 1900.0), Percentiles(1400.0, 2900.0, 5200.0), 21.0, 41.0)


class SteadyFleet:
    """The reports of a fleet in formation at any time since its start, s."""

    def __init__(self, fleet: FleetConfig, reference: Reference) -> None:
        self.fleet = fleet
        self._curve = reference.curve()
        self._slots = {member.id: member.slot_enu_m for member in fleet.vehicles}
        self._leader_id = next(member.id for member in fleet.vehicles if member.role is Role.LEADER)
        self._graph = neighbour_graph(fleet.neighbours, self._slots)
        self._prcs = settled_prcs(self._graph, {self._leader_id})
        self._hash = fleet.formation_hash()
        self._nearest = {i: self._nearest_id(i) for i in self._slots}

    def _nearest_id(self, vehicle_id: int) -> int | None:
        others = (i for i in self._slots if i != vehicle_id)
        return min(others, key=lambda i: dist(self._slots[i], self._slots[vehicle_id]), default=None)

    @property
    def vehicle_ids(self) -> list[int]:
        return sorted(self._slots)

    def _position_enu_m(self, vehicle_id: int, time_s: float) -> Vector3:
        (x, y, z), (dx, dy, dz) = self._curve(time_s)[0], self._slots[vehicle_id]
        angle = 2.0 * pi * time_s / SWAY_S + vehicle_id
        return (x + dx + OFF_SLOT_M * sin(angle), y + dy + OFF_SLOT_M * sin(0.7 * angle), z + dz + 0.1 * sin(angle))

    def report(self, vehicle_id: int, time_s: float) -> StatusReport:
        """The report of a vehicle. Its battery begins with less charge the higher its id is."""
        neighbours, prcs = sorted(self._graph[vehicle_id]), self._prcs
        leads = vehicle_id == self._leader_id
        share = (vehicle_id - 1) / max(1, len(self._slots) - 1)
        battery = max(0.0, FULL_PERCENT - share * (FULL_PERCENT - LAST_PERCENT) - PERCENT_PER_S * time_s)
        (reference_enu_m, velocity_enu_m_s, _), beacon_age_s = self._curve(time_s), 0.02 * (prcs[vehicle_id] - 1)
        events = int((time_s + vehicle_id) / EVENT_EVERY_S)
        status = Status(
            agent=AgentIdentity(
                vehicle_id=vehicle_id,
                session=1,
                fleet=self.fleet.name,
                formation_hash=self._hash,
                law=self.fleet.law.name,
            ),
            phase=FlightPhase.FORMATION,
            autopilot=AutopilotReport(
                mode_name="OFFBOARD", armed=True, landed=LandedState.IN_AIR, battery_percent=battery
            ),
            motion=MotionReport(
                position_enu_m=self._position_enu_m(vehicle_id, time_s),
                velocity_enu_m_s=velocity_enu_m_s,
                state_age_s=0.012,
                position_error=PositionError(0.3, 0.5),
            ),
            control=ControlReport(hover_thrust_norm=0.5, disturbance_enu_m_s2=(0.4 * sin(time_s / 10.0), 0.2, 0.0)),
            leadership=LeadershipReport(
                role=Role.LEADER if leads else Role.FOLLOWER,
                epoch=0,
                prc=prcs[vehicle_id],
                leader_beacon=LeaderBeacon(self._leader_id, 0, int(time_s * 1000.0), time_s),
                leader_beacon_age_s=beacon_age_s,
            ),
            neighbourhood=NeighbourReport(
                neighbours=tuple(neighbours),
                peers=tuple(i for i in self.vehicle_ids if i != vehicle_id),
                weights=neighbour_weights(tuple([prcs[j] for j in neighbours])),
                neighbour_ages_s=tuple(0.015 + 0.01 * sin(time_s + j) for j in neighbours),
            ),
            formation=FormationReport(
                slot=FlownSlot(self._slots[vehicle_id]),
                reference_enu_m=reference_enu_m if leads else None,
                reference_s=time_s,
                reference=HeldReference(),
            ),
            safety=SafetyReport(
                flags=(HealthFlag.BATTERY_LOW,) if battery < LOW_PERCENT else (),
                separation=SeparationReport(self._nearest_vehicle(vehicle_id, time_s)),
            ),
            rejected={},
            last_event=Notice(Code.POSITION_RESET, f"position reset {events} followed") if events else None,
        )
        return StatusReport(status, TIMING)

    def _nearest_vehicle(self, vehicle_id: int, time_s: float) -> NearestVehicle | None:
        if (other_id := self._nearest[vehicle_id]) is None:
            return None
        apart_m = dist(self._position_enu_m(vehicle_id, time_s), self._position_enu_m(other_id, time_s))
        return NearestVehicle(str(other_id), apart_m, self.fleet.separation_m + 0.8)


def steady_fleet(name: str, vehicles: int) -> SteadyFleet:
    """Vehicles in a square grid, each a neighbour of the two nearest with lower ids, led by vehicle 1 on a circle."""
    new = NewFormation(
        name=name,
        vehicles=vehicles,
        shape="grid",
        spacing_m=SPACING_M,
        topology="double",
        reference="circle",
        height_m=10.0,
    )
    planned = planned_formation(new, lambda _fleet, _reference: ())
    return SteadyFleet(planned.fleet, planned.reference)


def publish(load: SteadyFleet, rate_hz: float, session: zenoh.Session) -> Iterator[int]:
    """Publishes without end; yields the number of reports after each. The vehicles report one after another, evenly."""
    publishers = {
        i: session.declare_publisher(
            status_key(load.fleet.name, i),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA,
        )
        for i in load.vehicle_ids
    }
    begin_s, number, every_s = time.monotonic(), 0, 1.0 / (rate_hz * len(publishers))
    while True:
        for i, publisher in publishers.items():
            due_s = begin_s + number * every_s
            time.sleep(max(0.0, due_s - time.monotonic()))
            publisher.put(encode(load.report(i, time.monotonic() - begin_s)))
            number += 1
            yield number


def write_fleet(fleet: FleetConfig, file: Path) -> None:
    """The fleet file of these vehicles, for the map of the monitor."""
    content = msgspec.to_builtins(fleet)
    file.write_text(yaml.safe_dump(content, sort_keys=False, default_flow_style=None), encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0 after Ctrl-C, 2 for an argument that cannot be used."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.monitor_load", description=__doc__.partition("\n")[0])
    parser.add_argument("--vehicles", type=int, default=50, metavar="N", help="1 to 100 (default 50)")
    parser.add_argument("--port", type=int, default=7448, metavar="PORT", help="listens on 127.0.0.1 (default 7448)")
    parser.add_argument("--rate", type=float, default=10.0, metavar="HZ", help="reports of each vehicle (default 10)")
    parser.add_argument("--fleet", default="load", metavar="NAME", help="name of the fleet (default load)")
    parser.add_argument("--write-fleet", type=Path, metavar="FILE", help="also write the fleet file, for the map")
    options = parser.parse_args(arguments)
    if not (1 <= options.vehicles <= 100 and 0.1 <= options.rate <= 100.0):
        parser.error("expected 1 to 100 vehicles and 0.1 to 100 Hz")
    load = steady_fleet(options.fleet, options.vehicles)
    endpoint = f"tcp/127.0.0.1:{options.port}"
    try:
        if options.write_fleet:
            write_fleet(load.fleet, options.write_fleet)
        with open_session(listen=(endpoint,), connect=()) as session:
            print(
                f"{options.vehicles} vehicles of fleet {options.fleet} at {options.rate:g} Hz on {endpoint}", flush=True
            )
            for _ in publish(load, options.rate, session):
                pass
    except EndpointError as error:
        print(f"--port {options.port}: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{options.write_fleet}: cannot be written: {error.strerror}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
