"""What is wrong with a vehicle, the worst first, and what the operator should do. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from companion.ground.fleet_status import VehicleRow
from companion.monitor.picture.flags import advice_of
from companion.types.flight import FLAG_TEXTS, HealthFlag
from companion.types.notices import Code

F = HealthFlag
# A danger to others, then what takes the vehicle out of the formation, then what only warns.
WORST_FIRST: tuple[HealthFlag, ...] = (
    F.SEPARATION_VIOLATED, F.TILT_EXCEEDED, F.BATTERY_CRITICAL, F.DUPLICATE_ID, F.OUTSIDE_FENCE,
    F.POSITION_STALE, F.ATTITUDE_STALE, F.FRAME_UNKNOWN, F.MODE_STALE, F.ESTIMATOR_BAD, F.POSITION_JUMPED,
    F.FRAME_CONTRADICTED, F.ARMED_STALE, F.LANDED_STALE, F.LEADER_LOST, F.FLEET_LINK_LOST, F.TICK_LATE,
    F.BATTERY_LOW, F.LEADER_AWAITED,
)  # fmt: skip
SILENT = "SILENT"
_RANKS = {str(flag): rank for rank, flag in enumerate(WORST_FIRST)}


@dataclass(frozen=True, slots=True)
class Problem:
    """Of one vehicle. `in_flight` is False for what only keeps it from flying."""

    code: str
    text: str
    in_flight: bool = True

    @property
    def advice(self) -> str:
        """What the operator should do; "" where nothing is known of the code."""
        return advice_of(Code.NO_REPORT if self.code == SILENT else self.code)


def problems_of(row: VehicleRow) -> tuple[Problem, ...]:
    """The worst first. Of a silent vehicle nothing else is known."""
    if row.silent:
        return (Problem(SILENT, "no report any more; all that is known of it is old"),)
    flags = sorted((Problem(flag, FLAG_TEXTS[flag]) for flag in row.flags), key=lambda problem: _RANKS[problem.code])
    return (*flags, *(Problem(notice.code, notice.text, in_flight=False) for notice in row.lacks))


def grouped(problems: Iterable[tuple[int, Problem]]) -> list[tuple[Problem, list[int]]]:
    """(vehicle id, problem) -> each problem once with the ids of its vehicles; silence first, what keeps from flying last."""
    vehicles: dict[Problem, list[int]] = {}
    for vehicle_id, problem in problems:
        vehicles.setdefault(problem, []).append(vehicle_id)
    return sorted(vehicles.items(), key=lambda item: _order(item[0]))


def _order(problem: Problem) -> tuple[bool, int, str]:
    return (
        not problem.in_flight,
        -1 if problem.code == SILENT else _RANKS.get(problem.code, len(_RANKS)),
        problem.code,
    )
