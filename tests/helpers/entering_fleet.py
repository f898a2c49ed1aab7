"""A fleet in virtual time that enters formation: speeds, tilt and distances as they were flown."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from math import degrees, hypot
from pathlib import Path

import numpy as np
import yaml

from companion.types.commands import CommandName, CommandReply, Content
from companion.types.flight import FlightPhase
from companion.types.status import Status
from companion.types.values import Vector3
from recorded_flight import record_targets
from sitl.flight.director import Director
from sitl.flight.files import ids_of
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import Scenario, load_scenario
from sitl.flight.watch import FlightWatch
from sitl.report.progress import FlightProgress

ORIGIN = {"latitude_deg": 47.397742, "longitude_deg": 8.545594, "altitude_amsl_m": 488.0}


def scenario_of(
    folder: Path,
    slots_enu_m: Mapping[int, Vector3],
    starts_enu_m: Mapping[int, Vector3],
    reference: Mapping[str, object],
    *overrides: str,
) -> Scenario:
    """A fleet whose first vehicle leads, and whose others may; every vehicle hears each other."""
    ids = sorted(slots_enu_m)
    fleet = {
        "name": "entering",
        "origin": ORIGIN,
        "vehicles": [
            {"id": i, "role": "leader" if i == ids[0] else "follower", "slot_enu_m": list(slots_enu_m[i])}
            | ({} if i == ids[0] else {"may_lead": True})
            for i in ids
        ],
        "neighbours": {
            "kind": "edges",
            "edges": [list(edge) for edge in combinations(ids, 2) if edge[1] - edge[0] <= 2],
        },
        "takeoff_height_m": 5.0,
    }
    whole = {
        "description": "Vehicles that enter formation.",
        "fleet": fleet,
        "starts_enu_m": {i: list(start) for i, start in starts_enu_m.items()},
        "reference": dict(reference),
        "timeline": [{"command": "prepare"}, {"command": "arm"}, {"command": "takeoff", "for_s": 3.0}],
    }
    path = folder / "entering.yaml"
    path.write_text(yaml.safe_dump(whole))
    return load_scenario(path, ["stand_in.sensors=ideal", *overrides])


class EnteringFleet:
    """The fleet of a scenario in hold, at the end of its timeline."""

    def __init__(self, scenario: Scenario) -> None:
        self.ids = ids_of(scenario)
        self.lockstep = Lockstep(scenario)
        watch = FlightWatch(self.ids, [self.ids[0]], 0.0)
        director = Director(self.lockstep, watch, FlightProgress("test", True, 0.0), lambda: None, tuple, self.lockstep)
        director.fly(scenario.timeline)
        self.newest: dict[int, Status] = {}
        self.events: list[tuple[int, str]] = []
        self.targets = record_targets(self.lockstep)
        self.began_s = self.lockstep.now_s()
        self.go_on(0.2)

    def go_on(self, seconds: float) -> None:
        self.lockstep.sleep(seconds)
        for report in self.lockstep.drain():
            self.newest[report.status.vehicle_id] = report.status
            event = report.status.last_event
            if event and (report.status.vehicle_id, event.text) not in self.events:
                self.events.append((report.status.vehicle_id, event.text))

    def give(self, name: CommandName, *ids: int, content: Content | None = None) -> dict[int, CommandReply | None]:
        return self.lockstep.command(ids or self.ids, name, 1.0, content)

    def accepted(self, name: CommandName, *ids: int, content: Content | None = None) -> bool:
        return all(reply and reply.accepted for reply in self.give(name, *ids, content=content).values())

    def phases(self) -> set[FlightPhase]:
        return {status.phase for status in self.newest.values()}

    def _positions(self) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        times_s = np.arange(self.began_s, self.lockstep.now_s() - 0.1, 0.02)
        return times_s, {s.vehicle_id: s.track().at(times_s) for s in self.lockstep.stand_ins}

    def largest_speed_m_s(self) -> float:
        """Largest true speed of any vehicle since hold."""
        times_s, at = self._positions()
        return max(float(np.linalg.norm(np.gradient(p, times_s, axis=0), axis=1).max()) for p in at.values())

    def smallest_m(self) -> float:
        """Smallest true distance of any two vehicles since hold."""
        _, at = self._positions()
        return min(float(np.linalg.norm(at[i] - at[j], axis=1).min()) for i, j in combinations(at, 2))

    def largest_tilt_deg(self) -> float:
        """Largest commanded tilt since hold."""
        tilts = [hypot(target.roll_rad, target.pitch_rad) for sent in self.targets.values() for _, target in sent]
        return degrees(max(tilts))

    def errors_m(self) -> dict[int, float]:
        """Distance of each vehicle from its slot about the leader's reference, as reported."""
        leader = next(s for s in self.newest.values() if s.reference_enu_m is not None)
        at = leader.reference_enu_m
        assert at is not None
        return {
            i: float(np.linalg.norm(np.array(s.position_enu_m) - at - np.array(s.slot.position_enu_m)))
            for i, s in self.newest.items()
        }
