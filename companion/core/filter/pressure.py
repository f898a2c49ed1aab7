"""How long a vehicle that no evasion shakes off may press this one.

A position may be false: of a receiver that is deceived, of a mistaken origin, or a lie. One that stays on this vehicle, with
its velocity, would make it evade for ever, over the speed limit and through the fence. A real vehicle follows no evasion for
long. So separation goes before obstacles, fence and speed limit for MOST_S, and for an evasion of MOST_M. From then on the
other vehicle is unshaken: its constraint gives way to all others, and while it is nearer than separation_m it has none.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import dist, hypot

from msgspec import Struct
from msgspec.structs import replace

from companion.core.filter.solver import Constraint, Rank
from companion.core.filter.vehicles import Barrier
from companion.geometry.vectors import extrapolated
from companion.types.autopilot import VehicleState
from companion.types.values import ZERO3, Vector3

MOST_S, MOST_M = 2.0, 5.0
ON_TOP_RATIO = 0.9  # nearer than this times separation_m, no real vehicle stays with one that evades
FLEES_M_S2 = 1.0  # less is flown where position errors alone bring two vehicles so near
FOLLOWED_S = 1.0  # who stays on top for so long of a vehicle that flees follows it
OVERRIDDEN_M_S2 = 0.5  # a limit that is missed by less is not overridden: noise does that
BINDING_M_S2 = 0.05  # a constraint that is met by less than this holds the vehicle
RECOVERS = 0.2  # seconds that count again, for each second without pressure
LEAST_S = 1e-3  # in the first tick
LASTS_S = 0.5
GAP_S = 0.5  # after a longer time without the filter nothing of before counts
UNTIL_S = 1.0  # an unshaken vehicle counts again when no more than this is used
VEHICLE, LAST = Rank.VEHICLE, Rank.UNSHAKEN
PLACES = (Rank.OBSTACLE, Rank.FENCE)
OVERRIDDEN = (*PLACES, Rank.SPEED)


class _Pressing(Struct, frozen=True, gc=False):
    """One vehicle: the time that it has used, where and when it began to press, and how this vehicle would have flown on.

    `flees`: this vehicle flees from it, and still has it on top; `fled_s`: for so long. `within`: nearer than separation_m.
    """

    used_s: float
    fled_s: float
    unshaken: bool
    presses: bool
    flees: bool
    within: bool
    since_s: float
    from_enu_m: Vector3
    onwards_enu_m_s: Vector3


class Pressure:
    """Which vehicles nearby are unshaken. `pressing` is empty while none has pressed this vehicle for a while."""

    def __init__(self, separation_m: float) -> None:
        self._separation_m = separation_m
        self._now_s = 0.0
        self.pressing: dict[int | str, _Pressing] = {}

    @property
    def lasts(self) -> bool:
        """Whether a vehicle presses for longer than two that meet do."""
        return any(one.used_s > LASTS_S for one in self.pressing.values())

    @property
    def unshaken(self) -> tuple[str, ...]:
        """Their names, for the operator."""
        return tuple([str(key) for key, one in self.pressing.items() if one.unshaken])

    def bounded(self, barriers: Iterable[Barrier]) -> list[Barrier]:
        """The barriers without those of unshaken vehicles within separation_m; the others of unshaken ones give way to all."""
        kept = []
        for barrier in barriers:
            one = self.pressing.get(barrier.other.key)
            if one is None or not one.unshaken:
                kept.append(barrier)
            elif not (one.within and one.fled_s > FOLLOWED_S):
                nx, ny, nz, least, _ = barrier.constraint_without_margins or barrier.constraint
                kept.append(replace(barrier, constraint=(nx, ny, nz, least, LAST), constraint_without_margins=None))
        return kept

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        barriers: Sequence[Barrier],
        constraints: Iterable[Constraint],
        flown_enu_m_s2: Vector3,
    ) -> None:
        """Take what is flown in this tick. `barriers` are unbounded ones, `constraints` those that were asked."""
        elapsed_s, self._now_s = now_s - self._now_s, now_s
        if elapsed_s > GAP_S:
            self.pressing.clear()
        overrides = [
            constraint[4]
            for constraint in constraints
            if constraint[4] in OVERRIDDEN and _short_m_s2(constraint, flown_enu_m_s2) > OVERRIDDEN_M_S2
        ]
        # Where it would have flown without them: on, or nowhere beyond a fence.
        onwards_enu_m_s = ZERO3 if any(rank in PLACES for rank in overrides) else vehicle.velocity_enu_m_s
        pressing: dict[int | str, _Pressing] = {}
        for barrier in barriers:
            if not barrier.below and (now := self._now(now_s, vehicle, barrier, bool(overrides), flown_enu_m_s2)):
                pressing[barrier.other.key] = replace(now, onwards_enu_m_s=onwards_enu_m_s)
        for key in [*pressing, *(key for key in self.pressing if key not in pressing)]:
            after = _after(self.pressing.get(key), pressing.get(key), elapsed_s)
            if after is not None and after.used_s > 0.0:
                self.pressing[key] = after
            else:
                self.pressing.pop(key, None)

    def _now(
        self, now_s: float, vehicle: VehicleState, barrier: Barrier, overrides: bool, flown_enu_m_s2: Vector3
    ) -> _Pressing | None:
        """What this vehicle does in this tick; None of one that does not press and has not."""
        asked, before = barrier.constraint_without_margins or barrier.constraint, self.pressing.get(barrier.other.key)
        short_m_s2 = _short_m_s2(asked, flown_enu_m_s2)
        # What is flown along the normal is what is asked less what is missed of it.
        flees = asked[3] - short_m_s2 > FLEES_M_S2
        binds = overrides and short_m_s2 > -BINDING_M_S2
        if before is None and not flees and not binds:
            return None
        apart_m = _apart_m(now_s, vehicle, barrier)
        flees = flees and apart_m < ON_TOP_RATIO * self._separation_m
        if before is not None and before.unshaken:
            binds = short_m_s2 > BINDING_M_S2
        within = apart_m < self._separation_m
        return _Pressing(
            used_s=LEAST_S,
            fled_s=0.0,
            unshaken=False,
            presses=flees or binds,
            flees=flees,
            within=within,
            since_s=now_s,
            from_enu_m=vehicle.position_enu_m,
            onwards_enu_m_s=ZERO3,
        )


def _after(before: _Pressing | None, now: _Pressing | None, elapsed_s: float) -> _Pressing | None:
    """What one vehicle has used after this tick; `now` is None where it is far away. None where it does not press."""
    if before is None:
        return now if now is not None and now.presses else None
    if now is None or not now.presses:
        used_s, fled_s = before.used_s - RECOVERS * elapsed_s, max(0.0, before.fled_s - RECOVERS * elapsed_s)
        unshaken, within = before.unshaken and used_s > UNTIL_S, now is not None and now.within
        return replace(
            before, used_s=used_s, fled_s=fled_s, unshaken=unshaken, presses=False, flees=False, within=within
        )
    goes_on = before.presses and (now.onwards_enu_m_s is ZERO3) is (before.onwards_enu_m_s is ZERO3)
    since = before if goes_on else now
    used_s = min(before.used_s + elapsed_s, MOST_S)
    fled_s = min(before.fled_s + elapsed_s, MOST_S) if now.flees else before.fled_s
    undisturbed_enu_m = extrapolated(since.from_enu_m, since.onwards_enu_m_s, now.since_s - since.since_s)
    if dist(now.from_enu_m, undisturbed_enu_m) > MOST_M:
        used_s = MOST_S
    unshaken = before.unshaken or used_s >= MOST_S
    return replace(since, used_s=used_s, fled_s=fled_s, unshaken=unshaken, flees=now.flees, within=now.within)


def _apart_m(now_s: float, vehicle: VehicleState, barrier: Barrier) -> float:
    """The present distance by the last packet, in the metric of separation_m; of a silent vehicle the expected one."""
    other = barrier.other
    if other.silence is not None:
        return barrier.margin_m + barrier.required_m
    old_s = now_s - vehicle.position_time_s
    (x, y, z), (px, py, pz) = (
        extrapolated(vehicle.position_enu_m, vehicle.velocity_enu_m_s, old_s),
        extrapolated(other.last[0], other.last[1], other.age_s),
    )
    return hypot(x - px, y - py, (z - pz) * other.height_weight)


def _short_m_s2(constraint: Constraint, flown_enu_m_s2: Vector3) -> float:
    """By how much an acceleration misses this constraint; below zero where it meets it."""
    (nx, ny, nz, least, _), (x, y, z) = constraint, flown_enu_m_s2
    return least - nx * x - ny * y - nz * z
