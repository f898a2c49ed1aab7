"""The state of a fleet on the ground: a pure fold over status reports. No clock, no sockets; times are arguments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import dist

from companion.geometry.turning import turned_slot
from companion.ground.text import formation_text, reference_text
from companion.types.autopilot import LandedState
from companion.types.flight import WITHOUT_LEADER, FlightPhase, HealthFlag, Role
from companion.types.notices import Notice
from companion.types.separation import SeparationReport
from companion.types.status import NetworkState, Status
from companion.types.vectors import Vector3
from companion.wire.ground import StatusReport, Timing

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
    one). `error_to_slot_m` is |(x_i - d_i0) - r|, None where no leader reports or the vehicle does not fly. `holder` is the
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
    formation: str
    reference: str
    holder: str
    flags: tuple[HealthFlag, ...]
    rejected: int
    separation: SeparationReport
    last_event: Notice | None
    timing: Timing
    network: NetworkState

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
    return [_row(state, state.vehicles[key], now_s) for key in sorted(state.vehicles)]


def _row(state: FleetState, received: Received, now_s: float) -> VehicleRow:
    status = received.report.status
    age_s = now_s - received.received_s
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
        error_to_slot_m=_error_to_slot_m(state, status, now_s),
        hover_thrust_norm=status.hover_thrust_norm,
        disturbance_enu_m_s2=status.disturbance_enu_m_s2,
        age_s=age_s,
        data_age_s=age_s + status.state_age_s,
        silent=_is_silent(received, now_s),
        neighbours=status.neighbours,
        formation=formation_text(status.slot, status.heading),
        reference=reference_text(status.reference, status.target_age_s),
        holder=status.holder,
        flags=status.flags if _under_way(state, status.fleet, now_s) else _without_leader_flags(status),
        rejected=sum(status.rejected.values()),
        separation=status.separation,
        last_event=status.last_event,
        timing=received.report.timing,
        network=status.network,
    )


def _under_way(state: FleetState, fleet: str, now_s: float) -> bool:
    """Whether a vehicle of the fleet is in flight, past its takeoff: from then on a leader publishes its beacon."""
    return any(
        received.report.status.phase in PAST_TAKEOFF and not _is_silent(received, now_s)
        for (of_fleet, _), received in state.vehicles.items()
        if of_fleet == fleet
    )


def _without_leader_flags(status: Status) -> tuple[HealthFlag, ...]:
    return tuple(flag for flag in status.flags if flag not in WITHOUT_LEADER)


def _is_silent(received: Received, now_s: float) -> bool:
    return now_s - received.received_s > SILENT_AFTER_S


def _error_to_slot_m(state: FleetState, status: Status, now_s: float) -> float | None:
    reference_enu_m = _reference_enu_m(state, status, now_s)
    own = state.vehicles[status.fleet, status.vehicle_id]
    if reference_enu_m is None or status.landed not in _FLYING or _is_silent(own, now_s):
        return None
    slot = turned_slot(status.slot, status.heading)
    flown_reference_enu_m = tuple(x - d for x, d in zip(status.position_enu_m, slot.position_enu_m, strict=True))
    return dist(flown_reference_enu_m, reference_enu_m)


def _reference_enu_m(state: FleetState, status: Status, now_s: float) -> Vector3 | None:
    """The vehicle's own reference, else that of the leader of its leader beacon, else of any leader that reports."""
    if status.reference_enu_m is not None:
        return status.reference_enu_m
    known = {
        vehicle_id: received.report.status.reference_enu_m
        for (fleet, vehicle_id), received in sorted(state.vehicles.items())
        if fleet == status.fleet
        and not _is_silent(received, now_s)
        and received.report.status.reference_enu_m is not None
    }
    beacon_leader_id = status.leader_beacon.leader_id if status.leader_beacon else None
    return known.get(beacon_leader_id) if beacon_leader_id in known else next(iter(known.values()), None)
