"""A fleet in virtual time that a test commands step by step."""

from __future__ import annotations

from itertools import combinations
from math import dist
from pathlib import Path
from typing import Literal

import numpy as np
from msgspec.structs import replace

from companion.assembly import build_agent
from companion.config.vehicle import AgentConfig
from companion.types.commands import CommandName, CommandReply, Content
from companion.types.flight import FlightPhase
from companion.types.peers import PeerPacket
from companion.types.status import Status
from decided_flight import Decisions
from recorded_flight import record_targets
from sitl.flight.director import Director
from sitl.flight.files import ids_of, reached_stand_in, vehicle_file
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import load_scenario
from sitl.flight.watch import FlightWatch
from sitl.report.progress import FlightProgress
from sitl.vehicle.config import Partition

FORMATION = FlightPhase.FORMATION


class Flight:
    """The fleet of a scenario after the form step of its timeline, and all reports, packets, targets, decisions since then."""

    def __init__(self, scenario: Path, *overrides: str) -> None:
        self.scenario = load_scenario(scenario, ["stand_in.sensors=ideal", *overrides])
        self.lockstep = Lockstep(self.scenario)
        watch = FlightWatch(ids_of(self.scenario), [1], 0.0)
        director = Director(self.lockstep, watch, FlightProgress("test", True, 0.0), lambda: None, tuple, self.lockstep)
        steps = self.scenario.timeline
        director.fly(steps[: 1 + [step.command for step in steps].index(CommandName.FORM)])
        self.newest: dict[int, Status] = {}
        self.events: list[tuple[int, str]] = []
        self.packets: list[PeerPacket] = []
        self.targets = record_targets(self.lockstep)
        self.decisions = Decisions(self.lockstep)
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
            if report.status.last_event:
                self.events.append((report.status.vehicle_id, report.status.last_event.text))

    def separate(self, *ids: int, for_s: float, lost: Literal["both", "received", "sent"] = "both") -> None:
        """From now on packets between these vehicles and all others are lost, for this time."""
        now_s = self.lockstep.now_s()
        partition = Partition(ids, now_s, now_s + for_s, lost)
        for paths in self.lockstep._network._paths.values():
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
        return self.lockstep.command(ids or ids_of(self.scenario), name, 1.0, content)

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
        leader = next(s for s in self.newest.values() if s.reference_enu_m is not None and s.phase is FORMATION)
        assert leader.reference_enu_m is not None
        return {
            i: dist(
                s.position_enu_m, [r + d for r, d in zip(leader.reference_enu_m, s.slot.position_enu_m, strict=True)]
            )
            for i, s in self.newest.items()
            if s.phase is FORMATION
        }

    def restart(self, vehicle_id: int) -> None:
        member = self.scenario.fleet.member(vehicle_id)
        assert member is not None
        file = vehicle_file(self.scenario, reached_stand_in(self.scenario, vehicle_id, port_offset=0), port_offset=0)
        agent = build_agent(AgentConfig(file, self.scenario.fleet, member), session=2)
        self.lockstep._vehicles[vehicle_id]._agent = agent
