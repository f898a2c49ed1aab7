"""What the ground knows of a fleet: a pure fold over status reports. No clock, no sockets; times are arguments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import dist

from companion.geometry.turning import turned_slot
from companion.ground.words import formation_in_words, reference_in_words
from companion.types import FlightPhase, HealthFlag, LandedState, Role, Status, Vector3
from companion.wire.ground import StatusReport, Timing

SILENT_AFTER_S = 1.0  # ten reports missed
_FLYING = (LandedState.IN_AIR, LandedState.TAKEOFF, LandedState.LANDING)

VehicleKey = tuple[str, int]  # fleet name, vehicle id


@dataclass(frozen=True, slots=True)
class Heard:
    """A vehicle's newest report and when it came."""

    received_s: float
    report: StatusReport


@dataclass(frozen=True, slots=True)
class FleetState:
    """Every vehicle that was ever heard. A vehicle never leaves it."""

    vehicles: Mapping[VehicleKey, Heard] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class VehicleRow:
    """One vehicle as the ground sees it at one time.

    `age_s` is the time since the last report; `data_age_s` adds the age that the position had on board (inf where there
    never was one). `error_to_slot_m` is |(x_i - d_i0) - r|, None where no leader reports or the vehicle does not fly.
    `holder` is the operator who holds command; `formation` and `reference` are in the words of ground/words.py.
    """

    fleet: str
    vehicle_id: int
    role: Role
    phase: FlightPhase
    mode_name: str
    armed: bool
    position_enu_m: Vector3
    prc: int
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
    last_event: str
    timing: Timing

    @property
    def altitude_m(self) -> float:
        """Above the fleet's origin."""
        return self.position_enu_m[2]


def fold(state: FleetState, report: StatusReport, now_s: float) -> FleetState:
    """Take in one report that came at `now_s` (any monotonic clock, the same one that `rows` is given)."""
    key = (report.status.fleet, report.status.vehicle_id)
    return FleetState({**state.vehicles, key: Heard(now_s, report)})


def rows(state: FleetState, now_s: float) -> list[VehicleRow]:
    """All vehicles ever heard, by fleet and id."""
    return [_row(state, state.vehicles[key], now_s) for key in sorted(state.vehicles)]


def _row(state: FleetState, heard: Heard, now_s: float) -> VehicleRow:
    status = heard.report.status
    age_s = now_s - heard.received_s
    return VehicleRow(
        fleet=status.fleet,
        vehicle_id=status.vehicle_id,
        role=status.role,
        phase=status.phase,
        mode_name=status.mode_name,
        armed=status.armed,
        position_enu_m=status.position_enu_m,
        prc=status.prc,
        error_to_slot_m=_error_to_slot_m(state, status, now_s),
        hover_thrust_norm=status.hover_thrust_norm,
        disturbance_enu_m_s2=status.disturbance_enu_m_s2,
        age_s=age_s,
        data_age_s=age_s + status.state_age_s,
        silent=_is_silent(heard, now_s),
        neighbours=status.neighbours,
        formation=formation_in_words(status.slot, status.heading),
        reference=reference_in_words(status.reference, status.target_age_s),
        holder=status.holder,
        flags=status.flags,
        rejected=sum(status.rejected.values()),
        last_event=status.last_event,
        timing=heard.report.timing,
    )


def _is_silent(heard: Heard, now_s: float) -> bool:
    return now_s - heard.received_s > SILENT_AFTER_S


def _error_to_slot_m(state: FleetState, status: Status, now_s: float) -> float | None:
    reference_enu_m = _reference_enu_m(state, status, now_s)
    own = state.vehicles[status.fleet, status.vehicle_id]
    if reference_enu_m is None or status.landed not in _FLYING or _is_silent(own, now_s):
        return None
    slot = turned_slot(status.slot, status.heading)
    place = tuple(x - d for x, d in zip(status.position_enu_m, slot.position_enu_m, strict=True))
    return dist(place, reference_enu_m)


def _reference_enu_m(state: FleetState, status: Status, now_s: float) -> Vector3 | None:
    """The own reference, else that of the leader whose word the vehicle has, else of any leader that still reports."""
    if status.reference_enu_m is not None:
        return status.reference_enu_m
    known = {
        vehicle_id: heard.report.status.reference_enu_m
        for (fleet, vehicle_id), heard in sorted(state.vehicles.items())
        if fleet == status.fleet and not _is_silent(heard, now_s) and heard.report.status.reference_enu_m is not None
    }
    heard_leader_id = status.leader_word.leader_id if status.leader_word else None
    return known.get(heard_leader_id) if heard_leader_id in known else next(iter(known.values()), None)
