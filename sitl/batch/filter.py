"""companion.core.filter in formation, for many vehicles, and the RFT of those that it keeps off their slots.

Arrays find the vehicles whose acceleration the filter may change: their own violates a constraint of another vehicle, of the
airspace or of a speed. For these alone the filter of the core decides, with all constraints that may matter to it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import inf, tan

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.assembly import (
    bounds_of,
    output_limits_of,
    safety_filter_of,
    separation_settings_of,
    vertical_braking_m_s2,
)
from companion.core.consensus.kept_off import KeptOff
from companion.core.filter.filter import (
    BOUNDARY_RESPONSE_1_S,
    FASTEST_RETURN_M_S,
    FLOOR_M,
    NOTHING_SEEN,
    SLOPE_1_S,
    SPEED_RESPONSE_1_S,
    STILL_M_S,
    Bounds,
    Filtered,
    SafetyFilter,
)
from companion.core.filter.motion import Ahead, Other
from companion.core.filter.solver import MET_M_S2, VEHICLE
from companion.core.filter.vehicles import LARGEST_PULL_M_S2, LEAST_PULL_M_S2, PULL_SLOPE_1_S2, Barrier, Separation
from companion.geometry.curves import approach_speed
from companion.geometry.formations import HEIGHT_WEIGHT
from companion.types.autopilot import VehicleState
from companion.types.formation import FlownSlot, FormationState
from companion.types.values import GRAVITY_M_S2, ZERO3, Vector3
from sitl.autopilots.autopilot import DT_S
from sitl.batch.columns import BoolArray, Columns, IntArray
from sitl.batch.nearby import (
    COMMANDED,
    AskedOfPairs,
    BatchSeparation,
    Moving,
    Nearby,
    Pairs,
    approach_speeds,
    position_error_of,
)
from sitl.flight.files import ids_of
from sitl.flight.lockstep import TELEMETRY_STEPS
from sitl.flight.scenario import Scenario

MET = 0.5 * MET_M_S2  # a violation by less is none in the core either, however the sums are rounded


@dataclass(frozen=True, slots=True)
class ChangedVehicles:
    """The vehicles of a group that the filter looked at (C,): their accelerations (3, C), and what others removed (C,)."""

    places: IntArray
    acceleration_enu_m_s2: FloatArray
    removed_m_s2: FloatArray


class BatchFilter:
    """The filters of all vehicles of a batch."""

    def __init__(
        self, scenarios: Sequence[Scenario], columns: Columns, slot_enu_m: FloatArray, telemetry: FloatArray
    ) -> None:
        """`slot_enu_m` is (3, B n), `telemetry` (9, B n)."""
        self._nearby = Nearby(scenarios, columns, telemetry)
        self._separation = BatchSeparation(scenarios, columns, slot_enu_m)
        self._bounds = BatchBounds(scenarios, columns)
        self._flyable = Flyable(scenarios, columns)
        self._singles = Singles(scenarios, columns, slot_enu_m)
        self._pressed = np.zeros(columns.count, dtype=np.bool_)

    def step(
        self,
        tick: int,
        group: slice,
        telemetry: FloatArray,
        wanted_enu_m_s2: FloatArray,
        possible_enu_m_s2: FloatArray,
        disturbance_enu_m_s2: FloatArray,
    ) -> ChangedVehicles:
        """`wanted_enu_m_s2` (3, G), and what tilt and thrust leave of it against a horizontal disturbance (2, G)."""
        moving, heard = self._nearby.moving(group, telemetry), self._nearby.heard(tick, group)
        most_m_s2 = np.maximum(_size(wanted_enu_m_s2), _size(possible_enu_m_s2))  # wind may push farther than is wanted
        looked_at = self._bounds.matter(group, moving, wanted_enu_m_s2, possible_enu_m_s2) | self._pressed[group]
        pairs = self._nearby.pairs(group, heard, self._separation.may_ask(group, heard, moving, most_m_s2))
        if pairs.place.size:
            asked = self._separation.asked(pairs, moving)
            looked_at[pairs.place[_violated(pairs, asked, wanted_enu_m_s2, possible_enu_m_s2)]] = True
            looked_at[pairs.place[_eased(pairs, asked, wanted_enu_m_s2)]] = True
        places = np.flatnonzero(looked_at)
        if not places.size:
            return ChangedVehicles(places, np.zeros((3, 0)), np.zeros(0))
        pairs = self._nearby.pairs(group, heard, looked_at[:, None])
        asked = self._separation.asked(pairs, moving)
        matters = self._flyable.may_violate(pairs, asked, disturbance_enu_m_s2) | self._separation.within(pairs, moving)
        matters |= _violated(pairs, asked, wanted_enu_m_s2, possible_enu_m_s2) | _eased(pairs, asked, wanted_enu_m_s2)
        near = self._singles.near(pairs, asked, np.flatnonzero(matters))
        rows = [moving.now, moving.position_enu_m, moving.velocity_enu_m_s, wanted_enu_m_s2, disturbance_enu_m_s2]
        states = np.concatenate(rows)[:, places].T.tolist()
        allowed: list[tuple[float, ...]] = []
        for place, state in zip(places.tolist(), states, strict=True):
            column = group.start + place
            now_s = (tick * TELEMETRY_STEPS + self._singles.phase_steps[column]) * DT_S
            filtered, self._pressed[column] = self._singles.filtered(column, now_s, state, near[place])
            allowed.append((*filtered.acceleration_enu_m_s2, filtered.removed_accel_m_s2))
        table = np.array(allowed).T
        return ChangedVehicles(places, table[:3], table[3])

    def send(self, tick: int, group: slice, telemetry: FloatArray, commanded_enu_m_s2: FloatArray) -> None:
        """Publish what these vehicles do; their commands (3, G) are those within the limits."""
        self._nearby.send(tick, group, telemetry[:6], commanded_enu_m_s2)


def _size(a: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.square(a).sum(axis=0)))


def _violated(pairs: Pairs, asked: AskedOfPairs, wanted: FloatArray, possible: FloatArray) -> BoolArray:
    """Whether one of these accelerations (3, G) violates what is asked (P,)."""
    along = np.einsum("kp,kp->p", asked.normal, wanted[:, pairs.place])
    np.minimum(along, np.einsum("kp,kp->p", asked.normal, possible[:, pairs.place]), out=along)
    return np.asarray(asked.least_m_s2 - along > MET)


def _eased(pairs: Pairs, asked: AskedOfPairs, wanted: FloatArray) -> BoolArray:
    """Whether the core eases one of these accelerations (3, G) towards a vehicle that is near (P,)."""
    pull_m_s2 = -np.einsum("kp,kp->p", asked.normal, wanted[:, pairs.place])
    away_m_s2 = np.einsum("kp,kp->p", asked.normal, pairs.last[COMMANDED])
    most_m_s2 = np.maximum(LARGEST_PULL_M_S2 - away_m_s2, LEAST_PULL_M_S2)
    most_m_s2 += PULL_SLOPE_1_S2 * np.maximum(asked.margins_m[1], 0.0)
    return np.asarray((pull_m_s2 > most_m_s2) & (asked.least_m_s2 > -inf))


class Singles:
    """The filter of the core for each vehicle that ever needed it."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns, slot_enu_m: FloatArray) -> None:
        ids = [ids_of(scenario) for scenario in scenarios]
        self._scenarios, self._formation = scenarios, columns.formation.tolist()
        self._ids = [ids[k // columns.vehicles][k % columns.vehicles] for k in columns.order.tolist()]
        self._slots = [FlownSlot((x, y, z)) for x, y, z in slot_enu_m.T.tolist()]
        self._errors = [position_error_of(scenario) for scenario in scenarios]
        self._made: dict[int, _Single] = {}
        self.phase_steps: list[int] = columns.phase_steps.tolist()

    def near(self, pairs: Pairs, asked: AskedOfPairs, which: IntArray) -> dict[int, list[Barrier]]:
        """The other vehicles of these pairs and what they ask, by the place of their vehicle in the group."""
        near: dict[int, list[Barrier]] = defaultdict(list)
        ids = (pairs.place[which].tolist(), pairs.own[which].tolist(), pairs.other[which].tolist())
        lasts = np.vstack([pairs.last[:, which], pairs.age_s[which], pairs.formed[which]]).T.tolist()
        rows = np.vstack([asked.normal[:, which], asked.least_m_s2[which], asked.margins_m[:, which]]).T.tolist()
        for place, own, other, last, (nx, ny, nz, least, required_m, margin_m) in zip(*ids, lasts, rows, strict=True):
            x, y, z, vx, vy, vz, ax, ay, az, ux, uy, uz, age_s, formed = last
            key = self._ids[other]
            one = Other(
                key,
                ((x, y, z), (vx, vy, vz), (ax, ay, az)),
                (ux, uy, uz),
                age_s,
                None,
                self._errors[self._formation[other]],
                HEIGHT_WEIGHT,
                self._slots[other] if formed else None,
                makes_way=bool(formed),
                side=1.0 if self._ids[own] < key else -1.0,
            )
            near[place].append(Barrier((nx, ny, nz, least, VEHICLE), one, ZERO3, required_m, margin_m))
        return near

    def filtered(self, column: int, now_s: float, state: list[float], near: list[Barrier]) -> tuple[Filtered, bool]:
        """What the filter lets this vehicle fly, and whether another one presses it since.

        `state` is its position, velocity, both after its lag, the wanted acceleration, and the horizontal disturbance.
        """
        x, y, z, vx, vy, vz, qx, qy, qz, wx, wy, wz, ux, uy, uz, dx, dy = state
        single, error = self._of(column), self._errors[self._formation[column]]
        ahead = Ahead((qx, qy, qz), (wx, wy, wz))
        vehicle = VehicleState((x, y, z), (vx, vy, vz), now_s)
        only_core = {barrier.other.key for barrier in near if barrier.constraint[3] == inf}
        if by_core := single.close | only_core:
            of, slot = single.separation.barrier, self._slots[column]
            near = [of(ahead, error, slot, b.other) if b.other.key in by_core else b for b in near]
            single.close = only_core
        wanted = (ux, uy, uz)
        slowed, speed = single.bounds.limit_speed(ahead, wanted)
        bounds = single.bounds.constraints(ahead, single.ground_enu_m) + speed
        safety_filter = single.safety_filter
        allowed = safety_filter.allowed(now_s, vehicle, near, bounds, wanted, slowed, (dx, dy, 0.0), NOTHING_SEEN)
        return allowed, safety_filter.is_pressed

    def _of(self, column: int) -> _Single:
        if column not in self._made:
            scenario, own_id = self._scenarios[self._formation[column]], self._ids[column]
            fleet, ground_enu_m = scenario.fleet, scenario.starts_enu_m[own_id]
            separation = Separation(separation_settings_of(fleet, own_id))
            self._made[column] = _Single(safety_filter_of(fleet, own_id), bounds_of(fleet), separation, ground_enu_m)
        return self._made[column]


@dataclass(slots=True)
class _Single:
    """`close` are those for which `separation` may keep a direction to leave them by."""

    safety_filter: SafetyFilter
    bounds: Bounds
    separation: Separation
    ground_enu_m: Vector3
    close: set[int | str] = field(default_factory=set)


class Flyable:
    """The accelerations that tilt and thrust allow."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns) -> None:
        limits = [output_limits_of(scenario.fleet) for scenario in scenarios]
        level = [GRAVITY_M_S2 * e.max_thrust_ratio * tan(e.max_tilt_rad) for e in limits]
        vertical = [GRAVITY_M_S2 * max(e.max_thrust_ratio - 1.0, 1.0 - e.min_thrust_ratio) for e in limits]
        self._level_m_s2, self._vertical_m_s2 = columns.spread(level), columns.spread(vertical)

    def may_violate(self, pairs: Pairs, asked: AskedOfPairs, disturbance_enu_m_s2: FloatArray) -> BoolArray:
        """Whether one of them may violate what a pair asks (P,); horizontal disturbance (2, G)."""
        level, own = np.hypot(asked.normal[0], asked.normal[1]), pairs.own
        most_m_s2 = self._level_m_s2[own] * level + self._vertical_m_s2[own] * np.abs(asked.normal[2])
        most_m_s2 -= (asked.normal[:2] * disturbance_enu_m_s2[:, pairs.place]).sum(axis=0)
        return np.asarray(asked.least_m_s2 > -most_m_s2)


class BatchBounds:
    """Where the speed limits, the ground, the box of the fence or what else is in the airspace may matter."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns) -> None:
        airspaces = [scenario.fleet.airspace for scenario in scenarios]
        speeds = [scenario.fleet.envelope for scenario in scenarios]
        starts = [[scenario.starts_enu_m[i] for i in ids_of(scenario)] for scenario in scenarios]
        fences = np.array([[a.fence.min_enu_m, a.fence.max_enu_m] for a in airspaces], dtype=np.float64)
        self._low_enu_m, self._high_enu_m = fences[columns.formation].transpose(1, 2, 0).copy()
        floor_m = columns.spread(
            [min(FLOOR_M, 0.5 * s.fleet.takeoff_height_m) - s.fleet.airspace.clearance_m for s in scenarios]
        )
        self._floor_m = columns.in_columns(np.array(starts, dtype=np.float64))[2] + floor_m
        self._clearance_m = columns.spread([a.clearance_m for a in airspaces])
        level = columns.spread([separation_settings_of(s.fleet, 0).braking_m_s2 for s in scenarios])
        vertical = columns.spread([vertical_braking_m_s2(s.fleet) for s in scenarios])
        self._braking_m_s2 = np.stack([level, level, vertical] * 2 + [vertical])
        self._is_box = columns.spread([float(a.is_box) for a in airspaces]) > 0.0
        self._level_m_s = columns.spread([e.max_speed_m_s for e in speeds])
        self._climb_m_s = columns.spread([e.max_climb_m_s for e in speeds])
        self._descent_m_s = columns.spread([e.max_descent_m_s for e in speeds])
        self._most_clearance_m, self._least_braking_m_s2 = self._clearance_m.max(), self._braking_m_s2.min()
        self._least_limit_m_s = float(min(self._level_m_s.min(), self._climb_m_s.min(), self._descent_m_s.min()))

    def matter(self, group: slice, moving: Moving, wanted: FloatArray, possible: FloatArray) -> BoolArray:
        """Whether they may for these accelerations (G,). Polygons and obstacles always may."""
        if self._is_clear(group, moving, wanted, possible):
            return ~self._is_box[group]
        position, velocity = moving.position_enu_m, moving.velocity_enu_m_s
        gaps_m = np.concatenate(
            [
                position - self._low_enu_m[:, group],
                self._high_enu_m[:, group] - position,
                position[2:] - self._floor_m[group],
            ]
        )
        rates_m_s = np.concatenate([velocity, -velocity, velocity[2:]])
        speed_m_s, slope_1_s = approach_speeds(
            gaps_m - self._clearance_m[group], self._braking_m_s2[:, group], SLOPE_1_S, FASTEST_RETURN_M_S
        )
        least_m_s2 = -BOUNDARY_RESPONSE_1_S * (rates_m_s + speed_m_s) - slope_1_s * rates_m_s
        low, high = np.minimum(wanted, possible), np.maximum(wanted, possible)
        along_m_s2 = np.concatenate([low, -high, low[2:]])
        matter = (least_m_s2 - along_m_s2 > MET).any(axis=0)
        matter |= self._too_fast(group, velocity, wanted) | self._too_fast(group, velocity, possible)
        matter |= ~self._is_box[group]
        return np.asarray(matter)

    def _is_clear(self, group: slice, moving: Moving, wanted: FloatArray, possible: FloatArray) -> bool:
        """Whether none of them matters even to the nearest, the fastest and the largest acceleration of the group at once."""
        position, velocity = moving.position_enu_m, moving.velocity_enu_m_s
        speed_m_s, *both_m_s2 = (float(_size(a).max()) for a in (velocity, wanted, possible))
        most_m_s2 = max(both_m_s2)
        sinks_m_s, sinks_m_s2 = max(0.0, -float(velocity[2].min())), max(0.0, -float(wanted[2].min()))
        low = (position - self._low_enu_m[:, group]).min(axis=1)
        high = (self._high_enu_m[:, group] - position).min(axis=1)
        below_m = min(low[2], (position[2] - self._floor_m[group]).min())
        ways = (
            (min(*low[:2], *high), speed_m_s, most_m_s2),
            (below_m, sinks_m_s, sinks_m_s2),
        )
        for gap_m, towards_m_s, towards_m_s2 in ways:
            allowed_m_s, _ = approach_speed(
                float(gap_m) - self._most_clearance_m, self._least_braking_m_s2, SLOPE_1_S, FASTEST_RETURN_M_S
            )
            # The slope of the approach speed is SLOPE_1_S at most.
            left_m_s2 = BOUNDARY_RESPONSE_1_S * (allowed_m_s - towards_m_s) - SLOPE_1_S * towards_m_s
            if left_m_s2 < towards_m_s2:
                return False
        return SPEED_RESPONSE_1_S * (self._least_limit_m_s - speed_m_s) > most_m_s2

    def _too_fast(self, group: slice, velocity: FloatArray, acceleration: FloatArray) -> BoolArray:
        """Whether this acceleration exceeds what the speed limits allow at this velocity."""
        up, level_m_s = velocity[2], np.hypot(velocity[0], velocity[1])
        left = np.where(up > 0.0, self._climb_m_s[group] - up, self._descent_m_s[group] + up)
        too_fast = np.where(up > 0.0, acceleration[2], -acceleration[2]) - SPEED_RESPONSE_1_S * left > MET
        along = (velocity[:2] * acceleration[:2]).sum(axis=0)
        left = SPEED_RESPONSE_1_S * (self._level_m_s[group] - level_m_s)
        too_fast |= (level_m_s > STILL_M_S) & (along - left * level_m_s > MET * level_m_s)
        return np.asarray(too_fast)


class KeptOffSlots:
    """The RFT that vehicles publish which the filter keeps off their slots."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns) -> None:
        self._phase_steps: list[int] = columns.phase_steps.tolist()
        self._holds = columns.spread([scenario.fleet.law.altitude == "hold" for scenario in scenarios]) > 0.0
        self._kept_off = [KeptOff() for _ in range(columns.count)]
        self._is_kept_off = np.zeros(columns.count, dtype=np.bool_)

    def published(
        self,
        tick: int,
        group: slice,
        changed: ChangedVehicles,
        own: FloatArray,
        target: Callable[[int], FormationState | None],
    ) -> tuple[list[int], FloatArray]:
        """The vehicles of this group that publish an RFT, and these RFTs (9, C).

        `own` (6, G): position minus slot, and velocity. `target`: the RFT that the law of a vehicle steers to, if any.
        """
        removed = np.zeros(own.shape[1])
        removed[changed.places] = changed.removed_m_s2
        candidates = np.flatnonzero((removed > 0.0) | self._is_kept_off[group])
        places: list[int] = []
        rfts: list[tuple[float, ...]] = []
        rows = (candidates.tolist(), removed[candidates].tolist(), own[:, candidates].T.tolist())
        for place, taken_m_s2, (x, y, z, *velocity) in zip(*rows, strict=True):
            column = group.start + place
            kept_off, now_s = self._kept_off[column], (tick * TELEMETRY_STEPS + self._phase_steps[column]) * DT_S
            if kept_off.intervened(now_s, taken_m_s2) and (rft := target(place)):
                height_m = rft.position_enu_m[2] if self._holds[column] else z  # no height is wanted of the slot
                vx, vy, vz = velocity
                if kept_off.rft(now_s, FormationState((x, y, height_m), (vx, vy, vz)), rft):
                    places.append(place)
                    rfts.append((*rft.position_enu_m, *rft.velocity_enu_m_s, *rft.acceleration_enu_m_s2))
            self._is_kept_off[column] = kept_off.is_kept_off
        return places, np.array(rfts).reshape(-1, 9).T
