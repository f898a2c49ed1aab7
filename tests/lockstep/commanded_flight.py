"""A fleet in virtual time that a test commands step by step."""

from __future__ import annotations

from itertools import combinations, pairwise
from math import degrees, dist
from pathlib import Path

import numpy as np

from companion.assembly import build_agent
from companion.config.vehicle import AgentConfig
from companion.types import AttitudeTarget, CommandName, CommandReply, Content, FlightPhase, PeerPacket, Status
from sitl.director import Director
from sitl.fleet import ids_of, reached_stand_in, vehicle_file
from sitl.lockstep import Lockstep
from sitl.progress import Progress
from sitl.scenario import load_scenario
from sitl.watch import FlightWatch

FORMATION = FlightPhase.FORMATION


class Flight:
    """A scenario's fleet, in formation by its timeline up to there, and all that its vehicles say and do from then on."""

    def __init__(self, scenario: Path, *overrides: str) -> None:
        self.scenario = load_scenario(scenario, ["stand_in.sensors=ideal", *overrides])
        self.lockstep = Lockstep(self.scenario)
        watch = FlightWatch(ids_of(self.scenario), [1], 0.0)
        director = Director(self.lockstep, watch, Progress("test", True, 0.0), lambda: None, tuple, self.lockstep)
        steps = self.scenario.timeline
        director.fly(steps[: 1 + [step.command for step in steps].index(CommandName.FORM)])
        self.newest: dict[int, Status] = {}
        self.events: list[tuple[int, str]] = []
        self.packets: list[PeerPacket] = []
        self.targets: dict[int, list[tuple[float, AttitudeTarget]]] = {}
        self._record_targets()
        send = self.lockstep._network.send

        def sent(packet: PeerPacket, now_s: float) -> None:
            self.packets.append(packet)
            send(packet, now_s)

        self.lockstep._network.send = sent  # type: ignore[method-assign]
        self.go_on(0.5)

    def go_on(self, seconds: float) -> None:
        self.lockstep.sleep(seconds)
        for report in self.lockstep.drain():
            self.newest[report.status.vehicle_id] = report.status
            self.events.append((report.status.vehicle_id, report.status.last_event))

    def until(self, vehicle_id: int, phase: FlightPhase, within_s: float = 30.0) -> None:
        end_s = self.lockstep.now_s() + within_s
        while self.newest[vehicle_id].phase is not phase:
            assert self.lockstep.now_s() < end_s, self.events[-5:]
            self.go_on(0.1)

    def give(self, name: CommandName, *ids: int, content: Content | None = None) -> None:
        replies = self.answers(name, *ids, content=content)
        assert all(reply and reply.accepted for reply in replies.values()), replies

    def answers(self, name: CommandName, *ids: int, content: Content | None = None) -> dict[int, CommandReply | None]:
        return self.lockstep.command(ids or ids_of(self.scenario), name, 1.0, content)

    def take_off_again(self, vehicle_id: int) -> None:
        """From the ground into the autopilot's own hold."""
        for name, phase in (
            (CommandName.PREPARE, FlightPhase.READY),
            (CommandName.ARM, FlightPhase.ARMED),
            (CommandName.TAKEOFF, FlightPhase.HOLD),
        ):
            self.give(name, vehicle_id)
            self.until(vehicle_id, phase)

    def land(self, vehicle_id: int) -> None:
        """On the ground, disarmed."""
        self.give(CommandName.HOLD, vehicle_id)
        self.until(vehicle_id, FlightPhase.HOLD)
        self.give(CommandName.LAND, vehicle_id)
        self.until(vehicle_id, FlightPhase.OBSERVE)

    def said(self, vehicle_id: int) -> list[str]:
        """Its events, in order, each once."""
        return list(dict.fromkeys(event for i, event in self.events if i == vehicle_id))

    def smallest_m(self, since_s: float) -> float:
        """Of the true distances between any two in flight from then on."""
        times_s = np.arange(since_s, self.lockstep.now_s() - 0.1, 0.02)
        at = {s.vehicle_id: s.track().at(times_s) for s in self.lockstep.stand_ins}
        return min(float(np.linalg.norm(at[i] - at[j], axis=1).min()) for i, j in combinations(at, 2))

    def largest_step_deg(self) -> float:
        """Of roll and pitch from one setpoint to the next, 20 ms after it."""
        return max(
            degrees(max(abs(b.roll_rad - a.roll_rad), abs(b.pitch_rad - a.pitch_rad)))
            for told in self.targets.values()
            for (a_s, a), (b_s, b) in pairwise(told)
            if b_s - a_s < 0.03
        )

    def errors_m(self) -> dict[int, float]:
        """How far each that is in formation is now from its slot about the leader's reference."""
        leader = next(s for s in self.newest.values() if s.reference_enu_m is not None and s.phase is FORMATION)
        assert leader.reference_enu_m is not None
        return {
            i: dist(
                s.position_enu_m, [r + d for r, d in zip(leader.reference_enu_m, s.slot.position_enu_m, strict=True)]
            )
            for i, s in self.newest.items()
            if s.phase is FORMATION
        }

    def _record_targets(self) -> None:
        for vehicle_id, vehicle in self.lockstep._vehicles.items():
            told, follow = self.targets.setdefault(vehicle_id, []), vehicle.link.command

            def command(target, now_s, told=told, follow=follow):  # type: ignore[no-untyped-def]
                told.append((now_s, target))
                follow(target, now_s)

            vehicle.link.command = command  # type: ignore[method-assign]

    def restart(self, vehicle_id: int) -> None:
        member = self.scenario.fleet.member(vehicle_id)
        assert member is not None
        file = vehicle_file(self.scenario, reached_stand_in(self.scenario, vehicle_id, port_offset=0), port_offset=0)
        agent = build_agent(AgentConfig(file, self.scenario.fleet, member), session=2)
        self.lockstep._vehicles[vehicle_id]._agent = agent
