"""A circle."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil, tau
from typing import ClassVar, Self

from companion.config.reference.base import CRUISE_M_S, PERIOD, RAMP, Asked, LappingReference, Size, box_about
from companion.config.values import PositionM
from companion.geometry.curves import Curve, Harmonic, centred_at, circle
from companion.types.values import Vector3


class CircleReference(LappingReference, frozen=True, tag_field="kind", tag="circle"):
    """A level circle, counterclockwise, from rest at its easternmost point.

    centre_enu_m: centre of the circle
    radius_m: radius
    clockwise: `true`: clockwise, seen from above
    """

    TITLE, POSITION, LAP_SAMPLES = "Circle", "centre_enu_m", 1
    ASKED: ClassVar[Mapping[str, Asked]] = {
        "radius_m": Asked("--radius", "of a circle, metres", "Radius", 6.0),
        "period_s": PERIOD,
        "ramp_s": RAMP,
        "clockwise": Asked("--clockwise", "a circle, seen from above", "clockwise"),
    }

    centre_enu_m: PositionM
    radius_m: Size
    clockwise: bool = False

    @property
    def start_enu_m(self) -> Vector3:
        x, y, z = self.centre_enu_m
        return (x + self.radius_m, y, z)

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        return box_about(self.centre_enu_m, self.radius_m, self.radius_m)

    def curve(self) -> Curve:
        period_s = -self.period_s if self.clockwise else self.period_s
        return centred_at(self.centre_enu_m, lambda time_s: circle(time_s, self.radius_m, period_s, self.ramp_s))

    def motions(self, slots_turn: bool) -> list[list[Harmonic]]:
        del slots_turn  # it points in all directions by itself
        lap = Harmonic(tau / self.period_s, (self.radius_m, self.radius_m, 0.0), rotates=True)
        return [[lap], [Harmonic.of_pace(*self.largest_pace(), (1.0, 1.0, 0.0), rotates=True)]]

    @classmethod
    def first(cls, size_m: float, height_m: float) -> Self:
        period_s = float(ceil(tau * size_m / CRUISE_M_S))
        return cls(centre_enu_m=(0.0, 0.0, height_m), radius_m=size_m, period_s=period_s, ramp_s=8.0)


KIND = CircleReference
