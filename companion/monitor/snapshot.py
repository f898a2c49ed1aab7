"""The state behind the live page: a fold over reports and replies, a snapshot of it at any time, and its history. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from math import inf

from msgspec import json

from companion.config.fleet import EdgeNeighbours, FleetConfig, RangeNeighbours
from companion.ground.belief import doubts_of
from companion.ground.fleet_state import FleetState, ReportedVehicle, VehicleKey, flown_reference, fold, vehicles_at
from companion.monitor.alarms import (
    MISSING,
    NEVER_HEARD,
    OTHER_FILE,
    AlarmCondition,
    AlarmList,
    Delay,
    Key,
    conditions_of,
    doubt_conditions,
)
from companion.monitor.api import (
    AlarmView,
    FleetFileView,
    FleetView,
    History,
    HistoryPoint,
    HistorySample,
    MemberView,
    ObstacleView,
    ReplayView,
    Snapshot,
    VehicleView,
)
from companion.monitor.command_requests import described_track_enu_m
from companion.monitor.events import ENDED, EVENTS_KEPT, NOTHING_GIVEN, EventLog, Given, Happening, compare_reports
from companion.monitor.fleet_figures import FleetFigures
from companion.monitor.vehicle_view import fresh_position_enu_m, vehicle_view
from companion.types.autopilot import LandedState
from companion.types.notices import Code
from companion.types.values import Vector3
from companion.wire.messages import StatusReport

RATE_OVER_S = 3.0
HEARD_WITHIN_S = 5.0  # after the first vehicle of its fleet
TIMES_KEPT = 64  # arrival times of a vehicle's reports, for its report rate


class Picture:
    """All that is known of the fleets. Times: `now_s` is of the clock of the reports, `time_s` is Unix time."""

    def __init__(
        self,
        fleets: Mapping[str, FleetConfig],
        operator: str,
        commands: str = "",
        events_kept: int = EVENTS_KEPT,
    ) -> None:
        self._files = fleets
        self._hashes = {name: fleet.formation_hash() for name, fleet in fleets.items()}
        self._operator = operator
        self._commands = commands
        self.alarms = AlarmList()
        self.events = EventLog(events_kept)
        self._number = 0
        self._begin()

    def jump(self, time_s: float) -> None:
        """Begin again, as a replay goes on from this time: without vehicles, history, alarms and later events."""
        self.alarms.forget()
        self.events.forget_from(time_s)
        self._begin()

    def _begin(self) -> None:
        self._state = FleetState()
        self._delay = Delay()
        self._arrivals: dict[VehicleKey, deque[float]] = {}
        self._figures: dict[str, FleetFigures] = {}
        self._history = HistoryRing()
        self._homes: dict[str, dict[int, Vector3]] = {}
        self._first_s: dict[str, float] = {}  # when a fleet was first seen

    @property
    def has_vehicles(self) -> bool:
        return bool(self._state.vehicles)

    def receive(self, reports: Iterable[tuple[float, StatusReport]], unix_ahead_s: float = 0.0) -> None:
        """Reports with their times of arrival, in order. `unix_ahead_s`: Unix time less the clock of these times."""
        for arrived_s, report in reports:
            status = report.status
            key = (status.agent.fleet, status.agent.vehicle_id)
            before = self._state.vehicles.get(key)
            self._state = fold(self._state, report, arrived_s)
            self._arrivals.setdefault(key, deque(maxlen=TIMES_KEPT)).append(arrived_s)
            if before is not None:
                for kind, code, text in compare_reports(before.report.status, status):
                    self.events.add(Happening(arrived_s + unix_ahead_s, *key, kind, code, text))
            on_ground = not status.autopilot.armed and status.autopilot.landed is LandedState.ON_GROUND
            if on_ground and status.motion.is_known:
                self._homes.setdefault(status.agent.fleet, {})[status.agent.vehicle_id] = status.motion.position_enu_m
        if len(self._arrivals) > len(self._state.vehicles):
            self._forget_displaced()

    def _forget_displaced(self) -> None:
        """What is kept beside the state is bounded as it is: `fold` gave up a silent vehicle for a new one."""
        kept = self._state.vehicles
        names = {fleet for fleet, _ in kept}
        self._arrivals = {key: times for key, times in self._arrivals.items() if key in kept}
        self._first_s = {name: first_s for name, first_s in self._first_s.items() if name in names}
        self._figures = {name: figures for name, figures in self._figures.items() if name in names}
        self._homes = {
            name: {i: home for i, home in homes.items() if (name, i) in kept}
            for name, homes in self._homes.items()
            if name in names
        }

    def snapshot(
        self,
        now_s: float,
        time_s: float,
        connected: tuple[str, ...] = (),
        unreachable: tuple[str, ...] = (),
        replay: ReplayView | None = None,
    ) -> Snapshot:
        """The fleets at this time, without events. Updates alarms, figures and history."""
        self._number += 1
        vehicles = self._vehicles(now_s)
        fleets = self._fleets(now_s, vehicles)
        self._update_alarms(now_s, time_s, vehicles, () if replay else fleets)
        if self._history.is_due(now_s):
            self._history.add(now_s, time_s, vehicles, fleets)
        return Snapshot(
            number=self._number,
            time_s=time_s,
            commands=self._commands,
            operator=self._operator,
            connected=connected,
            unreachable=unreachable,
            vehicles=vehicles,
            fleets=fleets,
            alarms=self.alarms.all(),
            replay=replay,
        )

    def reported(self, now_s: float) -> list[ReportedVehicle]:
        """The vehicles at this time with their whole reports."""
        return vehicles_at(self._state, now_s)

    def _vehicles(self, now_s: float) -> tuple[VehicleView, ...]:
        return tuple(
            [
                vehicle_view(state, self._rate_hz((state.fleet, state.vehicle_id), now_s), self._files.get(state.fleet))
                for state in self.reported(now_s)
            ]
        )

    def _rate_hz(self, key: VehicleKey, now_s: float) -> float:
        """Reports of the last RATE_OVER_S per second."""
        times = self._arrivals[key]
        while times and now_s - times[0] > RATE_OVER_S:
            times.popleft()
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 and times[-1] > times[0] else 0.0

    def _fleets(self, now_s: float, vehicles: Sequence[VehicleView]) -> tuple[FleetView, ...]:
        views = []
        for name, of_fleet in groupby(vehicles, key=lambda vehicle: vehicle.fleet):
            if name not in self._figures:
                self._figures[name] = FleetFigures(name, self._files.get(name))
            views.append(self._figures[name].view(now_s, list(of_fleet)))
        return tuple(views)

    def _update_alarms(
        self, now_s: float, time_s: float, vehicles: Sequence[VehicleView], fleets: Sequence[FleetView]
    ) -> None:
        """`fleets`: those of which all vehicles are expected to report."""
        conditions: dict[Key, AlarmCondition] = {}
        for vehicle in vehicles:
            conditions |= conditions_of(vehicle)
            own_hash = self._hashes.get(vehicle.fleet)
            status = self._state.vehicles[vehicle.fleet, vehicle.vehicle_id].report.status
            if own_hash is not None and status.agent.formation_hash != own_hash:
                conditions[vehicle.fleet, vehicle.vehicle_id, Code.FLEET_FILE_DIFFERS] = OTHER_FILE
        for name in {vehicle.fleet for vehicle in vehicles if not vehicle.silent} & self._files.keys():
            conditions |= self._doubted(name, vehicles)
        conditions = self._delay.lasting(now_s, conditions)
        for fleet in fleets:
            if now_s - self._first_s.setdefault(fleet.name, now_s) >= HEARD_WITHIN_S:
                conditions |= {(fleet.name, i, NEVER_HEARD): MISSING for i in fleet.missing_ids}
        changes = self.alarms.update(time_s, conditions)
        for alarm in changes.begun:
            self._alarm_event(time_s, alarm, alarm.text)
        for alarm in changes.ended:
            text = f"ended after {time_s - alarm.since_s:.1f} s: {alarm.text}"
            self._alarm_event(time_s, alarm, text, Given(outcome=ENDED))

    def _doubted(self, name: str, vehicles: Sequence[VehicleView]) -> dict[Key, AlarmCondition]:
        """What the vehicles of a fleet that report now cannot mean."""
        heard = [v.vehicle_id for v in vehicles if v.fleet == name and not v.silent]
        statuses = [self._state.vehicles[name, i].report.status for i in heard]
        return doubt_conditions(name, doubts_of(statuses, self._files[name]))

    def _alarm_event(self, time_s: float, alarm: AlarmView, text: str, given: Given = NOTHING_GIVEN) -> None:
        self.events.add(Happening(time_s, alarm.fleet, alarm.vehicle_id, "alarm", alarm.code, text, given))

    def history(self) -> History:
        return History(self._history.points(), self.events.all())

    def fleet_map(self, name: str) -> FleetFileView | None:
        """None without the fleet file of this fleet."""
        file = self._files.get(name)
        described = flown_reference(self._state, name)
        track_enu_m = described_track_enu_m(json.encode(described)) if described else ()
        return fleet_map(file, self._homes.get(name, {}), track_enu_m) if file else None


PERIOD_S = 0.5
KEPT_S = 600.0


class HistoryRing:
    """Points in rising order of time, one for each fleet."""

    def __init__(self) -> None:
        self._points: deque[HistoryPoint] = deque()
        self._added_s = -inf

    def is_due(self, now_s: float) -> bool:
        """By the clock of the reports: Unix time may be set back."""
        return now_s - self._added_s >= PERIOD_S - 1e-6

    def add(self, now_s: float, time_s: float, vehicles: Sequence[VehicleView], fleets: Sequence[FleetView]) -> None:
        """Vehicles that are silent are left out: old values are no history of now."""
        self._added_s = now_s
        while self._points and self._points[-1].time_s >= time_s:  # the clock was set back
            self._points.pop()
        for fleet in fleets:
            samples = tuple([_sample(v) for v in vehicles if v.fleet == fleet.name and not v.silent])
            self._points.append(HistoryPoint(time_s, fleet.name, fleet.smallest_separation_m, samples))
        while self._points and self._points[0].time_s <= time_s - KEPT_S + 1e-6:
            self._points.popleft()

    def points(self) -> tuple[HistoryPoint, ...]:
        return tuple(self._points)


def _sample(vehicle: VehicleView) -> HistorySample:
    place_enu_m = fresh_position_enu_m(vehicle)
    return HistorySample(
        vehicle_id=vehicle.vehicle_id,
        altitude_m=place_enu_m[2] if place_enu_m else None,
        error_to_slot_m=vehicle.error_to_slot_m,
        battery_percent=vehicle.battery_percent,
        late_p99_ms=vehicle.timing.late_p99_ms,
        nearest_m=vehicle.nearest.distance_m if vehicle.nearest else None,
    )


NO_ORIGIN = (0.0, 0.0, 0.0)  # stands for the origin of a fleet indoors, which has no map


def fleet_map(
    fleet: FleetConfig, homes_enu_m: Mapping[int, Vector3], reference_enu_m: tuple[Vector3, ...] = ()
) -> FleetFileView:
    """`homes_enu_m` is where each vehicle was last disarmed on the ground, `reference_enu_m` the line of the reference."""
    envelope, neighbours = fleet.envelope, fleet.neighbours
    (low_x, low_y, floor_m), (high_x, high_y, ceiling_m) = envelope.fence_min_enu_m, envelope.fence_max_enu_m
    box = ((low_x, low_y), (high_x, low_y), (high_x, high_y), (low_x, high_y))
    bodies = [section.body for section in fleet.obstacles]
    return FleetFileView(
        name=fleet.name,
        law=fleet.law.name,
        origin=NO_ORIGIN if fleet.origin == "indoor" else fleet.origin.as_tuple(),
        members=tuple(MemberView(m.id, m.role, m.can_lead, m.slot_enu_m) for m in fleet.vehicles),
        edges=neighbours.edges if isinstance(neighbours, EdgeNeighbours) else (),
        range_m=neighbours.range_m if isinstance(neighbours, RangeNeighbours) else None,
        separation_m=fleet.separation_m,
        fence_outline_enu_m=envelope.fence_corners_enu_m or box,
        fence_floor_m=floor_m,
        fence_ceiling_m=ceiling_m,
        clearance_m=envelope.clearance_m,
        obstacles=tuple(ObstacleView(body.outline_enu_m, body.bottom_m, body.top_m) for body in bodies),
        homes_enu_m=dict(homes_enu_m),
        reference_enu_m=reference_enu_m,
    )
