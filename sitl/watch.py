"""What the vehicles said during a flight: their newest status, when each entered formation, what happened to them."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Collection, Mapping

from msgspec import Struct

from companion.core.formation import Place
from companion.core.reference import ReferenceTrajectory
from companion.geometry.turning import turned_slot
from companion.ground.fleet_status import FleetState, VehicleRow, fold, rows
from companion.types import ZERO3, CommandName, CommandReply, FlightPhase, LandedState, Role, Status, Vector3
from companion.wire.ground import StatusReport, Timing
from sitl.metrics import Formation
from sitl.timeline import TimelineStep
from sitl.tracking import Leads
from sitl.tracks import Track, told_track

SAME_POSITION_S = 0.005  # of the same position told twice, whose ages are not quite those of the way
SILENT_S = 3.0  # a flying vehicle's agent that says nothing for so long has failed


class Event(Struct, frozen=True, kw_only=True):
    """Something that a vehicle said, `time_s` after the flight's beginning."""

    time_s: float
    vehicle: int
    event: str


class AskedFor(Struct, frozen=True, kw_only=True):
    """A command to some vehicles at once, `time_s` after the flight's beginning.

    `answered_in_s` is how long it took until the last of them had answered; None where one did not.
    """

    time_s: float
    command: CommandName
    in_words: str  # with what went with it
    vehicles: list[int]
    answered_in_s: float | None


class TopologyChange(Struct, frozen=True, kw_only=True):
    """A vehicle's part of the topology from `time_s` after the flight's beginning on, until its next one."""

    time_s: float
    vehicle: int
    role: Role
    epoch: int
    prc: int
    neighbours: tuple[int, ...]
    in_formation: bool

    def same_as(self, status: Status) -> bool:
        own = (self.role, self.epoch, self.prc, self.neighbours, self.in_formation)
        told = (status.role, status.epoch, status.prc, status.neighbours, status.phase is FlightPhase.FORMATION)
        return own == told


class FlightWatch:
    """A record that grows with every report. Times are of one monotonic clock, given as arguments.

    `events` tell when the lead changed, in the vehicles' words; `topology` has it with PrCs and neighbours, to be drawn.
    """

    def __init__(self, vehicle_ids: Collection[int], leader_ids: Collection[int], began_s: float) -> None:
        """`leader_ids` lead at the beginning."""
        self.vehicle_ids = sorted(vehicle_ids)
        self.began_s = began_s
        self.events: list[Event] = []
        self.topology: list[TopologyChange] = []
        self.commands: list[AskedFor] = []
        self.timing: dict[int, Timing] = {}  # of each vehicle's last formation
        self.formations: list[Formation] = []  # all in formation at once, in the order in which they were flown
        # Of each vehicle: when it was where, by its own estimate. From its being armed on, later ones last.
        self.told: dict[int, list[tuple[float, Vector3]]] = {vehicle_id: [] for vehicle_id in self.vehicle_ids}
        self._slots: dict[int, list[tuple[float, Vector3]]] = {vehicle_id: [] for vehicle_id in self.vehicle_ids}
        self.reference: list[tuple[float, Vector3]] = []  # r as leaders flew it, by the fleet's time
        self._leader_ids = set(leader_ids)
        self._drawn: dict[int, TopologyChange] = {}  # the last of every vehicle
        self._entered_s: dict[int, float] = {}
        self.largest_step_deg: dict[int, float] = {}  # of each vehicle's last formation
        self._zero_s: dict[int, float] = {}  # had the RFT never stood, it would have begun here
        self._flown_s = 0.0  # how far into the RFT the last leader was
        self._formed_from_s: float | None = None
        self._reference_start_s = began_s
        self._state = FleetState()
        self._statuses: dict[int, Status] = {}  # the newest of every vehicle heard

    def hear(self, report: StatusReport, now_s: float) -> None:
        """Take in one report that came at `now_s`."""
        status = report.status
        vehicle_id = status.vehicle_id
        if vehicle_id not in self.vehicle_ids:
            return
        before = self.status(vehicle_id)
        self._state = fold(self._state, report, now_s)
        self._statuses[vehicle_id] = status
        self._follow_topology(status, now_s)
        self._follow_position(status, now_s)
        self._follow_slot(status, now_s)
        if status.phase is FlightPhase.FORMATION and (before is None or before.phase is not FlightPhase.FORMATION):
            self._entered_s[vehicle_id] = now_s
            self._zero_s[vehicle_id] = now_s - self._flown_s
        self._follow_reference(status)
        if vehicle_id in self._entered_s:
            self.largest_step_deg[vehicle_id] = status.largest_step_deg
        if vehicle_id in self._entered_s and report.timing.ticks:  # in virtual time no ticks are timed
            self.timing[vehicle_id] = report.timing
        if status.last_event and (before is None or status.last_event != before.last_event):
            self.events.append(
                Event(time_s=round(now_s - self.began_s, 3), vehicle=vehicle_id, event=status.last_event)
            )

    def _follow_position(self, status: Status, now_s: float) -> None:
        told, time_s = self.told[status.vehicle_id], now_s - status.state_age_s
        if status.armed and (not told or time_s > told[-1][0] + SAME_POSITION_S):
            told.append((time_s, status.position_enu_m))

    def _follow_slot(self, status: Status, now_s: float) -> None:
        """Where it stands, its first and its last time are enough."""
        slots, slot_enu_m = self._slots[status.vehicle_id], turned_slot(status.slot, status.heading).position_enu_m
        if len(slots) > 1 and slots[-1][1] == slots[-2][1] == slot_enu_m:
            slots.pop()
        slots.append((now_s, slot_enu_m))

    def slots(self) -> dict[int, Track]:
        """Each vehicle's slot d_i0 over time, as it said itself: as it is flown, turned to the formation's heading."""
        return {i: told_track(i, told) for i, told in self._slots.items()}

    def note_answers(
        self, asked_s: float, now_s: float, step: TimelineStep, replies: Mapping[int, CommandReply | None]
    ) -> None:
        """Take in what was answered to a step's command that was given at `asked_s`. Agents that only start answer nothing."""
        if any(self.status(vehicle_id) is None for vehicle_id in replies):
            return
        self.commands.append(
            AskedFor(
                time_s=round(asked_s - self.began_s, 3),
                command=step.command,
                in_words=step.in_words(),
                vehicles=sorted(replies),
                answered_in_s=round(now_s - asked_s, 3) if all(replies.values()) else None,
            )
        )

    def leads(self) -> Leads:
        """When each vehicle led, as it said itself."""
        return {
            i: [
                (self.began_s + change.time_s, change.role is Role.LEADER)
                for change in self.topology
                if change.vehicle == i
            ]
            for i in self.vehicle_ids
        }

    def told_reference(self) -> ReferenceTrajectory:
        """The RFT as it was flown, where commands changed it or a target led it: straight between what leaders said."""
        times_s = [time_s for time_s, _ in self.reference]

        def trajectory(reference_s: float) -> Place:
            index = min(max(bisect_right(times_s, reference_s), 1), len(times_s) - 1)
            (a_s, a), (b_s, b) = self.reference[index - 1], self.reference[index]
            share = min(max((reference_s - a_s) / (b_s - a_s), 0.0), 1.0)
            x, y, z = (p + share * (q - p) for p, q in zip(a, b, strict=True))
            return Place((x, y, z), ZERO3)

        return trajectory

    def _follow_reference(self, status: Status) -> None:
        """From one formation to the next it goes on, from one flight to the next it does not."""
        if not status.armed:
            self._flown_s = 0.0
        elif status.role is Role.LEADER and status.leader_word and status.leader_word.reference_s > 0.0:
            self._flown_s = status.leader_word.reference_s
            if status.reference_enu_m is not None:
                while self.reference and self.reference[-1][0] >= self._flown_s:
                    self.reference.pop()  # of a flight before, or the last leader's last word
                self.reference.append((self._flown_s, status.reference_enu_m))

    def _follow_topology(self, status: Status, now_s: float) -> None:
        vehicle_id, last = status.vehicle_id, self._drawn.get(status.vehicle_id)
        if status.role is Role.LEADER:
            self._leader_ids.add(vehicle_id)
        else:
            self._leader_ids.discard(vehicle_id)
        if last is None or not last.same_as(status):
            self._drawn[vehicle_id] = TopologyChange(
                time_s=round(now_s - self.began_s, 3),
                vehicle=vehicle_id,
                role=status.role,
                epoch=status.epoch,
                prc=status.prc,
                neighbours=status.neighbours,
                in_formation=status.phase is FlightPhase.FORMATION,
            )
            self.topology.append(self._drawn[vehicle_id])

    def status(self, vehicle_id: int) -> Status | None:
        return self._statuses.get(vehicle_id)

    def is_armed(self, vehicle_id: int) -> bool:
        """As it was last heard."""
        status = self.status(vehicle_id)
        return status is not None and status.armed

    def flown_by_others(self) -> set[int]:
        """Vehicles in the air whose agent only watches: their pilot has them, or their autopilot's failsafe."""
        statuses = {i: status for i in self.vehicle_ids if (status := self.status(i)) and status.armed}
        return {
            i
            for i, status in statuses.items()
            if status.phase is FlightPhase.OBSERVE and status.landed is not LandedState.ON_GROUND
        }

    def rows(self, now_s: float) -> list[VehicleRow]:
        return rows(self._state, now_s)

    def silent(self, now_s: float) -> list[int]:
        """Vehicles that were heard once and say nothing any more."""
        return sorted(i for (_, i), heard in self._state.vehicles.items() if now_s - heard.received_s > SILENT_S)

    def begin_formation(self) -> float:
        """All vehicles are in formation. Returns when the last one entered it."""
        self._formed_from_s = max(self._entered_s[i] for i in self.vehicle_ids)
        self._reference_start_s = min(self._zero_s[i] for i in self._leader_ids)
        return self._formed_from_s

    @property
    def formation(self) -> Formation | None:
        """The last one flown."""
        return self.formations[-1] if self.formations else None

    def end_formation(self, now_s: float) -> None:
        """The formation, if there is one, ends now."""
        if self._formed_from_s is not None:
            self.formations.append(Formation(self._formed_from_s, now_s, self._reference_start_s))
            self._formed_from_s = None

    def rejected(self) -> Mapping[int, dict[str, int]]:
        """What each vehicle refused to believe, counted by reason."""
        statuses = {vehicle_id: self.status(vehicle_id) for vehicle_id in self.vehicle_ids}
        return {vehicle_id: status.rejected if status else {} for vehicle_id, status in statuses.items()}


def vehicles_in_words(ids: Collection[int]) -> str:
    """ "vehicle 3", "vehicles 1, 2"."""
    return f"vehicle{'s' if len(ids) > 1 else ''} {', '.join(map(str, ids))}"
