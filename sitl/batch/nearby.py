"""The pairs of vehicles that are near each other, and what the separation filter asks of each: `core/filter/motion.py` and
`Separation` of `core/filter/vehicles.py` in arrays.

What is asked decides alone where the filter has nothing to do. Where it may have, `filter.py` calls the core itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.assembly import separation_settings_of
from companion.core.autopilot import LAG_S
from companion.core.filter.motion import NEAR_M, NEAR_S
from companion.core.filter.vehicles import (
    BELIEVED_S,
    FASTEST_LEAVING_M_S,
    GROWTH_M_S,
    KEPT_M,
    LARGEST_ERROR_RATIO,
    LARGEST_PULL_M_S2,
    LEAST_DISTANCE_M,
    LEAST_PULL_M_S2,
    NEAREST_M,
    PASSING_M,
    PLACED_WITHIN_M,
    PULL_SLOPE_1_S2,
    RESPONSE_1_S,
    SIDEWAYS_RATIO,
    SLOPE_1_S,
    SLOT_SHARE,
    TURNING_S2,
    UNSEEN_DELAY_S,
)
from companion.geometry.formations import HEIGHT_WEIGHT
from companion.types.autopilot import PositionError
from sitl.batch.columns import LINKS_TO_ALL, BoolArray, Columns, IntArray
from sitl.batch.packets import ACCELERATION, PERIOD_S, VELOCITY, ReceivedPackets, Reception, everyone_of
from sitl.flight.scenario import Scenario

COMMANDED = slice(9, 12)
NEARLY = 1.0 + 1e-9
LAG_SHARE = PERIOD_S / (LAG_S + PERIOD_S)  # of a command in the acceleration that a vehicle flies, for each tick
SMALLEST_SIZE = HEIGHT_WEIGHT  # of a normal in coordinates with weighted heights


@dataclass(frozen=True, slots=True)
class Moving:
    """The vehicles of a group: position and velocity (6, G), and both after the lag of their attitude (3, G)."""

    now: FloatArray
    position_enu_m: FloatArray
    velocity_enu_m_s: FloatArray


@dataclass(frozen=True, slots=True)
class Heard:
    """The newest packets of a group from all others of their formations (G, K).

    `motions` (7, G, K): position, velocity, and the size of the acceleration, or more. `all_formed`: no packet is from before
    the start of the batch, when its vehicle was not in formation yet.
    """

    tick: int
    received: ReceivedPackets
    motions: FloatArray
    all_formed: bool


@dataclass(frozen=True, slots=True)
class Pairs:
    """P pairs of vehicles, each (P,).

    `place` is that of the vehicle in its group, `own` its column and `other` that of the other one. `last` (12, P): position,
    velocity, lagged and commanded acceleration of the other one by its newest packet, `age_s` old. `formed`: it was in
    formation then, so it makes way.
    """

    place: IntArray
    own: IntArray
    other: IntArray
    last: FloatArray
    age_s: FloatArray
    formed: BoolArray


class Nearby:
    """Packets between all vehicles of a formation, neighbours or not, and the accelerations that they fly.

    A sender's own lag of its commands stands for that of each receiver: without losses they are the same, but that a receiver
    begins with the first command that it hears, where this one has a phase before its own first tick.
    """

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns, telemetry: FloatArray) -> None:
        everyone = everyone_of(columns)
        self._other, kept = everyone.sender, Reception(scenarios, columns, everyone, LINKS_TO_ALL)
        self._reception = kept
        start = np.concatenate([telemetry[:6], np.zeros((1, columns.count))])
        self._motions = np.tile(start, kept.kept)
        # The lagged acceleration, the command, and 1 in formation.
        self._flown = np.zeros((self._motions.shape[1], 7))
        self._lagged_enu_m_s2 = np.zeros((3, columns.count))
        self._first_enu_m_s2 = np.zeros((3, columns.count))  # the commands of the first tick
        self._heard_at_once = kept.lag == 0

    def send(self, tick: int, group: slice, now: FloatArray, commanded_enu_m_s2: FloatArray) -> None:
        """Publish what these vehicles do."""
        lagged, places = self._lagged_enu_m_s2[:, group], self._reception.places(tick, group)
        lagged += LAG_SHARE * (commanded_enu_m_s2 - lagged)
        if tick == 0:
            self._first_enu_m_s2[:, group] = commanded_enu_m_s2
        most_m_s2 = _size(lagged) + _left_of_first(tick) * _size(self._first_enu_m_s2[:, group])
        most_m_s2 = np.maximum(most_m_s2, _size(commanded_enu_m_s2))
        self._motions[:6, places], self._motions[6, places] = now, most_m_s2
        self._flown[places] = np.concatenate([lagged, commanded_enu_m_s2, np.ones((1, lagged.shape[1]))]).T

    def moving(self, group: slice, telemetry: FloatArray) -> Moving:
        """As these vehicles are by their telemetry and their commands up to the last tick."""
        now = telemetry[:6]
        return Moving(now, now[:3] + LAG_S * now[VELOCITY], now[VELOCITY] + LAG_S * self._lagged_enu_m_s2[:, group])

    def heard(self, tick: int, group: slice) -> Heard:
        """What these vehicles have received in this tick."""
        received = self._reception.receive(tick, group)
        motions = self._motions.take(received.indices, axis=1, mode="wrap")
        return Heard(tick, received, motions, tick >= self._reception.kept)

    def pairs(self, group: slice, heard: Heard, which: BoolArray) -> Pairs:
        """Those of these pairs (G, K) that are heard."""
        pair = np.nonzero(which & heard.received.fresh)
        place, other = pair[0], self._other[group][pair]
        flown = self._flown.take(heard.received.indices[pair], axis=0, mode="wrap").T
        left = _left_of_first(heard.tick) * (self._heard_at_once[group][pair] & (flown[6] > 0.0))
        flown[:3] += left * self._first_enu_m_s2[:, other]
        last = np.concatenate([heard.motions[:6, pair[0], pair[1]], flown[:6]])
        return Pairs(place, place + group.start, other, last, heard.received.age_s[pair], flown[6] > 0.0)


@dataclass(frozen=True, slots=True)
class AskedOfPairs:
    """Accelerations u with normal . u >= least, (3, P) and (P,), as `Separation` asks them of vehicles in formation.

    `least_m_s2` is infinite where only the core knows: both are so close that it chooses the normal, or the other one is not
    in formation yet; it is -infinite where nothing is asked. `margins_m` (2, P): the required distance, and by how much the
    vehicles will be farther apart.
    """

    normal: FloatArray
    least_m_s2: FloatArray
    margins_m: FloatArray


class BatchSeparation:
    """The barriers of all near pairs. Slots do not move in a batch."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns, slot_enu_m: FloatArray) -> None:
        """`slot_enu_m` is (3, B n)."""
        settings = [separation_settings_of(scenario.fleet, 0) for scenario in scenarios]
        errors = [position_error_of(scenario) for scenario in scenarios]
        self._slot_enu_m = slot_enu_m
        self._separation_m = columns.spread([s.separation_m for s in settings])
        self._kept_m = self._separation_m + KEPT_M
        self._braking_m_s2 = 2.0 * columns.spread([s.braking_m_s2 for s in settings])
        self._level_error_m = columns.spread([hypot(e.horizontal_m, e.horizontal_m) for e in errors])
        self._height_error_m = columns.spread([hypot(e.vertical_m, e.vertical_m) for e in errors])
        error_m = self._level_error_m + HEIGHT_WEIGHT * self._height_error_m
        self._most_required_m = self._kept_m + error_m + PASSING_M

    def may_ask(self, group: slice, heard: Heard, moving: Moving, most_m_s2: FloatArray) -> BoolArray:
        """Whether an acceleration of at most this size (G,) might violate the constraint of a pair (G, K).

        The sizes of accelerations stand for their parts along the line between both.
        """
        if not heard.all_formed:
            return heard.received.fresh
        motions, age_s = heard.motions, heard.received.age_s
        apart = moving.now[:, :, None] - motions[:6]
        apart[:3] += LAG_S * apart[VELOCITY]
        apart[:3] -= age_s * motions[VELOCITY]
        apart[2::3] *= HEIGHT_WEIGHT
        off_m, moves_m_s, flown_m_s2 = apart[:3], apart[VELOCITY], motions[6]
        turns_m_s = _size(moving.velocity_enu_m_s - moving.now[VELOCITY])[:, None] + (LAG_S + age_s) * flown_m_s2
        apart_m, speed_m_s = _length(off_m), _length(moves_m_s) + turns_m_s
        closing_m_s = turns_m_s - _along(off_m, moves_m_s) / np.maximum(apart_m, LEAST_DISTANCE_M)
        braking_m_s2, approach_m_s = self._braking_m_s2[group, None], np.maximum(closing_m_s, 0.0)
        margin_m = apart_m - self._most_required_m[group, None] - UNSEEN_DELAY_S * approach_m_s
        margin_m -= TURNING_S2 * speed_m_s * speed_m_s / (apart_m + NEAREST_M)
        margin_m -= GROWTH_M_S * np.maximum(age_s - BELIEVED_S, 0.0)
        straight_m = braking_m_s2 / (SLOPE_1_S * SLOPE_1_S)
        # The slowest approach is that from above or below, where a normal is shortest.
        allowed_m_s = np.sqrt(2.0 * SMALLEST_SIZE * braking_m_s2 * np.maximum(margin_m - 0.5 * straight_m, 1e-9))
        least = RESPONSE_1_S * (closing_m_s - allowed_m_s) + braking_m_s2 / allowed_m_s * approach_m_s
        least = np.maximum(least + flown_m_s2, 0.5 * least)
        eased_m_s2 = np.maximum(LARGEST_PULL_M_S2 - flown_m_s2, LEAST_PULL_M_S2)
        eased_m_s2 += PULL_SLOPE_1_S2 * np.maximum(margin_m, 0.0)
        return np.asarray((margin_m <= straight_m) | (np.minimum(-least, eased_m_s2) < most_m_s2[:, None]))

    def asked(self, pairs: Pairs, moving: Moving) -> AskedOfPairs:
        """What the others of these pairs ask of a group."""
        last, ahead_s, kept_m = pairs.last, pairs.age_s + LAG_S, self._kept_m[pairs.own]
        off_m = moving.position_enu_m[:, pairs.place] - last[:3] - last[VELOCITY] * ahead_s
        moves_m_s = moving.velocity_enu_m_s[:, pairs.place] - last[VELOCITY] - last[ACCELERATION] * ahead_s
        off_m[2] *= HEIGHT_WEIGHT
        moves_m_s[2] *= HEIGHT_WEIGHT
        apart_m = _size(off_m)
        normal = off_m / np.maximum(apart_m, LEAST_DISTANCE_M)
        closing_m_s = -_dot(normal, moves_m_s)
        across_m_s2 = (_dot(moves_m_s, moves_m_s) - closing_m_s * closing_m_s) / (apart_m + NEAREST_M)
        normal[2] *= HEIGHT_WEIGHT
        required_m = self._required_m(pairs, kept_m, off_m, np.abs(normal[2]))
        required_m += TURNING_S2 * across_m_s2 + UNSEEN_DELAY_S * np.maximum(closing_m_s, 0.0)
        required_m += GROWTH_M_S * np.maximum(pairs.age_s - BELIEVED_S, 0.0)
        size, margin_m = _size(normal), apart_m - required_m
        braking_m_s2 = self._braking_m_s2[pairs.own] * size
        allowed_m_s, slope_1_s = approach_speeds(margin_m, braking_m_s2, SLOPE_1_S, FASTEST_LEAVING_M_S)
        least_m_s2 = RESPONSE_1_S * (closing_m_s - allowed_m_s) + slope_1_s * closing_m_s - across_m_s2
        towards_m_s2 = _dot(normal, last[COMMANDED])
        towards_m_s2[(pairs.age_s > BELIEVED_S) & (towards_m_s2 < 0.0)] = 0.0
        least_m_s2 = np.maximum(least_m_s2 + towards_m_s2, 0.5 * least_m_s2) / size
        least_m_s2[(apart_m <= SIDEWAYS_RATIO * kept_m) | ~pairs.formed] = np.inf
        least_m_s2[~_are_near(pairs, moving)] = -np.inf
        return AskedOfPairs(normal / size, least_m_s2, np.stack([required_m, margin_m]))

    def within(self, pairs: Pairs, moving: Moving) -> BoolArray:
        """Whether they are nearer than separation_m now, by the last packets (P,)."""
        off_m = moving.now[:3, pairs.place] - pairs.last[:3] - pairs.last[VELOCITY] * pairs.age_s
        off_m[2] *= HEIGHT_WEIGHT
        return np.asarray(_size(off_m) < NEARLY * self._separation_m[pairs.own])

    def _required_m(self, pairs: Pairs, kept_m: FloatArray, off_m: FloatArray, upward: FloatArray) -> FloatArray:
        """`Separation._required` of vehicles that are heard, in slots at rest; `off_m` (3, P) with weighted heights."""
        level_m, height_m = self._level_error_m[pairs.own], self._height_error_m[pairs.own]
        margin_m = np.minimum(level_m + height_m * upward, LARGEST_ERROR_RATIO * kept_m)
        slots_m = self._slot_enu_m[:, pairs.own] - self._slot_enu_m[:, pairs.other]
        slots_m[2] *= HEIGHT_WEIGHT
        passing_m = SLOT_SHARE * np.maximum(_size(off_m - slots_m) - PLACED_WITHIN_M, 0.0)
        allowance_m = np.maximum(SLOT_SHARE * np.abs(_size(slots_m) - kept_m), passing_m)
        return np.asarray(kept_m + np.minimum(margin_m + np.minimum(passing_m, PASSING_M), allowance_m))


def approach_speeds(
    distance_m: FloatArray, deceleration_m_s2: FloatArray, slope_1_s: float, fastest_leaving_m_s: float
) -> tuple[FloatArray, FloatArray]:
    """`companion.geometry.curves.approach_speed` of arrays."""
    straight_m = deceleration_m_s2 / (slope_1_s * slope_1_s)
    far = distance_m > straight_m
    root_m_s = np.sqrt(2.0 * deceleration_m_s2 * (np.maximum(distance_m, straight_m) - 0.5 * straight_m))
    line_m_s = slope_1_s * distance_m
    speed_m_s = np.where(far, root_m_s, np.maximum(line_m_s, -fastest_leaving_m_s))
    slope = np.where(line_m_s >= -fastest_leaving_m_s, slope_1_s, 0.0)
    return speed_m_s, np.where(far, deceleration_m_s2 / root_m_s, slope)


def position_error_of(scenario: Scenario) -> PositionError:
    """One sigma, as the estimators report it."""
    x_m, y_m, z_m = scenario.stand_in.sensor_model().position_sd_m
    return PositionError(hypot(x_m, y_m), z_m)


def _are_near(pairs: Pairs, moving: Moving) -> BoolArray:
    """Whether a vehicle computes anything for the other one, as `Motions.peers` decides it (P,)."""
    now = moving.now[:, pairs.place]
    speeds_m_s, other_m_s = np.abs(now[VELOCITY]).sum(axis=0), np.abs(pairs.last[VELOCITY]).sum(axis=0)
    reach_m = NEAR_M + NEAR_S * speeds_m_s + (NEAR_S + pairs.age_s) * other_m_s
    return np.asarray(np.abs(now[:3] - pairs.last[:3]).max(axis=0, initial=0.0) < reach_m)


def _left_of_first(tick: int) -> float:
    """What is left in this tick of the difference between an acceleration that began with the first command, and with zero."""
    return float((1.0 - LAG_SHARE) ** (tick + 1))


def _along(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _length(a: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(_along(a, a)))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("kp,kp->p", a, b))


def _size(a: FloatArray) -> FloatArray:
    return np.sqrt(_dot(a, a))
