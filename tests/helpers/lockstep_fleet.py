"""The third way to make vehicles fly: a fleet in virtual time, all real agents, the same to the last bit in every run.

`FlownScenario` has flown a whole scenario and landed; `CommandedFlight` has flown its timeline up to `form`, and
`EnteringFleet` one that ends in the air: a test commands both on. `director_of` flies any other timeline.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from itertools import combinations, pairwise
from math import degrees, dist, hypot, inf
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from msgspec.structs import replace

from common import ROOT
from companion.assembly import build_agent
from companion.config.vehicle import AgentConfig
from companion.core.agent import Agent
from companion.core.consensus.kept_off import target
from companion.core.report import Decision
from companion.laws._neighbour_feedback import NeighbourFeedback
from companion.types.autopilot import AttitudeTarget
from companion.types.commands import CommandName, CommandReply, Content
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot, FormationState
from companion.types.peers import PeerPacket
from companion.types.status import Status
from companion.types.tick import Inbox
from companion.types.values import Vector3
from companion.wire.messages import StatusReport
from sitl.flight.director import Director
from sitl.flight.files import ids_of, reached_stand_in, vehicle_file
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import Scenario, load_scenario
from sitl.flight.watch import FlightWatch
from sitl.report.metrics import SAMPLE_S, Formation
from sitl.report.progress import FlightProgress
from sitl.vehicle.config import Partition

FORMATION = FlightPhase.FORMATION
READY_SOON = ("stand_in.sensors=ideal", "stand_in.armable_after_s=1")  # nothing is tested while the estimators settle


def director_of(lockstep: Lockstep, watch: FlightWatch, check: Callable[[], None] = lambda: None) -> Director:
    """Gives the commands of a timeline to a fleet in virtual time; `check` is called in every pass."""
    return Director(lockstep, watch, FlightProgress("test", True, 0.0), check, tuple, lockstep)


def agent_of(scenario: Scenario, vehicle_id: int, session: int) -> Agent:
    """A new agent of a vehicle of the scenario; session 2 is that after a restart."""
    member = scenario.fleet.member(vehicle_id)
    assert member is not None
    file = vehicle_file(scenario, reached_stand_in(scenario, vehicle_id, port_offset=0), port_offset=0)
    return build_agent(AgentConfig(file, scenario.fleet, member), session=session)


class CommandedFlight:
    """The fleet of a scenario after the form step of its timeline, and all reports, packets, targets, decisions since then."""

    def __init__(self, scenario: Path, *overrides: str) -> None:
        self.scenario = load_scenario(scenario, [*READY_SOON, *overrides])
        self.lockstep = Lockstep(self.scenario)
        watch = FlightWatch(ids_of(self.scenario), [1], 0.0)
        director = director_of(self.lockstep, watch)
        steps = self.scenario.timeline
        director.fly(steps[: 1 + [step.command for step in steps].index(CommandName.FORM)])
        self.newest: dict[int, Status] = {}
        self.events: list[tuple[int, str]] = []
        self.packets: list[PeerPacket] = []
        self.targets = record_targets(self.lockstep)
        self.decisions = Decisions(self.lockstep)
        send = self.lockstep.network.send

        def sent(packet: PeerPacket, now_s: float) -> None:
            self.packets.append(packet)
            send(packet, now_s)

        self.lockstep.network.send = sent  # type: ignore[method-assign]
        self.go_on(0.5)

    def go_on(self, seconds: float) -> None:
        self.lockstep.sleep(seconds)
        for report in self.lockstep.drain():
            self.newest[report.status.agent.vehicle_id] = report.status
            if report.status.last_event:
                self.events.append((report.status.agent.vehicle_id, report.status.last_event.text))

    def separate(self, *ids: int, for_s: float, lost: Literal["both", "received", "sent"] = "both") -> None:
        """From now on packets between these vehicles and all others are lost, for this time."""
        now_s = self.lockstep.now_s()
        partition = Partition(ids, now_s, now_s + for_s, lost)
        for paths in self.lockstep.network.paths.values():
            for path in paths:
                path.links = replace(path.links, partitions=(partition,))

    def until(self, vehicle_id: int, phase: FlightPhase, within_s: float = 30.0) -> None:
        end_s = self.lockstep.now_s() + within_s
        while self.newest[vehicle_id].phase is not phase:
            assert self.lockstep.now_s() < end_s, self.events[-5:]
            self.go_on(0.1)

    def give(self, name: CommandName, *ids: int, content: Content | None = None) -> None:
        replies = self.answers(name, *ids, content=content)
        assert all(reply and reply.accepted for reply in replies.values()), replies

    def answers(self, name: CommandName, *ids: int, content: Content | None = None) -> dict[int, CommandReply | None]:
        answers = self.lockstep.ask(ids or ids_of(self.scenario), name, 1.0, content)
        return {i: answer.reply if answer else None for i, answer in answers.items()}

    def take_off_again(self, vehicle_id: int) -> None:
        """Bring a vehicle from the ground into hold."""
        for name, phase in (
            (CommandName.PREPARE, FlightPhase.READY),
            (CommandName.ARM, FlightPhase.ARMED),
            (CommandName.TAKEOFF, FlightPhase.HOLD),
        ):
            self.give(name, vehicle_id)
            self.until(vehicle_id, phase)

    def land(self, vehicle_id: int) -> None:
        """Land a vehicle and wait until it is disarmed."""
        self.give(CommandName.HOLD, vehicle_id)
        self.until(vehicle_id, FlightPhase.HOLD)
        self.give(CommandName.LAND, vehicle_id)
        self.until(vehicle_id, FlightPhase.OBSERVE)

    def events_of(self, vehicle_id: int) -> list[str]:
        """Events of a vehicle in order, without repetitions."""
        return list(dict.fromkeys(event for i, event in self.events if i == vehicle_id))

    def smallest_m(self, since_s: float) -> float:
        """Smallest true distance of any two vehicles since then."""
        times_s = np.arange(since_s, self.lockstep.now_s() - 0.1, 0.02)
        at = {s.vehicle_id: s.track().at(times_s) for s in self.lockstep.stand_ins}
        return min(float(np.linalg.norm(at[i] - at[j], axis=1).min()) for i, j in combinations(at, 2))

    def errors_m(self) -> dict[int, float]:
        """Distance of each vehicle in formation to its slot about the leader's reference."""
        leader = next(
            s for s in self.newest.values() if s.formation.reference_enu_m is not None and s.phase is FORMATION
        )
        assert leader.formation.reference_enu_m is not None
        return {
            i: dist(
                s.motion.position_enu_m,
                [r + d for r, d in zip(leader.formation.reference_enu_m, s.formation.slot.position_enu_m, strict=True)],
            )
            for i, s in self.newest.items()
            if s.phase is FORMATION
        }

    def restart(self, vehicle_id: int) -> None:
        self.lockstep.vehicles[vehicle_id].agent = agent_of(self.scenario, vehicle_id, session=2)


JUMP_M = 0.0005  # of a slot or a reference, beyond its velocity: a tick at 2.5 m/s^2, more than any blend has

IN_FORMATION = FlightPhase.FORMATION


class Decisions:
    """All decisions of the agents from now on."""

    def __init__(self, lockstep: Lockstep) -> None:
        self.of_vehicle = {vehicle_id: _record(vehicle.agent) for vehicle_id, vehicle in lockstep.vehicles.items()}

    def jump_m(self, from_s: float = -inf) -> float:
        """The largest jump of a slot, or of the reference of a vehicle that goes on leading, from one tick to the next."""
        jumps = []
        for a, b in self._in_formation(from_s):
            after_s, before, after = b.now_s - a.now_s, a.guidance, b.guidance
            jumps.append(_jump_m(before.slot, after.slot, after_s))
            if before.reference and after.reference:
                jumps.append(_jump_m(before.reference, after.reference, after_s))
        return max(jumps)

    def steered_jump_m(self, law: NeighbourFeedback, from_s: float, until_s: float) -> float:
        """The largest jump of what a vehicle in formation steers to: its own reference, or the mean of its neighbours."""
        jumps = []
        for a, b in self._in_formation(from_s, until_s):
            before, after = (target(law, d.consensus.neighbours.states, d.guidance.reference) for d in (a, b))
            if before and after:
                jumps.append(_jump_m(before, after, b.now_s - a.now_s))
        return max(jumps)

    def _in_formation(self, from_s: float, until_s: float = inf) -> Iterator[tuple[Decision, Decision]]:
        """The decisions of two ticks, one after the other, of each vehicle."""
        for decisions in self.of_vehicle.values():
            for a, b in pairwise(decisions):
                if a.flight.phase is b.flight.phase is IN_FORMATION and a.now_s >= from_s and b.now_s <= until_s:
                    yield a, b


def _record(agent) -> list[Decision]:  # type: ignore[no-untyped-def]
    decisions: list[Decision] = []
    decide = agent.decide

    def decided(now_s: float, inbox: Inbox) -> Decision:
        decision: Decision = decide(now_s, inbox)
        decisions.append(decision)
        return decision

    agent.decide = decided
    return decisions


def _jump_m(before: FlownSlot | FormationState, after: FlownSlot | FormationState, after_s: float) -> float:
    """Distance from where it would be by its velocity."""
    moved = zip(before.position_enu_m, before.velocity_enu_m_s, strict=True)
    return dist([p + v * after_s for p, v in moved], after.position_enu_m)


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
        director = director_of(self.lockstep, watch)
        director.fly(scenario.timeline)
        self.newest: dict[int, Status] = {}
        self.events: list[tuple[int, str]] = []
        self.targets = record_targets(self.lockstep)
        self.began_s = self.lockstep.now_s()
        self.go_on(0.2)

    def go_on(self, seconds: float) -> None:
        self.lockstep.sleep(seconds)
        for report in self.lockstep.drain():
            self.newest[report.status.agent.vehicle_id] = report.status
            event = report.status.last_event
            if event and (report.status.agent.vehicle_id, event.text) not in self.events:
                self.events.append((report.status.agent.vehicle_id, event.text))

    def give(self, name: CommandName, *ids: int, content: Content | None = None) -> dict[int, CommandReply | None]:
        answers = self.lockstep.ask(ids or self.ids, name, 1.0, content)
        return {i: answer.reply if answer else None for i, answer in answers.items()}

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
        leader = next(s for s in self.newest.values() if s.formation.reference_enu_m is not None)
        at = leader.formation.reference_enu_m
        assert at is not None
        return {
            i: float(np.linalg.norm(np.array(s.motion.position_enu_m) - at - np.array(s.formation.slot.position_enu_m)))
            for i, s in self.newest.items()
        }


class Recorder(FlightWatch):
    """A FlightWatch that keeps every report with its time of receipt."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(ids_of(scenario), [1], 0.0)
        self.reports: list[tuple[float, Status]] = []

    def receive(self, report: StatusReport, now_s: float) -> None:
        super().receive(report, now_s)
        self.reports.append((now_s, report.status))


def record_targets(lockstep: Lockstep) -> dict[int, list[tuple[float, AttitudeTarget]]]:
    """Setpoints by vehicle id with their times; the lists grow during the flight."""
    recorded: dict[int, list[tuple[float, AttitudeTarget]]] = {}
    for vehicle_id, vehicle in lockstep.vehicles.items():
        rows, follow = recorded.setdefault(vehicle_id, []), vehicle.link.command

        def command(target, now_s, rows=rows, follow=follow):  # type: ignore[no-untyped-def]
            rows.append((now_s, target))
            follow(target, now_s)

        vehicle.link.command = command  # type: ignore[method-assign]
    return recorded


class FlownScenario:
    """A scenario flown to its end and landed, with every report and true position."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.lockstep, self.watch = Lockstep(scenario), Recorder(scenario)
        self.record()
        self.failures = director_of(self.lockstep, self.watch).fly_and_land(scenario.timeline)
        self.tracks = {stand_in.vehicle_id: stand_in.track() for stand_in in self.lockstep.stand_ins}

    def record(self) -> None:
        """Called before the flight, for what else a test wants to keep."""

    @property
    def formation(self) -> Formation:
        assert self.watch.formation is not None
        return self.watch.formation

    def smallest_m(self, after_s: float = 0.0) -> float:
        """Smallest true distance of two vehicles in formation, from `after_s` after its begin."""
        times_s = np.arange(self.formation.start_s + after_s, self.formation.end_s, SAMPLE_S)
        at = {i: track.at(times_s) for i, track in self.tracks.items()}
        return min(float(np.linalg.norm(at[i] - at[j], axis=1).min()) for i, j in combinations(at, 2))


PLATOON_FILE = ROOT / "config" / "scenarios" / "platoon.yaml"


@cache
def platoon(*overrides: str) -> Scenario:
    return load_scenario(PLATOON_FILE, overrides)
