"""The vehicles of a flight on a console of 80 columns: a row each, and below them what is remarkable. In a file, a line of all.

A flag that is normal in a vehicle's phase is not remarkable. What is says what the agent does about it. Status, recordings and
events have every flag.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from math import inf
from textwrap import wrap
from typing import NamedTuple

from companion.ground.answers import id_list
from companion.ground.fleet_state import ReportedVehicle
from companion.tools.explanations import action_words
from companion.types.flight import FLAG_TEXTS, HELD, STREAMING, WITHOUT_LEADER, FlightPhase
from companion.types.flight import HealthFlag as F

HEAD = "  vehicle  role      phase      altitude  error to slot  PrC  data"
COLUMNS = 80
LONGEST_AGE_S = 1e5  # above: no data has come yet
UNTIL_DATA = {
    *(F.FRAME_UNKNOWN, F.POSITION_STALE, F.ATTITUDE_STALE, F.MODE_STALE, F.ARMED_STALE, F.LANDED_STALE),
    *(F.ESTIMATOR_BAD, F.POSE_LOST),  # without GPS an autopilot has no position before its first poses
}
FIRST_DATA_WITHIN_S = 5.0  # of an agent that has started on the ground
LEADER_WITHIN_S = 2.0  # of a hold that begins: vehicles that climb are no neighbours, nor are all that are released


class Stay(NamedTuple):
    """The phase of a vehicle, when it was first seen there, and what was remarkable at the last look."""

    phase: FlightPhase | None
    since_s: float
    remarked: Set[F]


NOT_SEEN = Stay(None, 0.0, frozenset())


class VehicleTable:
    """Remembers how long each vehicle has been in its phase, and with which flags."""

    def __init__(self) -> None:
        self._stays: dict[int, Stay] = {}

    def lines(self, vehicles: Sequence[ReportedVehicle], now_s: float, room: int | None = None) -> list[str]:
        """At most `room` lines; vehicles with flags, and silent ones, are the last to be left out."""
        flags = self._flags(vehicles, now_s)
        remarks = [line for one in _remarks(vehicles, flags) for line in wrap(one, COLUMNS, subsequent_indent="    ")]
        if left_s := _slots_move_s(vehicles):
            remarks.insert(0, f"  the slots are on their way for another {left_s:.0f} s; errors are to them")
        shown = list(vehicles)
        if room is not None and len(vehicles) > (rows := max(0, room - len(remarks) - 2)):
            first = sorted(vehicles, key=lambda vehicle: not (vehicle.silent or flags[vehicle.vehicle_id]))[:rows]
            shown = [vehicle for vehicle in vehicles if vehicle in first]
            remarks.insert(0, f"  and {len(vehicles) - rows} more vehicles; a taller window shows them")
        return [HEAD, *map(row, shown), *remarks]

    def brief(self, vehicles: Sequence[ReportedVehicle], now_s: float) -> list[str]:
        """What they do in a few words, then a line for each remarkable flag: for a file, where nothing is shown in place."""
        return [_in_words(vehicles), *_remarks(vehicles, self._flags(vehicles, now_s))]

    def _flags(self, vehicles: Sequence[ReportedVehicle], now_s: float) -> dict[int, set[F]]:
        return {vehicle.vehicle_id: self._remarkable(vehicle, now_s) for vehicle in vehicles}

    def _remarkable(self, vehicle: ReportedVehicle, now_s: float) -> set[F]:
        phase, last = vehicle.status.phase, self._stays.get(vehicle.vehicle_id, NOT_SEEN)
        since_s = last.since_s if last.phase is phase else now_s
        normal_s = {flag: _normal_for_s(flag, phase, vehicle.status.autopilot.armed) for flag in vehicle.flags}
        found = {
            flag
            for flag, seconds in normal_s.items()
            if now_s - since_s >= seconds or (seconds < inf and last.remarked & _alike(flag))
        }
        self._stays[vehicle.vehicle_id] = Stay(phase, since_s, found)
        return found


def _remarks(vehicles: Sequence[ReportedVehicle], flags: Mapping[int, Set[F]]) -> list[str]:
    """A line for each flag; where the law flies one of its vehicles, with what the agent does."""
    flown = {vehicle.vehicle_id for vehicle in vehicles if vehicle.status.phase in STREAMING}
    lines = []
    for flag in sorted(set().union(*flags.values())):
        ids = [i for i, of_vehicle in flags.items() if flag in of_vehicle]
        action = "" if flown.isdisjoint(ids) else f"; in formation it {action_words(flag, None)}"
        lines.append(f"  ! {flag}, {id_list(ids)}: {FLAG_TEXTS[flag]}{action}")
    return lines


def _in_words(vehicles: Sequence[ReportedVehicle]) -> str:
    """The phases, with the largest error of those whose law flies; then who is silent."""
    phases = Counter(vehicle.status.phase for vehicle in vehicles if not vehicle.silent)
    parts = [f"all {phase}" if count == len(vehicles) else f"{count} {phase}" for phase, count in phases.items()]
    errors_m = {v.vehicle_id: v.error_to_slot_m for v in vehicles if v.status.phase in STREAMING and v.error_to_slot_m}
    if errors_m:
        worst = max(errors_m, key=lambda i: errors_m[i])
        way = f", slots on their way for {left_s:.0f} s" if (left_s := _slots_move_s(vehicles)) else ""
        parts.append(f"at most {errors_m[worst]:.2f} m from the slot (vehicle {worst}){way}")
    if silent := [vehicle.vehicle_id for vehicle in vehicles if vehicle.silent]:
        parts.append(f"SILENT: {id_list(silent)}")
    return ", ".join(parts)


def _slots_move_s(vehicles: Sequence[ReportedVehicle]) -> float:
    """For how long the slots still move to their places, s; 0 where none does."""
    flown = [vehicle.status for vehicle in vehicles if vehicle.status.phase in STREAMING]
    return max((status.formation.slot.moves_for_s for status in flown), default=0.0)


def _alike(flag: F) -> Set[F]:
    """The flag, with the one that it follows or is followed by."""
    return WITHOUT_LEADER if flag in WITHOUT_LEADER else {flag}


def _normal_for_s(flag: F, phase: FlightPhase, armed: bool) -> float:
    """For how long from the beginning of its phase a vehicle may have this flag without any fault."""
    if flag in WITHOUT_LEADER:
        if phase in HELD:
            return LEADER_WITHIN_S
        return 0.0 if phase in STREAMING else inf
    starts = phase is FlightPhase.OBSERVE and not armed
    return FIRST_DATA_WITHIN_S if starts and flag in UNTIL_DATA else 0.0


def row(vehicle: ReportedVehicle) -> str:
    """A vehicle's id, role, phase, altitude, error to its slot, PrC and age of its data, without its flags."""
    status = vehicle.status
    error = "-" if vehicle.error_to_slot_m is None else f"{vehicle.error_to_slot_m:.2f} m"
    age = f"{vehicle.data_age_s * 1000:.0f} ms old" if vehicle.data_age_s < LONGEST_AGE_S else "-"
    return (
        f"  {vehicle.vehicle_id:<7d}  {status.leadership.role:<8}  {status.phase:<9}"
        f"  {status.motion.position_enu_m[2]:6.2f} m  {error:>13}  {status.leadership.prc:>3}"
        f"  {f'SILENT, {vehicle.age_s:.1f} s' if vehicle.silent else age}"
    )
