"""The state of a fleet on the ground: a pure fold over status reports. No clock, no sockets; times are arguments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from math import degrees, dist

from companion.geometry.formations import turned_slot
from companion.types.autopilot import LandedState, PositionError
from companion.types.flight import WITHOUT_LEADER, FlightPhase, HealthFlag, Role
from companion.types.formation import EAST, FlownSlot, Heading, HeldReference
from companion.types.notices import Notice
from companion.types.status import NetworkState, SeparationReport, Status
from companion.types.values import Vector3
from companion.wire.messages import StatusReport, Timing

MOST_VEHICLES = 500
SILENT_AFTER_S = 1.0  # ten reports missed
_FLYING = (LandedState.IN_AIR, LandedState.TAKEOFF, LandedState.LANDING)

PAST_TAKEOFF = frozenset({FlightPhase.HOLD, FlightPhase.ENGAGE, FlightPhase.FORMATION, FlightPhase.RELEASE})

VehicleKey = tuple[str, int]  # fleet name, vehicle id


@dataclass(frozen=True, slots=True)
class Received:
    """A vehicle's newest report and its time of arrival."""

    received_s: float
    report: StatusReport


@dataclass(frozen=True, slots=True)
class FleetState:
    """Every vehicle that ever reported. One leaves it only for another one, beyond MOST_VEHICLES."""

    vehicles: Mapping[VehicleKey, Received] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class VehicleRow:
    """One vehicle as the ground sees it at one time.

    `age_s` is the time since the last report; `data_age_s` adds the age of the position on board (inf where there never was
    one). `peers` are fresh ones; `lacks` is what keeps it from flying besides flags. `error_to_slot_m` is |(x_i - d_i0) - r|,
    None where no leader reports, the vehicle does not fly, or its position is older than SILENT_AFTER_S. `holder` is the
    operator who holds command. `flags` has LEADER_AWAITED and LEADER_LOST only while a flight of the fleet is under way.
    """

    fleet: str
    vehicle_id: int
    role: Role
    phase: FlightPhase
    mode_name: str
    armed: bool
    position_enu_m: Vector3
    prc: int
    battery_percent: float | None
    error_to_slot_m: float | None
    hover_thrust_norm: float
    disturbance_enu_m_s2: Vector3
    age_s: float
    data_age_s: float
    silent: bool
    neighbours: tuple[int, ...]
    peers: tuple[int, ...]
    position_error: PositionError | None
    lacks: tuple[Notice, ...]
    formation: str
    reference: str
    holder: str
    flags: tuple[HealthFlag, ...]
    rejected: int
    separation: SeparationReport
    last_event: Notice | None
    timing: Timing
    network: NetworkState
    reference_enu_m: Vector3 | None = None  # which its slot is relative to: its own, or that of its leader
    slot_position_enu_m: Vector3 | None = None  # of its slot now

    @property
    def altitude_m(self) -> float:
        """Above the fleet's origin."""
        return self.position_enu_m[2]


def fold(state: FleetState, report: StatusReport, now_s: float) -> FleetState:
    """The state with one more report, received at `now_s` (any monotonic clock, the same as for `rows`)."""
    key = (report.status.fleet, report.status.vehicle_id)
    vehicles = dict(state.vehicles)
    if key not in vehicles and len(vehicles) >= MOST_VEHICLES:
        oldest = min(vehicles, key=lambda i: vehicles[i].received_s)
        if not _is_silent(vehicles[oldest], now_s):
            return state  # a stranger with many names does not displace a vehicle that reports
        del vehicles[oldest]
    return FleetState(vehicles | {key: Received(now_s, report)})


def rows(state: FleetState, now_s: float) -> list[VehicleRow]:
    """All vehicles that ever reported, by fleet and id."""
    ordered = [state.vehicles[key] for key in sorted(state.vehicles)]
    fleets = [list(of_fleet) for _, of_fleet in groupby(ordered, key=lambda received: received.report.status.fleet)]
    return [_row(facts, received, now_s) for one in fleets for facts in [_facts(one, now_s)] for received in one]


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
        {s.vehicle_id: s.reference_enu_m for s in reporting if s.reference_enu_m is not None},
    )


def _row(facts: _FleetFacts, received: Received, now_s: float) -> VehicleRow:
    status = received.report.status
    age_s, silent = now_s - received.received_s, _is_silent(received, now_s)
    reference_enu_m = _reference_enu_m(facts, status)
    slot_position_enu_m = None if reference_enu_m is None else _slot_position_enu_m(status, reference_enu_m)
    error_to_slot_m = None
    data_age_s = age_s + status.state_age_s
    if slot_position_enu_m is not None and status.landed in _FLYING and data_age_s <= SILENT_AFTER_S and not silent:
        error_to_slot_m = dist(status.position_enu_m, slot_position_enu_m)
    return VehicleRow(
        fleet=status.fleet,
        vehicle_id=status.vehicle_id,
        role=status.role,
        phase=status.phase,
        mode_name=status.mode_name,
        armed=status.armed,
        position_enu_m=status.position_enu_m,
        prc=status.prc,
        battery_percent=status.battery_percent,
        error_to_slot_m=error_to_slot_m,
        hover_thrust_norm=status.hover_thrust_norm,
        disturbance_enu_m_s2=status.disturbance_enu_m_s2,
        age_s=age_s,
        data_age_s=data_age_s,
        silent=silent,
        neighbours=status.neighbours,
        peers=status.peers,
        position_error=status.position_error,
        lacks=status.lacks,
        formation=formation_text(status.slot, status.heading),
        reference=reference_text(status.reference, status.target_age_s),
        holder=status.holder,
        flags=status.flags if facts.under_way else _without_leader_flags(status),
        rejected=sum(status.rejected.values()),
        separation=status.separation,
        last_event=status.last_event,
        timing=received.report.timing,
        network=status.network,
        reference_enu_m=reference_enu_m,
        slot_position_enu_m=slot_position_enu_m,
    )


def _without_leader_flags(status: Status) -> tuple[HealthFlag, ...]:
    return tuple(flag for flag in status.flags if flag not in WITHOUT_LEADER)


def _is_silent(received: Received, now_s: float) -> bool:
    return now_s - received.received_s > SILENT_AFTER_S


def _slot_position_enu_m(status: Status, reference_enu_m: Vector3) -> Vector3:
    (x, y, z), (dx, dy, dz) = reference_enu_m, turned_slot(status.slot, status.heading).position_enu_m
    return (x + dx, y + dy, z + dz)


def _reference_enu_m(facts: _FleetFacts, status: Status) -> Vector3 | None:
    """The vehicle's own reference, else that of the leader of its leader beacon, else of any leader that reports."""
    if status.reference_enu_m is not None:
        return status.reference_enu_m
    known = facts.references_enu_m
    if status.leader_beacon and status.leader_beacon.leader_id in known:
        return known[status.leader_beacon.leader_id]
    return next(iter(known.values()), None)


def formation_text(slot: FlownSlot, heading: Heading) -> str:
    """ "1", "1, then 2" or "changing to 2"; with the heading where that is not east."""
    pointed = "" if heading == EAST else f" at {degrees(heading.angle_rad):.0f} deg"
    return _formation(slot) + pointed


def _formation(slot: FlownSlot) -> str:
    if slot.waiting != slot.formation:
        return f"{slot.formation}, then {slot.waiting}"
    return f"changing to {slot.formation}" if slot.moves else str(slot.formation)


def reference_text(held: HeldReference | None, target_age_s: float | None) -> str:
    """ "1" or "1, then 2", with the age of the target followed; "-" where the vehicle holds none."""
    if held is None:
        return "-"
    reference = str(held.flown) if held.waiting == held.flown else f"{held.flown}, then {held.waiting}"
    return reference if target_age_s is None else f"{reference}, target {target_age_s:.1f} s old"
