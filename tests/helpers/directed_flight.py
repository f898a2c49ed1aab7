"""A director with vehicles that reply as configured."""

import io
import time
from collections.abc import Iterable

import pytest
from msgspec.structs import replace

from companion.types.autopilot import LandedState
from companion.types.commands import CommandName, CommandReply, Content, Lead, ReferenceChange
from companion.types.flight import RULES, FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange, HeldReference
from companion.types.notices import Code, Notice
from companion.types.status import Status
from companion.types.tick import Outbox
from companion.wire.messages import Percentiles, StatusReport, Timing
from companion.wire.rounding import as_sent
from sitl.flight.director import Director, MachineClock
from sitl.flight.orders import FlightFailure
from sitl.flight.scenario import TimelineStep
from sitl.flight.watch import FlightWatch
from sitl.report.progress import FlightProgress

C, P = CommandName, FlightPhase
TIMING = Timing(50.0, 100, 0, Percentiles(1, 2, 3), Percentiles(4, 5, 6), 5.0, 48.0)
DOING_S = 0.05  # duration of an action, times the id of the vehicle


def status(vehicle_id: int) -> Status:
    leads = vehicle_id == 1
    return Status(
        vehicle_id=vehicle_id,
        session=1,
        fleet="pair",
        formation_hash=1,
        law="weighted",
        phase=P.OBSERVE,
        mode_name="HOLD",
        armed=False,
        landed=LandedState.ON_GROUND,
        position_enu_m=(0.0, 0.0, 0.0),
        velocity_enu_m_s=(0.0, 0.0, 0.0),
        state_age_s=0.01,
        hover_thrust_norm=0.5,
        disturbance_enu_m_s2=(0.0, 0.0, 0.0),
        role=Role.LEADER if leads else Role.FOLLOWER,
        epoch=0,
        prc=vehicle_id,
        leader_beacon=None,
        leader_beacon_age_s=None,
        neighbours=(),
        slot=FlownSlot((0.0, 0.0, 0.0)),
        reference_enu_m=(0.0, 0.0, 0.0) if leads else None,
        flags=(),
        rejected={},
        last_event=None,
    )


class Vehicles:
    """A FleetSession with two vehicles, without network."""

    def __init__(self) -> None:
        self.statuses = {1: status(1), 2: status(2)}
        self.refuses: dict[tuple[int, CommandName], list[str]] = {}  # reasons, one for each refusal
        self.falls: dict[tuple[int, CommandName], str] = {}  # the procedure fails with this event
        self.mute: set[int] = set()
        self.received: list[tuple[CommandName, tuple[int, ...]]] = []
        self.leads: list[Lead] = []
        self.references: list[ReferenceChange] = []
        self._due: dict[int, tuple[float, CommandName]] = {}

    def command(
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
        self.change(vehicle_id, slot=FlownSlot(dict(change.slots_enu_m)[vehicle_id], formation=change.number))
        return CommandReply(vehicle_id, 1, True, Code.FORMATION_ACCEPTED, "yes", "anna@ground")

    def _reply(self, vehicle_id: int, name: CommandName) -> CommandReply:
        reasons = self.refuses.get((vehicle_id, name))
        if reasons:
            return CommandReply(vehicle_id, 1, False, Code.WRONG_PHASE, reasons.pop(0), "anna@ground")
        self.statuses[vehicle_id] = replace(self.statuses[vehicle_id], phase=RULES[name].via)
        self._due[vehicle_id] = (time.monotonic() + DOING_S * vehicle_id, name)
        return CommandReply(vehicle_id, 1, True, Code.PHASE_CHANGED, "yes", "anna@ground")

    def drain(self) -> list[StatusReport]:
        for vehicle_id, (due_s, name) in list(self._due.items()):
            if time.monotonic() >= due_s:
                del self._due[vehicle_id]
                self._finish(vehicle_id, name)
        sent = [as_sent(Outbox(status=status)).status for status in self.statuses.values()]
        return [StatusReport(status, TIMING) for status in sent if status and status.vehicle_id not in self.mute]

    def _finish(self, vehicle_id: int, name: CommandName) -> None:
        before = self.statuses[vehicle_id]
        if event := self.falls.get((vehicle_id, name)):
            fallen_to = P.OBSERVE if "-> observe" in event else RULES[name].on_failure
            self.statuses[vehicle_id] = replace(before, phase=fallen_to, last_event=Notice(Code.PHASE_CHANGED, event))
            return
        up = name in (C.TAKEOFF, C.FORM, C.HOLD)
        self.statuses[vehicle_id] = replace(
            before,
            phase=RULES[name].to,
            armed=name not in (C.PREPARE, C.LAND, C.RETURN, C.DISARM),
            landed=LandedState.IN_AIR if up else LandedState.ON_GROUND,
        )

    def change(self, vehicle_id: int, **what: object) -> None:
        self.statuses[vehicle_id] = replace(self.statuses[vehicle_id], **what)  # type: ignore[arg-type]


class Flight:
    def __init__(self) -> None:
        self.vehicles = Vehicles()
        self.watch = FlightWatch([1, 2], [1], time.monotonic())
        self.shown = io.StringIO()
        self.checks: list[str] = []
        self.lost: set[int] = set()
        self.director = Director(
            self.vehicles,
            self.watch,
            FlightProgress("pair", False, self.watch.began_s, self.shown),
            self._check,
            lambda: self.lost,
            MachineClock(),
        )

    def _check(self) -> None:
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
