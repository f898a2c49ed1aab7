"""Records to columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from companion.recording.records import DecisionRecord, TimingRecord
from companion.report.arrays import Bools, Floats, Words
from companion.report.flight import NeighbourUse, Statuses, TickColumns, TickTiming
from companion.types.status import Status

NO_VECTOR = (np.nan, np.nan, np.nan)
LARGEST = 1e9  # of no quantity in the units of the records is there more


def ticks_of(time_s: Sequence[float], records: Sequence[DecisionRecord]) -> TickColumns:
    """The columns of decisions at these times (n,)."""
    return TickColumns(
        time_s=np.array(time_s, dtype=np.float64),
        phase=_words(records, "phase"),
        role=_words(records, "role"),
        leader_id=_numbers(records, "leader_id"),
        epoch=_numbers(records, "epoch"),
        prc=_numbers(records, "prc"),
        position_enu_m=_vectors(records, "position_enu_m"),
        velocity_enu_m_s=_vectors(records, "velocity_enu_m_s"),
        slot_offset_enu_m=_vectors(records, "slot_offset_enu_m"),
        reference_enu_m=_vectors(records, "reference_enu_m"),
        neighbours=_neighbours(records),
        acceleration_enu_m_s2=_vectors(records, "acceleration_enu_m_s2"),
        nearest=_words(records, "nearest"),
        nearest_m=_numbers(records, "nearest_m"),
        required_m=_numbers(records, "required_m"),
        filter_changed_m_s2=_numbers(records, "filter_changed_m_s2"),
        wind_acceleration_enu_m_s2=_vectors(records, "wind_acceleration_enu_m_s2"),
        hover_thrust_norm=_numbers(records, "hover_thrust_norm"),
        battery_percent=_numbers(records, "battery_percent"),
        flags=_flags(records),
    )


def timing_of(time_s: Sequence[float], records: Sequence[TimingRecord]) -> TickTiming:
    """The columns of the timing of ticks, in milliseconds."""
    return TickTiming(
        np.array(time_s, dtype=np.float64),
        _numbers(records, "late_us") / 1e3,
        _numbers(records, "decide_us") / 1e3,
        _numbers(records, "whole_us") / 1e3,
        _numbers(records, "telemetry_to_command_us") / 1e3,
    )


def statuses_of(time_s: Sequence[float], records: Sequence[Status]) -> Statuses:
    """The columns of status reports."""
    errors = [record.position_error for record in records]
    return Statuses(
        np.array(time_s, dtype=np.float64),
        np.array([record.armed for record in records], dtype=np.bool_),
        np.array([int(record.landed) for record in records], dtype=np.float64),
        _words(records, "mode_name"),
        _numbers(records, "battery_percent"),
        np.array([error.horizontal_m if error else np.nan for error in errors], dtype=np.float64),
        np.array([error.vertical_m if error else np.nan for error in errors], dtype=np.float64),
        tuple(frozenset(record.peers) for record in records),
        np.array([float(sum(record.rejected.values())) for record in records], dtype=np.float64),
    )


def _numbers(records: Iterable[Any], name: str) -> Floats:
    get = attrgetter(name)
    return _possible(
        np.array([np.nan if (value := get(record)) is None else value for record in records], dtype=np.float64)
    )


def _vectors(records: Iterable[Any], name: str) -> Floats:
    get = attrgetter(name)
    return _possible(np.array([get(record) or NO_VECTOR for record in records], dtype=np.float64).reshape(-1, 3))


def _possible(values: Floats) -> Floats:
    """NaN in place of what no agent records: a figure would have no end."""
    return np.where(np.abs(values) <= LARGEST, values, np.nan)


def _words(records: Iterable[Any], name: str) -> Words:
    get = attrgetter(name)
    return np.array([get(record) for record in records], dtype=np.str_)


def _neighbours(records: Sequence[DecisionRecord]) -> Mapping[int, NeighbourUse]:
    """A weight or an age that is missing at the end of a record counts as not known."""
    columns: dict[int, NeighbourUse] = {}
    for row, record in enumerate(records):
        for place, other in enumerate(record.neighbours):
            use = columns.get(other)
            if use is None:
                use = columns[other] = NeighbourUse(_unknown(len(records)), _unknown(len(records)))
            use.weight[row] = record.weights[place] if place < len(record.weights) else np.nan
            use.age_s[row] = record.peer_ages_s[place] if place < len(record.peer_ages_s) else 0.0
    return dict(sorted(columns.items()))


def _flags(records: Sequence[DecisionRecord]) -> Mapping[str, Bools]:
    columns: dict[str, Bools] = {}
    for row, record in enumerate(records):
        for flag in record.flags:
            if flag not in columns:
                columns[flag] = np.zeros(len(records), dtype=np.bool_)
            columns[flag][row] = True
    return columns


def _unknown(rows: int) -> Floats:
    return np.full(rows, np.nan)
