"""What the kinds share whose position is given over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor, hypot
from typing import Annotated, Self

from msgspec import Meta
from msgspec.structs import replace

from companion.config.reference.base import BaseReference, Slower, any_motions
from companion.geometry.curves import Curve, Harmonic, Motion
from companion.types.values import Vector3

SLOWEST_TURN_M_S = 0.2  # below this speed a course turns fast, and nobody needs to follow it


@dataclass(frozen=True, slots=True)
class Extremes:
    """The box of a motion, its largest speed and acceleration, and its largest rates upwards and downwards."""

    low_enu_m: Vector3
    high_enu_m: Vector3
    speed_m_s: float
    acceleration_m_s2: float
    climb_m_s: float
    descent_m_s: float


class TimedReference(BaseReference, frozen=True, kw_only=True):
    """One whose position is given over time. It begins and ends at rest.

    pace: how many times as fast as given it is flown
    """

    PLACED = False

    pace: Annotated[float, Meta(ge=0.01, le=10)] = 1.0

    def given(self) -> tuple[Curve, Sequence[float]]:
        """The curve at pace 1, and rising times of it from the beginning to the end, dense enough to judge it by."""
        raise NotImplementedError

    @property
    def start_enu_m(self) -> Vector3:
        return self.given()[0](0.0)[0]

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        extremes = _extremes(self)
        return extremes.low_enu_m, extremes.high_enu_m

    def curve(self) -> Curve:
        return at_pace(self.given()[0], self.pace)

    def largest_pace(self) -> tuple[float, float]:
        extremes = _extremes(self)
        return extremes.speed_m_s, extremes.acceleration_m_s2

    def largest_climb(self) -> tuple[float, float]:
        extremes = _extremes(self)
        return extremes.climb_m_s, extremes.descent_m_s

    def whole_s(self) -> float:
        return float(ceil(self.curve_s()))

    def curve_s(self) -> float:
        return self.given()[1][-1] / self.pace

    def motions(self, slots_turn: bool) -> list[list[Harmonic]]:
        """It may move at any rate within its largest pace, in any direction."""
        del slots_turn
        low, high = self.corners_enu_m()
        return any_motions(*self.largest_pace(), up=1.0 if high[2] > low[2] else 0.0)

    def turning_s(self) -> Sequence[float]:
        """Where it moves."""
        curve = self.curve()
        times_s = (time_s / self.pace for time_s in self.given()[1])
        return [time_s for time_s in times_s if hypot(*curve(time_s)[1][:2]) > SLOWEST_TURN_M_S]

    def excess(self, limit: str, most: float, times: float) -> Slower:
        del limit, most
        return self.slower_pace(times)._replace(asks=f"{self.pace:g} asks")

    def slower_pace(self, times: float) -> Slower:
        pace = self._slower(times)
        return Slower("pace", f"{self.pace:g}", f"at most {pace:g}", (("pace", pace),))

    def slow_down(self, times: float) -> Self:
        return replace(self, pace=self._slower(times))

    def _slower(self, times: float) -> float:
        return floor(self.pace / times * 1000.0) / 1000.0


@lru_cache(maxsize=8)  # several checks of a reference need them
def _extremes(reference: TimedReference) -> Extremes:
    curve, times_s = reference.given()
    positions, velocities, accelerations = zip(*map(curve, times_s), strict=True)
    xs, ys, zs = zip(*positions, strict=True)
    up_m_s, pace = [velocity[2] for velocity in velocities], reference.pace
    return Extremes(
        (min(xs), min(ys), min(zs)),
        (max(xs), max(ys), max(zs)),
        pace * max(hypot(*velocity) for velocity in velocities),
        pace**2 * max(hypot(*acceleration) for acceleration in accelerations),
        pace * max(0.0, *up_m_s),
        pace * max(0.0, *(-rate_m_s for rate_m_s in up_m_s)),
    )


def at_pace(curve: Curve, pace: float) -> Curve:
    """The curve flown this many times as fast."""

    def at(time_s: float) -> Motion:
        position, (vx, vy, vz), (ax, ay, az) = curve(time_s * pace)
        return position, (vx * pace, vy * pace, vz * pace), (ax * pace**2, ay * pace**2, az * pace**2)

    return at
