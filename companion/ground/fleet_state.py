"""The state of a fleet on the ground: a pure fold over status reports. No clock, no sockets; times are arguments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from math import degrees, dist

from companion.geometry.formations import turned_slot
from companion.geometry.vectors import plus
from companion.types.autopilot import LandedState
from companion.types.commands import Described
from companion.types.flight import WITHOUT_LEADER, FlightPhase, HealthFlag, Role
from companion.types.formation import EAST, FlownSlot, Heading
from companion.types.status import Status
from companion.types.values import Vector3
from companion.wire.messages import StatusReport

MOST_VEHICLES = 500
SILENT_AFTER_S = 1.0  # ten reports missed
IN_FLIGHT = (LandedState.IN_AIR, LandedState.TAKEOFF, LandedState.LANDING)

PAST_TAKEOFF = frozenset({FlightPhase.HOLD, FlightPhase.ENGAGE, FlightPhase.FORMATION, FlightPhase.RELEASE})

VehicleKey = tuple[str, int]  # fleet name, vehicle id


@dataclass(frozen=True, slots=True)
class Received:
    """A vehicle's newest report and its time of arrival; `described`: the reference it flies, once it has described it."""

    received_s: float
    report: StatusReport
    described: Described | None = None


@dataclass(frozen=True, slots=True)
class FleetState:
    """Every vehicle that ever reported. One leaves it only for another one, beyond MOST_VEHICLES."""

    vehicles: Mapping[VehicleKey, Received] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ReportedVehicle:
    """One vehicle as the ground sees it at one time: its newest report, and what this time and the other vehicles add to it.

    `age_s` is the time since the report; `data_age_s` adds the age of the position on board (inf where there never was one).
    `flags` has LEADER_AWAITED and LEADER_LOST only while a flight of the fleet is under way. `reference_enu_m` is the point
    that its slot is relative to: its own, or that of its leader. `slot_position_enu_m` is the place of its slot now, and
    `error_to_slot_m` |(x_i - d_i0) - r|: None where no leader reports, the vehicle does not fly, or its position is older
    than SILENT_AFTER_S.
    """

    report: StatusReport
    age_s: float
    data_age_s: float
    silent: bool
    flags: tuple[HealthFlag, ...]
    reference_enu_m: Vector3 | None = None
    slot_position_enu_m: Vector3 | None = None
    error_to_slot_m: float | None = None

    @property
    def status(self) -> Status:
        return self.report.status

    @property
    def vehicle_id(self) -> int:
        return self.report.status.agent.vehicle_id

    @property
    def fleet(self) -> str:
        return self.report.status.agent.fleet

    @property
    def rejected(self) -> int:
        """Messages that it has rejected, of all codes."""
        return sum(self.report.status.rejected.values())


def fold(state: FleetState, report: StatusReport, now_s: float) -> FleetState:
    """The state with one more report, received at `now_s` (any monotonic clock, the same as for `vehicles_at`)."""
    key = (report.status.agent.fleet, report.status.agent.vehicle_id)
    vehicles = dict(state.vehicles)
    if key not in vehicles and len(vehicles) >= MOST_VEHICLES:
        oldest = min(vehicles, key=lambda i: vehicles[i].received_s)
        if not _is_silent(vehicles[oldest], now_s):
            return state  # a stranger with many names does not displace a vehicle that reports
        del vehicles[oldest]
    described = report.status.formation.described or _still_described(vehicles.get(key), report.status)
    return FleetState(vehicles | {key: Received(now_s, report, described)})


def _still_described(before: Received | None, status: Status) -> Described | None:
    """The description in an earlier report, where the vehicle flies that reference still."""
    if before is None or before.report.status.agent.session != status.agent.session:
        return None
    was, held = before.report.status.formation.reference, status.formation.reference
    same = was and held and (was.flown, was.begun_s) == (held.flown, held.begun_s)
    return before.described if same else None


def flown_reference(state: FleetState, fleet: str) -> Described | None:
    """The reference that the leader of a fleet has described: the one that reported last."""
    leaders = [
        received
        for (name, _), received in state.vehicles.items()
        if name == fleet and received.report.status.leadership.role is Role.LEADER
    ]
    return max(leaders, key=lambda leader: leader.received_s).described if leaders else None


def vehicles_at(state: FleetState, now_s: float) -> list[ReportedVehicle]:
    """All vehicles that ever reported, by fleet and id."""
    ordered = [state.vehicles[key] for key in sorted(state.vehicles)]
    fleets = [list(of_fleet) for _, of_fleet in groupby(ordered, key=lambda one: one.report.status.agent.fleet)]
    return [_vehicle(facts, received, now_s) for one in fleets for facts in [_facts(one, now_s)] for received in one]


@dataclass(frozen=True, slots=True)
class _FleetFacts:
    """`under_way`: a vehicle is in flight, past its takeoff: from then on a leader publishes its beacon.

    `references_enu_m` has those of the leaders that report, by rising id.
    """

    under_way: bool
    references_enu_m: Mapping[int, Vector3]


def _facts(fleet: Sequence[Received], now_s: float) -> _FleetFacts:
    reporting = [received.report.status for received in fleet if not _is_silent(received, now_s)]
    return _FleetFacts(
        any(status.phase in PAST_TAKEOFF for status in reporting),
        {s.agent.vehicle_id: s.formation.reference_enu_m for s in reporting if s.formation.reference_enu_m is not None},
    )


def _vehicle(facts: _FleetFacts, received: Received, now_s: float) -> ReportedVehicle:
    status = received.report.status
    motion, flags = status.motion, status.safety.flags
    age_s, silent = now_s - received.received_s, _is_silent(received, now_s)
    data_age_s = age_s + motion.state_age_s
    reference_enu_m = _reference_enu_m(facts, status)
    slot_position_enu_m = error_to_slot_m = None
    if reference_enu_m is not None:
        slot_position_enu_m = slot_position(status.formation.slot, status.formation.heading, reference_enu_m)
        if status.autopilot.landed in IN_FLIGHT and data_age_s <= SILENT_AFTER_S and not silent:
            error_to_slot_m = dist(motion.position_enu_m, slot_position_enu_m)
    if not facts.under_way:
        flags = tuple(flag for flag in flags if flag not in WITHOUT_LEADER)
    return ReportedVehicle(
        received.report, age_s, data_age_s, silent, flags, reference_enu_m, slot_position_enu_m, error_to_slot_m
    )


def _is_silent(received: Received, now_s: float) -> bool:
    return now_s - received.received_s > SILENT_AFTER_S


def slot_position(slot: FlownSlot, heading: Heading, reference_enu_m: Vector3) -> Vector3:
    """Where a slot is in the fleet frame, m."""
    return plus(reference_enu_m, turned_slot(slot, heading).position_enu_m)


def _reference_enu_m(facts: _FleetFacts, status: Status) -> Vector3 | None:
    """The vehicle's own reference, else that of the leader of its leader beacon, else of any leader that reports."""
    if status.formation.reference_enu_m is not None:
        return status.formation.reference_enu_m
    known, beacon = facts.references_enu_m, status.leadership.leader_beacon
    if beacon and beacon.leader_id in known:
        return known[beacon.leader_id]
    return next(iter(known.values()), None)


def formation_text(status: Status) -> str:
    """ "1", "1, then 2" or "changing to 2"; with the heading where that is not east."""
    slot, heading = status.formation.slot, status.formation.heading
    pointed = "" if heading == EAST else f" at {degrees(heading.angle_rad):.0f} deg"
    if slot.waiting != slot.formation:
        return f"{slot.formation}, then {slot.waiting}{pointed}"
    return f"{'changing to ' if slot.moves else ''}{slot.formation}{pointed}"


def reference_text(status: Status) -> str:
    """ "1" or "1, then 2", with the age of the target followed; "-" where the vehicle holds none."""
    held, target_age_s = status.formation.reference, status.formation.target_age_s
    if held is None:
        return "-"
    reference = str(held.flown) if held.waiting == held.flown else f"{held.flown}, then {held.waiting}"
    return reference if target_age_s is None else f"{reference}, target {target_age_s:.1f} s old"
