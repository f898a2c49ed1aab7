"""The real agents and the stand-ins in one loop and in virtual time: no sockets, no processes, no waiting."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from heapq import heappop, heappush
from pathlib import Path
from random import Random

from companion.ground.answers import TimedReply
from companion.types.commands import Command, CommandName, Content
from companion.types.peers import TargetSample
from companion.types.status import Status
from companion.types.values import Vector3
from companion.wire.messages import StatusReport
from sitl.autopilots.autopilot import DT_S
from sitl.flight.files import autopilot_file, ids_of
from sitl.flight.scenario import Scenario
from sitl.flight.virtual_cameras import VirtualCameras
from sitl.flight.virtual_vehicle import VirtualAgent, VirtualStandIn
from sitl.links.network import Network

TELEMETRY_STEPS = 5  # between two positions, and between two rows of a track
OPERATOR = "sitl-run"
FIRST_CHECK = 1_000_000_000  # above the numbers of commands


def phase_steps(seed: int, vehicle_id: int) -> int:
    """Step within its period in which a vehicle's telemetry is sampled; agents do not tick together by design."""
    return Random(f"{seed} {vehicle_id} phase").randrange(TELEMETRY_STEPS)


class Lockstep:
    """A whole fleet; for the director it is both session and clock. The result depends on the scenario alone.

    Telemetry of the stand-ins is out of phase, as from processes started one after another.
    """

    operator = OPERATOR

    def __init__(self, scenario: Scenario, recordings: Path | None = None) -> None:
        """With `recordings` every agent records into that folder, with virtual times."""
        ids, links, seed = ids_of(scenario), scenario.links, scenario.stand_in.seed
        phases_s = {i: phase_steps(seed, i) * DT_S for i in ids}
        self.stand_ins = [
            VirtualStandIn(autopilot_file(scenario, i), links, phase_s) for i, phase_s in phases_s.items()
        ]
        self._steps, self._now_s = 0, 0.0
        self.network = Network(ids, links, seed)
        self._reports: list[StatusReport] = []
        self.vehicles = {
            stand_in.vehicle_id: VirtualAgent(scenario, stand_in, self.network, self._reports, recordings)
            for stand_in in self.stand_ins
        }
        self.in_order = list(self.vehicles.values())
        self._cameras = None
        if scenario.fleet.external_vision:
            self._cameras = VirtualCameras(self.stand_ins, self.vehicles, scenario.stand_in)
        self._commands_given = self._checks_given = 0
        self._target_samples = 0
        self._reseeds = sorted(scenario.stand_in.reseeds, key=lambda one: one.at_s)

    def now_s(self) -> float:
        """Virtual time since the start, seconds."""
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Advance the world by this time, at least by one step."""
        for _ in range(max(1, round(seconds / DT_S))):
            self._step()

    def drain(self) -> list[StatusReport]:
        """All reports since the last call, oldest first."""
        reports = self._reports.copy()
        self._reports.clear()
        return reports

    def newest(self) -> dict[int, Status]:
        """The newest status of each vehicle that ever reported."""
        return {i: vehicle.status for i, vehicle in self.vehicles.items() if vehicle.status}

    def ask(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None = None
    ) -> dict[int, TimedReply | None]:
        """Give one command to these vehicles and advance the world until all have answered or `timeout_s` has passed.

        A vehicle that has not reported yet gets none, for lack of its session, and is waited for until it reports.
        """
        self._commands_given += 1
        number = self._commands_given
        return self._ask(
            vehicle_ids, timeout_s, number, lambda one: one.give(self._command(one, name, number, content))
        )

    def check(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None = None
    ) -> dict[int, TimedReply | None]:
        """As `ask`, for what these vehicles would answer to a command. They change nothing."""
        self._checks_given += 1
        number = FIRST_CHECK + self._checks_given
        return self._ask(vehicle_ids, timeout_s, number, lambda one: one.ask(self._command(one, name, number, content)))

    def _command(self, vehicle: VirtualAgent, name: CommandName, number: int, content: Content | None) -> Command:
        return Command(name, number, self.operator, vehicle.session, content)

    def _ask(
        self, vehicle_ids: Iterable[int], timeout_s: float, number: int, give: Callable[[VirtualAgent], None]
    ) -> dict[int, TimedReply | None]:
        asked = [self.vehicles[vehicle_id] for vehicle_id in vehicle_ids]
        given = [vehicle for vehicle in asked if vehicle.session]
        for vehicle in given:
            give(vehicle)
        given_s = self.now_s()
        while self.now_s() < given_s + timeout_s and (
            any(vehicle.reply_to(number) is None for vehicle in given) or not all(vehicle.session for vehicle in asked)
        ):
            self._step()
        replies = {vehicle.vehicle_id: vehicle.reply_to(number) for vehicle in asked}
        return {i: TimedReply(reply, self.now_s() - given_s) if reply else None for i, reply in replies.items()}

    def publish_target(self, name: str, velocity_enu_m_s: Vector3, position_enu_m: Vector3 | None = None) -> None:
        """A sample of a moving target, received by all vehicles at once."""
        self._target_samples += 1
        sample = TargetSample(1, self._target_samples, self.now_s(), velocity_enu_m_s, position_enu_m)
        for vehicle in self.in_order:
            vehicle.take_target(name, sample)

    def close(self) -> None:
        """End the recordings."""
        for vehicle in self.in_order:
            vehicle.close()

    def reseed(self, seed: str) -> None:
        """From now on all random numbers are those of this seed."""
        for stand_in in self.stand_ins:
            stand_in.autopilot.quad.reseed(f"{seed} {stand_in.vehicle_id}")
        for paths in self.network.paths.values():
            for path in paths:
                path.reseed(seed)

    def _step(self) -> None:
        """One step of DT_S of all stand-ins, then the ticks of the agents until the next one, in the order of their times."""
        self._steps += 1
        now_s = self._now_s = self._steps * DT_S
        for stand_in in self.stand_ins:
            stand_in.step(now_s)
        if self._cameras:
            self._cameras.step(self._steps, now_s)
        if self._steps % TELEMETRY_STEPS == 0:
            for stand_in in self.stand_ins:
                stand_in.record(now_s)
        next_step_s = now_s + DT_S
        due = [(at_s, i) for i, vehicle in enumerate(self.in_order) if (at_s := vehicle.next_s) < next_step_s]
        due.sort()
        while due:
            at_s, i = heappop(due)
            vehicle = self.in_order[i]
            vehicle.go_on(at_s)
            if (next_s := vehicle.next_s) < next_step_s:
                heappush(due, (next_s, i))
        if self._reseeds and self._reseeds[0].at_s <= now_s:
            self.reseed(self._reseeds.pop(0).seed)
