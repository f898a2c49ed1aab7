"""Prediction of a formation's errors by the linear model in steps, and when an error has settled.

A vehicle is a double integrator with drag behind the lag of its attitude loop and a delay (telemetry, setpoint), and knows its
neighbours as they were when their packets left. Noise, saturation and the separation filter are left out.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, islice
from math import ceil
from typing import Any

import numpy as np

from companion.analysis.interaction import Coupling, FloatArray
from companion.analysis.linear_law import STATES
from companion.analysis.response import TICK_S, LinearModel
from companion.core.formation.paths import (
    Offset,
    Path,
    followers_path,
    gentle_path,
    law_settles,
    law_within_m,
    together_s,
)
from companion.types.formation import Gains
from companion.types.values import Vector3

SUBSTEPS = 4
CHECK_TICKS = 50
DIVERGED_M = 1e6  # the prediction ends at this error, before an overflow
AT_REST = 1e-4  # and where no error, velocity or acceleration is larger than this, in m and s
ROUNDING = 1e-12
NO_PATHS: Sequence[Path | None] = ()


def errors_over_time(
    coupling: Coupling,
    start_errors_m: FloatArray,
    model: LinearModel,
    duration_s: float,
    paths: Sequence[Path | None] = NO_PATHS,
) -> FloatArray:
    """Errors e (ticks, n, axes) [m] from rest at `start_errors_m` (n, axes), every 0.02 s.

    A vehicle with a path flies slot + delta(t) (`core/formation/paths.py`): the law sees y = e - delta, and delta'' is added to
    its command. There are either no paths or one entry for each vehicle, and then three axes.
    """
    ticks = round(duration_s / TICK_S)
    history = np.empty((ticks, *start_errors_m.shape))
    for tick, position in enumerate(errors_by_tick(coupling, start_errors_m, model, paths)):
        if tick == ticks:
            return history
        history[tick] = position
    history[tick:] = position
    return history


def errors_by_tick(
    coupling: Coupling, start_errors_m: FloatArray, model: LinearModel, paths: Sequence[Path | None] = NO_PATHS
) -> Iterator[FloatArray]:
    """`errors_over_time` tick by tick, until the errors have decayed or diverged.

    Each tick a vehicle asks its law with its present state, its last command and memory, and with what its neighbours sent
    some ticks ago, interpolated. A command is held for a tick, which is half a tick of delay; the rest of `delay_s` is
    transport delay. Between commands the motion is exact.
    """
    motion = _motion_of_a_tick(model)
    of_tick, n = np.hstack([motion.of_state, motion.of_commands]), len(motion.of_state)
    shape, shifts = start_errors_m.shape, _Shifts(start_errors_m.shape, paths)
    moving = np.zeros((n + 2, *shape))  # position, velocity, acceleration and so on, and the commands that arrive
    moving[0] = start_errors_m
    flat = moving.reshape(n + 2, -1)
    sent: deque[FloatArray] = deque([np.zeros(shape)] * (motion.whole_ticks + 2))
    laws = _Laws(coupling, model, start_errors_m - shifts.at(0)[0])
    for tick in count():
        yield moving[0]
        if tick % CHECK_TICKS == 0 and tick >= shifts.ticks and _has_ended(flat):
            return
        on_path, seen = tick < shifts.ticks, flat[:2]
        if on_path:
            shift = shifts.at(tick)
            seen, delta_1_s2 = seen - shift[:2].reshape(2, -1), shift[2]
        command = laws.commanded(seen)
        sent.popleft()
        sent.append(command + delta_1_s2 if on_path else command)
        moving[n], moving[n + 1] = sent[0], sent[1]
        flat[:n] = of_tick @ flat


class _Laws:
    """The laws of all vehicles, tick by tick, with their memories and what they have heard.

    Positions and velocities of neighbours mostly count in one proportion, so only the combinations that count are kept.
    """

    def __init__(self, coupling: Coupling, model: LinearModel, first_m: FloatArray) -> None:
        near, law = coupling.near, coupling.law
        outputs, _, n, _ = near.shape
        self._shape, self._asked = (outputs, *first_m.shape), 1 + law.memory
        own = coupling.own.transpose(2, 0, 1)[..., np.newaxis]  # by input
        states = np.hstack([own[: STATES - 1].reshape(2, -1), near[:, : STATES - 1].swapaxes(0, 1).reshape(2, -1)])
        mixes, sizes, kinds = np.linalg.svd(states, full_matrices=False)
        count = max(1, int((sizes > ROUNDING * sizes[0]).sum()))
        self._mixes, parts = mixes[:, :count].T, sizes[:count, np.newaxis] * kinds[:count]
        self._own, parts = parts[:, : outputs * n].reshape(count, outputs, n, 1), parts[:, outputs * n :]
        self._own_before = own[STATES - 1 :]
        self._near = np.hstack(list(parts.reshape(count, -1, n)))
        self._tall = (count * n, first_m.shape[1])
        at_rest = np.array([first_m.ravel(), np.zeros(first_m.size)])
        self._heard = _Aged((self._mixes @ at_rest).reshape(self._tall), model.neighbour_delay_s)
        self._handed = np.hstack(list(near[:, STATES - 1 :].transpose(1, 0, 2, 3).reshape(-1, outputs * n, n)))
        self._hands_on = bool(self._handed.any())
        self._rows: Any = np.s_[:]  # commands and values: what is handed on
        if outputs > 1:
            self._rows = np.r_[:n, self._asked * n : outputs * n]
        whole, share = divmod(model.feedforward_delay_s / TICK_S, 1.0)
        self._shares = (share, 1.0 - share)
        at_first = np.vstack([np.zeros_like(first_m), coupling.published @ first_m])
        self._kept = deque([at_first] * (int(whole) + 1))  # the oldest that counts, to the last tick
        self._before = np.zeros((self._asked, *first_m.shape))  # the last command, and memories
        self._looks_back = bool(self._own_before[:, : self._asked].any())
        self._now = self._answers(0.0 if whole else 1.0 - share)

    def _answers(self, newest: float) -> FloatArray | None:
        """The answers to what is asked but for the answers of this tick, which affect each other; None if they do not.

        `newest`: by which share neighbours know those of this tick.
        """
        size, top = len(self._near), self._asked * self._shape[1]
        ties = np.zeros((size, size))
        ties[:, self._rows] = newest * self._handed
        published = [np.vstack([np.diag(output[:, 0]) for output in rows]) for rows in self._own_before]
        ties[top:, :top] += np.hstack(published)[top:]
        return np.asarray(np.linalg.inv(np.eye(size) - ties), dtype=np.float64) if ties.any() else None

    def commanded(self, seen: FloatArray) -> FloatArray:
        """The commands with these positions and velocities (2, n axes)."""
        mixed = self._mixes @ seen
        asked = self._near @ self._heard.after(mixed.reshape(self._tall))
        if self._hands_on:
            kept, (share, rest) = self._kept, self._shares
            asked += self._handed @ (share * kept[0] + rest * kept[1] if len(kept) > 1 else share * kept[0])
        each = asked.reshape(self._shape)
        for own, combination in zip(self._own, mixed, strict=True):
            each += own * combination.reshape(self._shape[1:])
        if self._looks_back:
            for own, before in zip(self._own_before, self._before, strict=True):
                each[: self._asked] += own[: self._asked] * before
        if self._now is not None:
            asked = self._now @ asked
            each = asked.reshape(self._shape)
        self._before = each[: self._asked]
        if self._hands_on:
            self._kept.popleft()
            self._kept.append(asked[self._rows])
        command: FloatArray = each[0]
        return command


class _Aged:
    """A signal some ticks ago, interpolated; before its begin it was as at first."""

    def __init__(self, first: FloatArray, age_s: float) -> None:
        whole, self._share = divmod(age_s / TICK_S, 1.0)
        self._kept = deque([first] * (int(whole) + 2))  # the oldest that counts, to the newest

    def after(self, newest: FloatArray) -> FloatArray:
        """The aged signal, once `newest` is the present one."""
        self._kept.popleft()
        self._kept.append(newest)
        return self._share * self._kept[0] + (1.0 - self._share) * self._kept[1]


class _Shifts:
    """delta and its derivatives of all vehicles at a tick."""

    def __init__(self, shape: tuple[int, ...], paths: Sequence[Path | None]) -> None:
        self._none = np.zeros((3, *shape))
        self._paths = paths
        self.ticks = max((ceil(path[1] / TICK_S) for path in paths if path), default=0)

    def at(self, tick: int) -> FloatArray:
        """(3, n, axes)."""
        if tick >= self.ticks:
            return self._none
        shifts = self._none.copy()
        for index, path in enumerate(self._paths):
            if path and tick * TICK_S < path[1]:
                shifts[:, index] = path[0](tick * TICK_S)
        return shifts


def _has_ended(state: FloatArray) -> bool:
    largest = np.abs(state).max()
    return bool(largest < AT_REST or np.abs(state[0]).max() > DIVERGED_M)


@dataclass(frozen=True, slots=True)
class _TickMotion:
    """Exact motion over a tick behind lag and delay: state' = `of_state` state + `of_commands` (older, newer command).

    The newer command was sent `whole_ticks` ticks ago, the older one a tick earlier.
    """

    of_state: FloatArray
    of_commands: FloatArray
    whole_ticks: int


def _motion_of_a_tick(model: LinearModel) -> _TickMotion:
    """A tick in SUBSTEPS. In the first of them the older command still arrives: the delay is no whole number of ticks."""
    dt_s = TICK_S / SUBSTEPS
    of_all = _exponential(_vehicle(model) * dt_s)
    substep, effect = of_all[:-1, :-1], of_all[:-1, -1]
    transport_s = max(0.0, model.delay_s - 0.5 * TICK_S)
    whole_ticks, with_older = divmod(round(transport_s / dt_s), SUBSTEPS)
    of_state, of_commands = np.eye(len(substep)), np.zeros((len(substep), 2))
    for index in range(SUBSTEPS):
        of_state, of_commands = substep @ of_state, substep @ of_commands
        of_commands[:, 0 if index < with_older else 1] += effect
    return _TickMotion(of_state, of_commands, whole_ticks)


def _vehicle(model: LinearModel) -> FloatArray:
    """x' = A x of one axis, x = [e, e', flown acceleration and its derivatives, command]; the command is constant."""
    terms = [model.attitude_lag_s, model.attitude_a_s2, model.attitude_b_s3]
    while terms and terms[-1] == 0.0:
        terms.pop()
    n = 2 + len(terms)
    matrix = np.zeros((n + 1, n + 1))
    matrix[0, 1], matrix[1, 1], matrix[1, 2] = 1.0, -model.drag_1_s, 1.0
    if terms:
        matrix[2 : n - 1, 3:n] = np.eye(len(terms) - 1)
        matrix[n - 1, 2:n] = -np.array([1.0, *terms[:-1]]) / terms[-1]
        matrix[n - 1, n] = 1.0 / terms[-1]
    return matrix


def _exponential(matrix: FloatArray) -> FloatArray:
    """Matrix exponential by scaling and squaring of a Taylor series."""
    halvings = max(0, int(np.ceil(np.log2(max(np.abs(matrix).sum(axis=1).max(), 1e-300)))) + 2)
    small = matrix / 2.0**halvings
    term = total = np.eye(len(matrix))
    for k in range(1, 13):
        term = term @ small / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


WATCHED_S = 200.0  # waves along a chain come before slow oscillations
DECAYED, DECAYED_TICKS = 0.5, 500  # below this share of the peak for so long, nothing is larger later


def worst_transient_peak(coupling: Coupling, model: LinearModel) -> float:
    """The largest error [m] that a start from rest with errors up to 1 m can lead to, of a stable formation.

    Every vehicle starts off on an axis of its own: the responses of one vehicle to all starts add up at worst.
    """
    peak, below = 1.0, 0
    for errors_m in islice(errors_by_tick(coupling, np.eye(len(coupling.G)), model), round(WATCHED_S / TICK_S)):
        largest = float(np.abs(errors_m).sum(axis=1).max())
        peak, below = max(peak, largest), below + 1 if largest < DECAYED * peak else 0
        if below > DECAYED_TICKS:
            break
    return peak


def paths_into_slots(
    offsets_m: Mapping[int, Vector3], leader: int, gains: Gains, speed_m_s: float, *, led: bool
) -> dict[int, Path | None]:
    """The path of each vehicle that forms from rest at this offset from its slot, all commanded at once.

    The rules are those of `FormingTogether`; `leader` is the first leader, and `speed_m_s` is slot_speed_m_s. Unless `led`, the
    others begin before they receive the leader's path: they see it where it is, and each takes the time of its own way. Raises
    Refused for a slot that is too far away.
    """
    offsets = {i: Offset(offset_m) for i, offset_m in offsets_m.items()}
    x, y, z = offsets_m[leader]
    behind = {i: Offset((px - x, py - y, pz - z)) for i, (px, py, pz) in offsets_m.items()}
    farthest_m = max(offset.distance_m for offset in offsets.values())
    differ_m = max(offset.distance_m for offset in behind.values())
    within_m, leaders = law_within_m(gains, speed_m_s), None
    if not law_settles(farthest_m, differ_m, within_m):
        leaders = gentle_path(offsets[leader], speed_m_s, together_s(farthest_m, speed_m_s))
    ways, ends_in_s = (offsets, leaders[1]) if leaders and led else (behind, 0.0)
    return {
        i: leaders if i == leader else followers_path(way, speed_m_s, within_m, ends_in_s) for i, way in ways.items()
    }


def settled_after_s(errors_m: FloatArray, within_m: float) -> float | None:
    """Time from which every vehicle stays within `within_m` of its slot, s; None if never."""
    times_s = np.arange(len(errors_m), dtype=np.float64) * TICK_S
    return settle_time_s(times_s, np.linalg.norm(errors_m, axis=2).max(axis=1), within_m)


def transient_peak(errors_m: FloatArray) -> float:
    """Largest error of all vehicles and times over the largest error at the start, at least 1."""
    largest_m = np.linalg.norm(errors_m, axis=2).max(axis=1)
    return float(largest_m.max() / largest_m[0]) if largest_m[0] > 0.0 else 1.0


SETTLED_WITHIN_M = 0.10
STAY_S = 2.0


def settle_time_s(
    times_s: FloatArray, error_m: FloatArray, within_m: float = SETTLED_WITHIN_M, stay_s: float = STAY_S
) -> float | None:
    """Seconds from the first of evenly spaced times (n,) until the error (n,) stays within `within_m`.

    None if it is not inside for at least the last `stay_s`: an oscillation that is inside only at
    the end has not settled.
    """
    outside = np.flatnonzero(error_m > within_m)
    first_inside = int(outside[-1]) + 1 if outside.size else 0
    sample_s = float(times_s[1] - times_s[0]) if times_s.size > 1 else 0.0
    if first_inside == times_s.size or times_s[-1] - times_s[first_inside] < stay_s - sample_s / 2:
        return None
    return float(times_s[first_inside] - times_s[0])
