"""Quantities of the paper's statements, measured on true tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from companion.stability.arrays import FloatArray
from sitl.paper.theory.graphs import graph_of
from sitl.report.metrics import FormationFlight, Pair, Tracks, distances_m, pairs_of
from sitl.study.shapes import is_connected

Interval = tuple[float, float]  # from, to [s] after the start of the formation
RESPONDED_SHARE = 0.5  # a vehicle has responded after this share of its distance


def response_s(flight: FormationFlight, vehicle_id: int) -> float:
    """Time from the start of the formation until the vehicle has covered half of its distance in x; inf where it never does."""
    times_s = flight.formation.times_s()
    x_m = flight.tracks[vehicle_id].at(times_s)[:, 0]
    way_m = flight.reference(0.0).position_enu_m[0] + flight.slots_enu_m[vehicle_id][0] - x_m[0]
    done = np.flatnonzero((x_m - x_m[0]) * np.sign(way_m) >= RESPONDED_SHARE * abs(way_m))
    return float(times_s[done[0]] - times_s[0]) if done.size else float("inf")


def broken_s(flight: FormationFlight, pair: Pair, range_m: float) -> list[Interval]:
    """Intervals in which two vehicles were out of range of each other."""
    times_s = flight.formation.times_s()
    return _intervals(distances_m(flight.tracks, pair, times_s) > range_m, times_s)


def alone_s(flight: FormationFlight, vehicle_id: int, range_m: float) -> list[Interval]:
    """Intervals in which a vehicle had no other in range."""
    times_s = flight.formation.times_s()
    pairs = [pair for pair in pairs_of(flight.tracks) if vehicle_id in pair]
    nearest_m = np.min([distances_m(flight.tracks, pair, times_s) for pair in pairs], axis=0)
    return _intervals(nearest_m > range_m, times_s)


def apart_s(flight: FormationFlight, range_m: float) -> list[Interval]:
    """Intervals in which the graph of vehicles in range was not connected."""
    times_s = flight.formation.times_s()
    pairs = pairs_of(flight.tracks)
    in_range = np.array([distances_m(flight.tracks, pair, times_s) <= range_m for pair in pairs])
    graphs, at = np.unique(in_range, axis=1, return_inverse=True)
    in_parts = [
        not is_connected(graph_of(flight.tracks, [pair for pair, is_edge in zip(pairs, graph, strict=True) if is_edge]))
        for graph in graphs.T
    ]
    return _intervals(np.array(in_parts)[at.ravel()], times_s)


def fewest_in_range(flight: FormationFlight, vehicle_id: int, range_m: float) -> list[int]:
    """Ids of the vehicles in range of a vehicle at the time when these were fewest."""
    times_s = flight.formation.times_s()
    others = sorted(flight.tracks.keys() - {vehicle_id})
    in_range = np.array([distances_m(flight.tracks, (vehicle_id, other), times_s) <= range_m for other in others])
    at = int(in_range.sum(axis=0).argmin())
    return [other for other, is_near in zip(others, in_range[:, at], strict=True) if is_near]


def edges_m(tracks: Tracks, time_s: float, range_m: float) -> list[Pair]:
    """Pairs in range of each other at one time."""
    return [pair for pair in pairs_of(tracks) if float(distances_m(tracks, pair, np.array([time_s]))[0]) <= range_m]


def _intervals(condition: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], times_s: FloatArray) -> list[Interval]:
    """Intervals in which `condition` (n,) is true, in seconds after the first time."""
    steps = np.flatnonzero(np.diff(np.concatenate([[False], condition, [False]]).astype(int)))
    since_s = times_s - times_s[0]
    return [
        (float(since_s[a]), float(since_s[min(b, since_s.size - 1)]))
        for a, b in zip(steps[::2], steps[1::2], strict=True)
    ]


def beginning(flight: FormationFlight, seconds_s: float) -> FormationFlight:
    """The same flight with its formation cut after `seconds_s`."""
    formation = flight.formation
    return replace(flight, formation=replace(formation, end_s=min(formation.end_s, formation.start_s + seconds_s)))


def total_s(intervals: Sequence[Interval]) -> float:
    return float(sum(to_s - from_s for from_s, to_s in intervals))


def behind_leader_m(flight: FormationFlight, leader_id: int, vehicle_id: int, times_s: FloatArray) -> FloatArray:
    """Distance |(x_i - d_i0) - (x_l - d_l0)| (n,) of a follower to its slot relative to the leader."""
    own = flight.tracks[vehicle_id].at(times_s) - np.array(flight.slots_enu_m[vehicle_id])
    leader = flight.tracks[leader_id].at(times_s) - np.array(flight.slots_enu_m[leader_id])
    return np.asarray(np.linalg.norm(own - leader, axis=1))
