"""Fleets without flight, for programs on the ground: their reports, vehicles that a director commands, and Zenoh links."""

from __future__ import annotations

import io
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field

import pytest

from common import with_fields
from companion.config.fleet import FleetConfig
from companion.config.vehicle import ZenohEndpoints
from companion.ground.answers import TimedReply
from companion.ground.commands import MACHINE_CLOCK
from companion.link.fleet.zenoh_link import ZenohLink
from companion.monitor.api import Snapshot
from companion.monitor.snapshot import Picture
from companion.monitor.sources import Moment
from companion.monitor.tui import NO_FILES
from companion.types.autopilot import LandedState, PositionError
from companion.types.commands import Command, CommandName, CommandReply, Content, Lead, ReferenceChange
from companion.types.flight import RULES, FlightPhase, HealthFlag, Role
from companion.types.formation import FlownSlot, FormationChange, HeldReference
from companion.types.notices import Code, Notice
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender
from companion.types.status import (
    AgentIdentity,
    AutopilotReport,
    CommandReport,
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
from companion.types.tick import Outbox
from companion.wire.messages import Percentiles, StatusReport, Timing
from companion.wire.rounding import round_outbox
from processes import free_port
from sitl.flight.director import Director
from sitl.flight.orders import FlightFailure
from sitl.flight.scenario import TimelineStep
from sitl.flight.watch import FlightWatch
from sitl.report.progress import FlightProgress
from tests.bench.monitor_load import SteadyFleet, steady_fleet

TIMING = Timing(50.0, 3000, 0, Percentiles(180.0, 950.0, 4000.0), Percentiles(600.0, 2100.0, 5000.0), 14.0, 49.0)
STATUS = Status(
    agent=AgentIdentity(vehicle_id=1, session=1, fleet="platoon", formation_hash=5, law="weighted"),
    phase=FlightPhase.FORMATION,
    autopilot=AutopilotReport(mode_name="OFFBOARD", armed=True, landed=LandedState.IN_AIR, battery_percent=87.0),
    motion=MotionReport(
        position_enu_m=(0.0, 0.0, 2.5),
        velocity_enu_m_s=(1.0, 0.0, 0.0),
        state_age_s=0.02,
        position_error=PositionError(0.4, 0.7),
    ),
    control=ControlReport(hover_thrust_norm=0.5, disturbance_enu_m_s2=(0.3, 0.4, 0.0)),
    leadership=LeadershipReport(role=Role.FOLLOWER, epoch=0, prc=2, leader_beacon=None, leader_beacon_age_s=None),
    neighbourhood=NeighbourReport(neighbours=(1,)),
    formation=FormationReport(slot=FlownSlot((0.0, 0.0, 0.0)), reference_enu_m=None),
    safety=SafetyReport(flags=()),
    rejected={},
    last_event=Notice(Code.PHASE_CHANGED, "engage -> formation"),
    command=CommandReport(holder="anna@ground"),
)


def reported(vehicle_id: int, **changes: object) -> Status:
    """A follower in formation, 1.5 m behind the vehicle before it, without an error."""
    behind_enu_m = (-1.5 * (vehicle_id - 1), 0.0, 0.0)
    status = with_fields(
        STATUS,
        vehicle_id=vehicle_id,
        position_enu_m=(behind_enu_m[0], 0.0, 2.5),
        slot=FlownSlot(behind_enu_m),
        prc=vehicle_id,
        peers=(1, 2),
    )
    return with_fields(status, **changes)


def leader(**changes: object) -> Status:
    """Vehicle 1 leads and flies at its reference."""
    leading = {"role": Role.LEADER, "prc": 1, "reference_enu_m": (0.0, 0.0, 2.5), "reference": HeldReference(3, 3)}
    return reported(1, **leading | changes)


def picture_of(
    *statuses: Status, silent: tuple[int, ...] = (), fleets: Mapping[str, FleetConfig] = NO_FILES
) -> Picture:
    """A picture with the reports at 100 s; those of `silent` vehicles came 4.2 s before."""
    picture = Picture(fleets, "anna@ground")
    timed = [
        (95.84 if status.agent.vehicle_id in silent else 100.0, StatusReport(status, TIMING)) for status in statuses
    ]
    picture.receive(sorted(timed, key=lambda report: report[0]))
    return picture


NOW = Moment(100.04, 1.8e9)


def snapshot_of(
    *statuses: Status, silent: tuple[int, ...] = (), fleets: Mapping[str, FleetConfig] = NO_FILES
) -> Snapshot:
    """The snapshot 40 ms after the reports."""
    return picture_of(*statuses, silent=silent, fleets=fleets).snapshot(*NOW)


def troubled_fleet() -> Snapshot:
    """Five vehicles: a sound leader, one outside the fence with a late tick, one silent, one on the ground, one avoiding."""
    return snapshot_of(
        leader(),
        reported(2, flags=(HealthFlag.TICK_LATE, HealthFlag.OUTSIDE_FENCE), position_enu_m=(-1.4, 0.3, 2.5)),
        reported(3),
        reported(
            4,
            phase=FlightPhase.OBSERVE,
            mode_name="AUTO.LOITER",
            armed=False,
            landed=LandedState.ON_GROUND,
            battery_percent=None,
            lacks=(Notice(Code.BATTERY_UNKNOWN, "the autopilot does not report the battery"),),
        ),
        reported(
            250,
            position_enu_m=(-1300.0, -1234.5, 123.4),
            separation=SeparationReport(NearestVehicle("3", 1.23, 1.2), 0.5),
            slot=FlownSlot((-1.0, 2.0, 0.0), formation=12, moves_for_s=2.0),
            rejected={"PEER_LATE 2": 12345},
        ),
        silent=(3,),
    )


def large_fleet() -> Snapshot:
    """Fifty vehicles; 17 has a low battery, 33 is silent."""
    flagged = reported(17, flags=(HealthFlag.BATTERY_LOW,), battery_percent=21.0)
    others = (reported(i) for i in range(2, 51) if i != 17)
    return snapshot_of(leader(), flagged, *others, silent=(33,))


C, P = CommandName, FlightPhase
DIRECTED_TIMING = Timing(50.0, 100, 0, Percentiles(1, 2, 3), Percentiles(4, 5, 6), 5.0, 48.0)
DOING_S = 0.05  # duration of an action, times the id of the vehicle


def directed_status(vehicle_id: int) -> Status:
    leads = vehicle_id == 1
    return Status(
        agent=AgentIdentity(vehicle_id=vehicle_id, session=1, fleet="pair", formation_hash=1, law="weighted"),
        phase=P.OBSERVE,
        autopilot=AutopilotReport(mode_name="HOLD", armed=False, landed=LandedState.ON_GROUND),
        motion=MotionReport(position_enu_m=(0.0, 0.0, 0.0), velocity_enu_m_s=(0.0, 0.0, 0.0), state_age_s=0.01),
        control=ControlReport(hover_thrust_norm=0.5, disturbance_enu_m_s2=(0.0, 0.0, 0.0)),
        leadership=LeadershipReport(
            role=Role.LEADER if leads else Role.FOLLOWER,
            epoch=0,
            prc=vehicle_id,
            leader_beacon=None,
            leader_beacon_age_s=None,
        ),
        neighbourhood=NeighbourReport(neighbours=()),
        formation=FormationReport(slot=FlownSlot((0.0, 0.0, 0.0)), reference_enu_m=(0.0, 0.0, 0.0) if leads else None),
        safety=SafetyReport(flags=()),
        rejected={},
        last_event=None,
    )


class DirectedVehicles:
    """A FleetSession with two vehicles, without network."""

    def __init__(self) -> None:
        self.statuses = {1: directed_status(1), 2: directed_status(2)}
        self.refuses: dict[tuple[int, CommandName], list[str]] = {}  # reasons, one for each refusal
        self.falls: dict[tuple[int, CommandName], str] = {}  # the procedure fails with this event
        self.mute: set[int] = set()
        self.cancels: set[int] = set()  # vehicles that accept one formation, and have dropped it when its time has come
        self.received: list[tuple[CommandName, tuple[int, ...]]] = []
        self.checked: list[tuple[CommandName, tuple[int, ...], Content | None]] = []
        self.accepts: tuple[tuple[str, float], ...] = ()
        self.leads: list[Lead] = []
        self.references: list[ReferenceChange] = []
        self._due: dict[int, tuple[float, CommandName]] = {}

    operator = "anna@ground"

    def newest(self) -> dict[int, Status]:
        return self.statuses

    def ask(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None = None
    ) -> dict[int, TimedReply | None]:
        replies = self._replies(vehicle_ids, name, timeout_s, content)
        return {i: TimedReply(reply, 0.0) if reply else None for i, reply in replies.items()}

    def check(
        self, vehicle_ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None = None
    ) -> dict[int, TimedReply | None]:
        """Refused where the command is; nothing changes."""
        assert timeout_s > 0
        self.checked.append((name, tuple(vehicle_ids), content))
        replies = {}
        for i in self.checked[-1][1]:
            reasons = self.refuses.get((i, name), [])
            code = Code.WRONG_PHASE if reasons else Code.CHECK_PASSED
            reply = CommandReply(i, 1, not reasons, code, reasons[0] if reasons else "yes", self.operator, self.accepts)
            replies[i] = None if i in self.mute else TimedReply(reply, 0.0)
        return replies

    def _replies(
        self, ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None = None
    ) -> dict[int, CommandReply | None]:
        assert timeout_s > 0
        assert (name is C.LEAD) is isinstance(content, Lead)
        commanded = tuple(ids)
        self.received.append((name, commanded))
        if isinstance(content, ReferenceChange):
            self.references.append(content)
            return {i: self._change_reference(i, content) for i in commanded}
        if isinstance(content, FormationChange):
            return {i: self._change_formation(i, content) for i in commanded}
        if isinstance(content, Lead):
            self.leads.append(content)
            return {i: None if i in self.mute else self._change_lead(i, content) for i in commanded}
        return {i: None if i in self.mute else self._reply(i, name) for i in commanded}

    def _change_lead(self, vehicle_id: int, lead: Lead) -> CommandReply:
        if reasons := self.refuses.get((vehicle_id, C.LEAD)):
            return CommandReply(vehicle_id, 1, False, Code.WRONG_PHASE, reasons.pop(0), "anna@ground")
        role = Role.LEADER if vehicle_id in lead.leaders else Role.FOLLOWER
        self.change(vehicle_id, role=role, epoch=lead.epoch)
        return CommandReply(vehicle_id, 1, True, Code.PHASE_CHANGED, "yes", "anna@ground")

    def _change_reference(self, vehicle_id: int, change: ReferenceChange) -> CommandReply:
        if reasons := self.refuses.get((vehicle_id, C.REFERENCE)):
            return CommandReply(vehicle_id, 1, False, Code.WRONG_PHASE, reasons.pop(0), "anna@ground")
        self.change(vehicle_id, reference=HeldReference(change.number, change.number, change.begins_s))
        return CommandReply(vehicle_id, 1, True, Code.PHASE_CHANGED, "yes", "anna@ground")

    def _change_formation(self, vehicle_id: int, change: FormationChange) -> CommandReply:
        if vehicle_id in self.cancels:
            self.cancels.remove(vehicle_id)
            self.change(vehicle_id, reference_s=change.begins_s + 2.0)
            return CommandReply(vehicle_id, 1, True, Code.FORMATION_ACCEPTED, "begins in 1.0 s", "anna@ground")
        if reasons := self.refuses.get((vehicle_id, C.FORMATION)):
            return CommandReply(vehicle_id, 1, False, Code.CHANGE_NOT_IN_TIME, reasons.pop(0), "anna@ground")
        self.change(vehicle_id, slot=FlownSlot(dict(change.slots_enu_m)[vehicle_id], formation=change.number))
        return CommandReply(vehicle_id, 1, True, Code.FORMATION_ACCEPTED, "yes", "anna@ground")

    def _reply(self, vehicle_id: int, name: CommandName) -> CommandReply:
        reasons = self.refuses.get((vehicle_id, name))
        if reasons:
            return CommandReply(vehicle_id, 1, False, Code.WRONG_PHASE, reasons.pop(0), "anna@ground")
        self.statuses[vehicle_id] = with_fields(self.statuses[vehicle_id], phase=RULES[name].via)
        self._due[vehicle_id] = (time.monotonic() + DOING_S * vehicle_id, name)
        return CommandReply(vehicle_id, 1, True, Code.PHASE_CHANGED, "yes", "anna@ground")

    def drain(self) -> list[StatusReport]:
        for vehicle_id, (due_s, name) in list(self._due.items()):
            if time.monotonic() >= due_s:
                del self._due[vehicle_id]
                self._finish(vehicle_id, name)
        sent = [round_outbox(Outbox(status=status)).status for status in self.statuses.values()]
        return [
            StatusReport(status, DIRECTED_TIMING)
            for status in sent
            if status and status.agent.vehicle_id not in self.mute
        ]

    def _finish(self, vehicle_id: int, name: CommandName) -> None:
        before = self.statuses[vehicle_id]
        if event := self.falls.get((vehicle_id, name)):
            fallen_to = P.OBSERVE if "-> observe" in event else RULES[name].on_failure
            self.statuses[vehicle_id] = with_fields(
                before, phase=fallen_to, last_event=Notice(Code.PHASE_CHANGED, event)
            )
            return
        up = name in (C.TAKEOFF, C.FORM, C.HOLD)
        self.statuses[vehicle_id] = with_fields(
            before,
            phase=RULES[name].to,
            armed=name not in (C.PREPARE, C.LAND, C.RETURN, C.DISARM),
            landed=LandedState.IN_AIR if up else LandedState.ON_GROUND,
        )

    def change(self, vehicle_id: int, **what: object) -> None:
        self.statuses[vehicle_id] = with_fields(self.statuses[vehicle_id], **what)


class DirectedFlight:
    def __init__(self) -> None:
        self.vehicles = DirectedVehicles()
        self.watch = FlightWatch([1, 2], [1], time.monotonic())
        self.shown = io.StringIO()
        self.checks: list[str] = []
        self.lost: set[int] = set()
        self.director = Director(
            self.vehicles,
            self.watch,
            FlightProgress("pair", False, self.watch.began_s, self.shown),
            lambda: self.check(),
            lambda: self.lost,
            MACHINE_CLOCK,
        )

    def check(self) -> None:
        """What the director calls between two waits; a test may replace it."""
        if self.checks:
            raise FlightFailure(self.checks.pop())

    def fly(self, *commands: CommandName, for_s: float = 0.3, timeout_s: float = 2.0) -> None:
        steps = [
            TimelineStep(command=name, for_s=for_s if name is C.FORM else 0.0, timeout_s=timeout_s) for name in commands
        ]
        self.director.fly(steps)

    def fails(self, *commands: CommandName, for_s: float = 0.3, timeout_s: float = 2.0) -> str:
        with pytest.raises(FlightFailure) as caught:
            self.fly(*commands, for_s=for_s, timeout_s=timeout_s)
        assert "\n" not in str(caught.value)
        return str(caught.value)


WHOLE = (C.PREPARE, C.ARM, C.TAKEOFF, C.FORM, C.LAND)


ZERO = (0.0, 0.0, 0.0)
PACKET = PeerPacket(
    sender=Sender(vehicle_id=1, session=7, sequence=1, formation_hash=5),
    phase=FlightPhase.HOLD,
    role=Role.LEADER,
    motion=Motion(position_enu_m=ZERO, velocity_enu_m_s=ZERO, acceleration_enu_m_s2=ZERO, state_age_s=0.01, sent_s=0.0),
    leader=LeaderReport(prc=1, beacon=None),
    slot=FlownSlot(ZERO),
)


PERIOD_S = 0.05
Answering = Callable[[int, Command], CommandReply | None]
"""Vehicle id and command -> its reply; None: no reply."""


def accept(vehicle_id: int, command: Command) -> CommandReply:
    return CommandReply(vehicle_id, command.number, True, Code.PHASE_CHANGED, "done", command.operator)


@dataclass
class LinkedVehicles:
    load: SteadyFleet
    endpoints: tuple[str, ...]
    answer: Answering = accept
    commands: list[tuple[int, Command]] = field(default_factory=list)  # each once
    silent: set[int] = field(default_factory=set)  # ids that do not report
    answer_check: Answering = accept

    def received(self, name: str) -> list[int]:
        """The vehicles that have received a command of this name."""
        return sorted({i for i, command in self.commands if command.name == name})

    def run(self, links: dict[int, ZenohLink], stopped: threading.Event) -> None:
        begin_s = time.monotonic()
        while not stopped.wait(PERIOD_S):
            for vehicle_id, link in links.items():
                now_s = time.monotonic()
                if vehicle_id not in self.silent:
                    link.publish_status(self.load.report(vehicle_id, now_s - begin_s))
                for command in link.receive(now_s)[1]:
                    if (vehicle_id, command) not in self.commands:
                        self.commands.append((vehicle_id, command))
                    reply = self.answer(vehicle_id, command)
                    link.reply([reply] if reply else [])
                replies = [self.answer_check(vehicle_id, check) for check in link.checks()]
                link.reply([reply for reply in replies if reply])


@contextmanager
def linked_vehicles(count: int = 3) -> Iterator[LinkedVehicles]:
    """Vehicles 1 to `count` of fleet "load", each on a port of its own."""
    load = steady_fleet("load", count)
    with ExitStack() as stack:
        links, endpoints = {}, []
        for vehicle_id in load.vehicle_ids:
            endpoint = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
            used = ZenohEndpoints(listen=(endpoint,), connect=())
            links[vehicle_id] = stack.enter_context(closing(ZenohLink(vehicle_id, load.fleet, used, lambda _key: None)))
            endpoints.append(endpoint)
        vehicles, stopped = LinkedVehicles(load, tuple(endpoints)), threading.Event()
        thread = threading.Thread(target=vehicles.run, args=(links, stopped), daemon=True)
        thread.start()
        try:
            yield vehicles
        finally:
            stopped.set()
            thread.join()
