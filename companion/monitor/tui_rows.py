"""The rows of one fleet with what only the whole fleet shows, and what is wrong with each vehicle, the worst first. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, groupby
from types import MappingProxyType

from companion.geometry.formations import separation_distance_m
from companion.ground.answers import count, id_list
from companion.ground.fleet_state import ReportedVehicle
from companion.monitor.vehicle_view import advice_of
from companion.types.code_table import code_table
from companion.types.flight import FLAG_TEXTS, Role
from companion.types.notices import Code
from companion.types.values import printable

Members = Mapping[str, frozenset[int]]  # fleet -> the vehicles in its fleet file
NO_MEMBERS: Members = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Nearest:
    """The nearest vehicle or traffic. `avoided`: the separation filter changes the command because of it."""

    name: str
    distance_m: float
    avoided: bool


@dataclass(frozen=True, slots=True)
class TableRow:
    """A vehicle, its nearest other one (None if unknown) and what is wrong with it."""

    vehicle: ReportedVehicle
    fleet_size: int
    nearest: Nearest | None
    problems: tuple[VehicleProblem, ...]


@dataclass(frozen=True, slots=True)
class FleetRows:
    """A fleet, its rows by vehicle id, and its smallest separation with the two vehicles.

    `missing_ids` are of its fleet file and never reported; none without the file.
    """

    name: str
    rows: tuple[TableRow, ...]
    smallest: tuple[float, int, int] | None
    missing_ids: tuple[int, ...] = ()


def fleets(vehicles: Sequence[ReportedVehicle], members: Members = NO_MEMBERS) -> Iterator[FleetRows]:
    """Of rows that come sorted by fleet."""
    for name, group in groupby(vehicles, key=lambda row: row.fleet):
        yield _fleet(name, list(group), members.get(name, frozenset()))


def _fleet(name: str, vehicles: list[ReportedVehicle], members: frozenset[int]) -> FleetRows:
    """Distances are in the metric of `separation_m`, between vehicles whose positions are not old."""
    nearest: dict[int, tuple[float, int]] = {}
    known = [row for row in vehicles if not row.silent and not row.has_old_position]
    pairs = [
        (
            separation_distance_m(a.status.motion.position_enu_m, b.status.motion.position_enu_m),
            a.vehicle_id,
            b.vehicle_id,
        )
        for a, b in combinations(known, 2)
    ]
    for distance_m, one, other in sorted(pairs, reverse=True):  # the last one that stays is the nearest
        nearest[one], nearest[other] = (distance_m, other), (distance_m, one)
    missing_ids = tuple(sorted(members - {row.vehicle_id for row in vehicles}))
    size = len(vehicles) + len(missing_ids)
    rows = (TableRow(row, size, _nearest(row, nearest.get(row.vehicle_id)), problems_of(row)) for row in vehicles)
    return FleetRows(name, tuple(rows), min(pairs, default=None), missing_ids)


def _nearest(row: ReportedVehicle, on_the_ground: tuple[float, int] | None) -> Nearest | None:
    """As the vehicle itself sees it while it flies in formation, with traffic; else from the positions reported."""
    seen = row.status.safety.separation.nearest
    if row.silent:
        return None
    if seen is not None:
        return Nearest(seen.name, seen.distance_m, row.status.safety.separation.changed_m_s2 > 0.0)
    return Nearest(str(on_the_ground[1]), on_the_ground[0], False) if on_the_ground else None


def heading(fleet: FleetRows) -> list[str]:
    """What matters first. Parts for one or more lines; capitals mark what needs attention."""
    vehicles = [row.vehicle for row in fleet.rows]
    silent = [row.vehicle_id for row in vehicles if row.silent]
    leaders = [row.vehicle_id for row in vehicles if row.status.leadership.role is Role.LEADER and not row.silent]
    open_ = [row.vehicle_id for row in vehicles if row.status.network.security == "none"]
    holders = sorted({row.status.command.holder for row in vehicles if row.status.command.holder and not row.silent})
    parts = [f"fleet {fleet.name}: {count(len(vehicles))}"]
    if silent:
        parts.append(f"SILENT: {id_list(silent)}")
    if fleet.missing_ids:
        parts.append(f"NEVER HEARD: {id_list(fleet.missing_ids)}")
    if fleet.smallest:
        distance_m, one, other = fleet.smallest
        parts.append(f"smallest separation {distance_m:.2f} m ({one}, {other})")
    parts.append(f"leader {', '.join(map(str, leaders))}" if leaders else "NO LEADER")
    if holders:
        parts.append(f"operator {printable(', '.join(holders))}")
    if open_:
        parts.append(f"UNSECURED (strangers can command): {id_list(open_)}")
    return parts


SILENT = "SILENT"
_RANKS = {flag: rank for rank, flag in enumerate(code_table().worst_first)}


@dataclass(frozen=True, slots=True)
class VehicleProblem:
    """Of one vehicle. `in_flight` is False for what only keeps it from flying."""

    code: str
    text: str
    in_flight: bool = True

    @property
    def advice(self) -> str:
        """What the operator should do; "" where nothing is known of the code."""
        return advice_of(Code.NO_REPORT if self.code == SILENT else self.code)


def problems_of(row: ReportedVehicle) -> tuple[VehicleProblem, ...]:
    """The worst first. Of a silent vehicle nothing else is known."""
    if row.silent:
        return (VehicleProblem(SILENT, "no report any more; all that is known of it is old"),)
    flags = sorted(
        (VehicleProblem(flag, FLAG_TEXTS[flag]) for flag in row.flags), key=lambda problem: _RANKS[problem.code]
    )
    return (*flags, *(VehicleProblem(notice.code, notice.text, in_flight=False) for notice in row.status.safety.lacks))


def group_problems(problems: Iterable[tuple[int, VehicleProblem]]) -> list[tuple[VehicleProblem, list[int]]]:
    """(vehicle id, problem) -> each problem once with the ids of its vehicles; silence first, what keeps from flying last."""
    vehicles: dict[VehicleProblem, list[int]] = {}
    for vehicle_id, problem in problems:
        vehicles.setdefault(problem, []).append(vehicle_id)
    return sorted(vehicles.items(), key=lambda item: _order(item[0]))


def _order(problem: VehicleProblem) -> tuple[bool, int, str]:
    return (
        not problem.in_flight,
        -1 if problem.code == SILENT else _RANKS.get(problem.code, len(_RANKS)),
        problem.code,
    )
