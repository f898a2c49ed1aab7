"""Possible neighbours: for each receiver a row of senders, those of its edges or, with a range rule, all others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.config.fleet import EdgeNeighbours, FleetConfig
from companion.stability.arrays import FloatArray
from sitl.batch.columns import BoolArray, Columns, IntArray
from sitl.flight.files import ids_of
from sitl.flight.scenario import Scenario


@dataclass(frozen=True, slots=True)
class Candidates:
    """`sender` (B n, K) holds columns, `valid` (B n, K) whether that entry of a receiver's row is used.

    `join_m` and `leave_m` (B n,) are the distances of the range rule, infinite for neighbours by edges.
    """

    sender: IntArray
    valid: BoolArray
    join_m: FloatArray
    leave_m: FloatArray

    @property
    def by_range(self) -> bool:
        """Whether any formation has neighbours by range."""
        return bool(np.isfinite(self.join_m).any())


def candidates_of(scenarios: Sequence[Scenario], columns: Columns) -> Candidates:
    n = columns.vehicles
    others = [_others(scenario.fleet, ids_of(scenario)) for scenario in scenarios]
    most = max(1, max(len(row) for rows in others for row in rows))
    sender = np.zeros((columns.formations, n, most), dtype=np.int64)
    valid = np.zeros((columns.formations, n, most), dtype=np.bool_)
    for b, rows in enumerate(others):
        for i, row in enumerate(rows):
            sender[b, i, : len(row)] = b * n + np.array(row, dtype=np.int64)
            valid[b, i, : len(row)] = True
    ranges = np.array([_range_m(scenario.fleet) for scenario in scenarios])[columns.formation]
    return Candidates(
        sender=columns.column_of[sender.reshape(-1, most)[columns.order]],
        valid=valid.reshape(-1, most)[columns.order],
        join_m=ranges[:, 0],
        leave_m=ranges[:, 1],
    )


def _others(fleet: FleetConfig, ids: list[int]) -> list[list[int]]:
    """For each vehicle the indices in `ids` of its possible neighbours, rising."""
    index = {vehicle_id: i for i, vehicle_id in enumerate(ids)}
    if not isinstance(fleet.neighbours, EdgeNeighbours):
        return [[j for j in range(len(ids)) if j != i] for i in range(len(ids))]
    rows: list[set[int]] = [set() for _ in ids]
    for a, b in fleet.neighbours.edges:
        rows[index[a]].add(index[b])
        rows[index[b]].add(index[a])
    return [sorted(row) for row in rows]


def _range_m(fleet: FleetConfig) -> tuple[float, float]:
    if isinstance(fleet.neighbours, EdgeNeighbours):
        return (float("inf"), float("inf"))
    return (fleet.neighbours.range_m, fleet.neighbours.range_m + fleet.neighbours.hysteresis_m)
