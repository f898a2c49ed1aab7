"""Record of one flight from the vehicles' reports: newest status, formations, events, topology, timing."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Collection, Mapping

from companion.core.reference.blend import ReferenceTrajectory
from companion.geometry.formations import turned_slot
from companion.ground.answers import TimedReply, id_list
from companion.ground.fleet_state import FleetState, ReportedVehicle, fold, vehicles_at
from companion.types.autopilot import LandedState
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FormationState
from companion.types.notices import Code
from companion.types.status import Status
from companion.types.values import ZERO3, Vector3
from companion.wire.messages import StatusReport, Timing
from sitl.flight.scenario import Scenario, TimelineStep
from sitl.report.metrics import Formation, Leadership, Track, reported_track
from sitl.report.summary import CommandGiven, ReportedEvent, TopologyChange, overload

SAME_POSITION_S = 0.005  # two reports of one position differ by less, because the transport time varies
LONGEST_REPORTED_S = 0.5  # for which one report stands
FILTERED_M_S2 = 0.02  # a smaller change of the command by the separation filter is none
NEARLY_THERE_S = 0.5  # a slot that moves for less by a report of the last tenth of a second has arrived
SILENT_S = 3.0  # the agent of a flying vehicle that reports nothing for so long has failed


class FlightWatch:
    """The record of one flight. Times are of one monotonic clock and are arguments.

    `events` holds every event that a vehicle reported, `topology` every change of role, PrC and neighbours.
    """

    def __init__(self, vehicle_ids: Collection[int], leader_ids: Collection[int], began_s: float) -> None:
        """`leader_ids` are the leaders at the beginning."""
        self.vehicle_ids = sorted(vehicle_ids)
        self.began_s = began_s
        self.events: list[ReportedEvent] = []
        self.topology: list[TopologyChange] = []
        self.commands: list[CommandGiven] = []
        self.timing: dict[int, Timing] = {}  # of each vehicle's last formation
        self.formations: list[Formation] = []  # all in formation at once, in the order in which they were flown
        # Of each vehicle: time and estimated position, while armed, times rising.
        self.reported: dict[int, list[tuple[float, Vector3]]] = {vehicle_id: [] for vehicle_id in self.vehicle_ids}
        # r as leaders in formation reported it, by the time of the report.
        self.led_enu_m: list[tuple[float, Vector3]] = []
        self.under_way_s: dict[
            int, float
        ] = {}  # at the end of the last formation: how long slots would still have moved
        self.slot_moved_s: dict[int, float] = {}  # when the slot of a vehicle last moved within the formation
        self._slots: dict[int, list[tuple[float, Vector3]]] = {vehicle_id: [] for vehicle_id in self.vehicle_ids}
        self.reference: list[tuple[float, Vector3]] = []  # r as leaders reported it, by mission time
        self._leader_ids = set(leader_ids)
        self._drawn: dict[int, TopologyChange] = {}  # the last of every vehicle
        self._entered_s: dict[int, float] = {}
        self.largest_step_deg: dict[int, float] = {}  # of each vehicle's last formation
        # Of each vehicle in formation: how long the separation filter changed its command, by its reports.
        self.filter_acted_s: dict[int, float] = {}
        self._reported_s: dict[int, float] = {}
        self._zero_s: dict[int, float] = {}  # when the RFT would have begun had it never paused
        self._flown_s = 0.0  # time into the RFT, of the last leader
        self._formed_from_s: float | None = None
        self._reference_start_s = began_s
        self.newest_timing: dict[int, Timing] = {}
        self._state = FleetState()
        self._statuses: dict[int, Status] = {}  # the newest of every vehicle

    def receive(self, report: StatusReport, now_s: float) -> None:
        """Process one report received at `now_s`."""
        status = report.status
        vehicle_id = status.agent.vehicle_id
        if vehicle_id not in self.vehicle_ids:
            return
        before = self.status(vehicle_id)
        self._state = fold(self._state, report, now_s)
        self._statuses[vehicle_id] = status
        self._follow_topology(status, now_s)
        self._follow_position(status, now_s)
        self._follow_slot(status, now_s)
        self._follow_filter(status, now_s)
        if status.phase is FlightPhase.FORMATION and (before is None or before.phase is not FlightPhase.FORMATION):
            self._entered_s[vehicle_id] = now_s
            self._zero_s[vehicle_id] = now_s - self._flown_s
        self._follow_reference(status, now_s)
        if report.timing.ticks:  # in virtual time no ticks are timed
            self.newest_timing[vehicle_id] = report.timing
        if vehicle_id in self._entered_s:
            self.largest_step_deg[vehicle_id] = status.control.largest_step_deg
            if report.timing.ticks:
                self.timing[vehicle_id] = report.timing
        event, time_s = status.last_event, round(now_s - self.began_s, 3)
        if event and (before is None or event != before.last_event):
            self.events.append(ReportedEvent(time_s=time_s, vehicle=vehicle_id, code=event.code, event=event.text))

    def _follow_position(self, status: Status, now_s: float) -> None:
        reported, time_s = self.reported[status.agent.vehicle_id], now_s - status.motion.state_age_s
        if status.autopilot.armed and (not reported or time_s > reported[-1][0] + SAME_POSITION_S):
            reported.append((time_s, status.motion.position_enu_m))

    def _follow_slot(self, status: Status, now_s: float) -> None:
        """Of a constant slot only the first and the last time are kept."""
        vehicle_id, slot, heading = status.agent.vehicle_id, status.formation.slot, status.formation.heading
        if slot.moves:
            self.slot_moved_s[vehicle_id] = now_s
        slots, slot_enu_m = self._slots[vehicle_id], turned_slot(slot, heading).position_enu_m
        if len(slots) > 1 and slots[-1][1] == slots[-2][1] == slot_enu_m:
            slots.pop()
        slots.append((now_s, slot_enu_m))

    def _follow_filter(self, status: Status, now_s: float) -> None:
        """A report stands for the time since the one before."""
        vehicle_id = status.agent.vehicle_id
        since_s = min(now_s - self._reported_s.get(vehicle_id, now_s), LONGEST_REPORTED_S)
        self._reported_s[vehicle_id] = now_s
        if status.phase is FlightPhase.FORMATION and status.safety.separation.changed_m_s2 > FILTERED_M_S2:
            self.filter_acted_s[vehicle_id] = self.filter_acted_s.get(vehicle_id, 0.0) + since_s

    def slots(self) -> dict[int, Track]:
        """Each vehicle's slot d_i0 over time, as it reported it, turned to the formation's heading."""
        return {i: reported_track(i, slots) for i, slots in self._slots.items()}

    def note_answers(
        self, given_s: float, now_s: float, step: TimelineStep, answers: Mapping[int, TimedReply | None]
    ) -> None:
        """Record the answers to a step's command given at `given_s`, unless an agent has not started yet."""
        if any(self.status(vehicle_id) is None for vehicle_id in answers):
            return
        self.commands.append(
            CommandGiven(
                time_s=round(given_s - self.began_s, 3),
                command=step.command,
                in_words=step.in_words(),
                vehicles=sorted(answers),
                answered_in_s=round(now_s - given_s, 3) if all(answers.values()) else None,
            )
        )

    def leads(self) -> Leadership:
        """When each vehicle was leader, as it reported."""
        leads: dict[int, list[tuple[float, bool]]] = {i: [] for i in self.vehicle_ids}
        for change in self.topology:
            leads[change.vehicle].append((self.began_s + change.time_s, change.role is Role.LEADER))
        return leads

    def reported_reference(self) -> ReferenceTrajectory:
        """The RFT as leaders reported it, interpolated linearly."""
        times_s = [time_s for time_s, _ in self.reference]

        def trajectory(reference_s: float) -> FormationState:
            index = min(max(bisect_right(times_s, reference_s), 1), len(times_s) - 1)
            (a_s, a), (b_s, b) = self.reference[index - 1], self.reference[index]
            share = min(max((reference_s - a_s) / (b_s - a_s), 0.0), 1.0)
            x, y, z = (p + share * (q - p) for p, q in zip(a, b, strict=True))
            return FormationState((x, y, z), ZERO3)

        return trajectory

    def _follow_reference(self, status: Status, now_s: float) -> None:
        """The RFT continues from one formation to the next until the vehicles are disarmed."""
        reference_enu_m, lead = status.formation.reference_enu_m, status.leadership
        if status.phase is FlightPhase.FORMATION and reference_enu_m is not None:
            self.led_enu_m.append((now_s, reference_enu_m))
        if not status.autopilot.armed:
            self._flown_s = 0.0
        elif lead.role is Role.LEADER and lead.leader_beacon and lead.leader_beacon.reference_s > 0.0:
            self._flown_s = lead.leader_beacon.reference_s
            if reference_enu_m is not None:
                while self.reference and self.reference[-1][0] >= self._flown_s:
                    self.reference.pop()  # of an earlier flight, or the last report of the leader before
                self.reference.append((self._flown_s, reference_enu_m))

    def _follow_topology(self, status: Status, now_s: float) -> None:
        vehicle_id, last = status.agent.vehicle_id, self._drawn.get(status.agent.vehicle_id)
        if status.leadership.role is Role.LEADER:
            self._leader_ids.add(vehicle_id)
        else:
            self._leader_ids.discard(vehicle_id)
        if last is None or not last.same_as(status):
            self._drawn[vehicle_id] = TopologyChange(
                time_s=round(now_s - self.began_s, 3),
                vehicle=vehicle_id,
                role=status.leadership.role,
                epoch=status.leadership.epoch,
                prc=status.leadership.prc,
                neighbours=status.neighbourhood.neighbours,
                in_formation=status.phase is FlightPhase.FORMATION,
            )
            self.topology.append(self._drawn[vehicle_id])

    def status(self, vehicle_id: int) -> Status | None:
        return self._statuses.get(vehicle_id)

    def statuses(self) -> list[Status]:
        """The newest status of each vehicle that ever reported, by id."""
        return [status for i in self.vehicle_ids if (status := self.status(i))]

    def flown_by_others(self) -> set[int]:
        """Vehicles in the air whose agent only observes: a pilot or an autopilot failsafe flies them."""
        observing = [
            status for status in self.statuses() if status.autopilot.armed and status.phase is FlightPhase.OBSERVE
        ]
        return {status.agent.vehicle_id for status in observing if status.autopilot.landed is not LandedState.ON_GROUND}

    def vehicles_at(self, now_s: float) -> list[ReportedVehicle]:
        return vehicles_at(self._state, now_s)

    def silent(self, now_s: float) -> list[int]:
        """Vehicles that reported before, but not for SILENT_S."""
        return sorted(i for (_, i), newest in self._state.vehicles.items() if now_s - newest.received_s > SILENT_S)

    def failed_agents(self) -> list[ReportedEvent]:
        """What agents that ended by a defect reported last, in their order."""
        return [event for event in self.events if event.code is Code.AGENT_FAILED]

    def begin_formation(self) -> float:
        """The vehicles are in formation, the leaders among them. Returns the time at which the last one entered it."""
        self._formed_from_s = max(self._entered_s.values())
        self._reference_start_s = min(self._zero_s[i] for i in self._leader_ids if i in self._zero_s)
        return self._formed_from_s

    @property
    def is_in_formation(self) -> bool:
        """Between `begin_formation` and `end_formation`."""
        return self._formed_from_s is not None

    @property
    def formation(self) -> Formation | None:
        """The last formation flown."""
        return self.formations[-1] if self.formations else None

    def end_formation(self, now_s: float) -> None:
        """The formation, if there is one, ends now."""
        if self._formed_from_s is not None:
            self.formations.append(Formation(self._formed_from_s, now_s, self._reference_start_s))
            self._formed_from_s = None
            flying = [status for status in self.statuses() if status.phase is FlightPhase.FORMATION]
            left_s = {status.agent.vehicle_id: status.formation.slot.moves_for_s for status in flying}
            self.under_way_s = {i: round(seconds, 1) for i, seconds in left_s.items() if seconds > NEARLY_THERE_S}

    def overload(self) -> str | None:
        """What the agents measured beyond the limits of real time, in one line; None within them."""
        timings = self.newest_timing.values()
        ticks, missed = sum(t.ticks for t in timings), sum(t.missed for t in timings)
        return overload(ticks, missed, max((t.telemetry_to_command_us.p99 for t in timings), default=0.0))


def watch_of(scenario: Scenario, began_s: float) -> FlightWatch:
    """The empty record of a flight of this scenario."""
    members = scenario.fleet.vehicles
    leader_ids = [member.id for member in members if member.role is Role.LEADER]
    return FlightWatch([member.id for member in members], leader_ids, began_s)


def reasons_in_words(reasons: Mapping[int, str]) -> str:
    """Each reason once, with all vehicles that have it: "vehicles 1, 2: no answer; vehicle 3: ..."."""
    vehicles: dict[str, list[int]] = {}
    for vehicle_id, reason in reasons.items():
        vehicles.setdefault(reason, []).append(vehicle_id)
    return "; ".join(f"{id_list(ids)}: {reason}" for reason, ids in vehicles.items())
