"""A figure 8."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil, tau
from typing import ClassVar, Self

from msgspec.structs import replace

from companion.config.reference.base import (
    CRUISE_M_S,
    LAP_SAMPLES,
    PERIOD,
    RAMP,
    Asked,
    LappingReference,
    Size,
    box_about,
)
from companion.config.values import PositionM
from companion.geometry.curves import Curve, Harmonic, centred_at, figure_8
from companion.types.values import Vector3


class Figure8Reference(LappingReference, frozen=True, tag_field="kind", tag="figure_8"):
    """A level figure 8 along x, from rest at its centre.

    centre_enu_m: centre of the 8, where it starts
    width_m: size of the whole 8 along x
    height_m: size of the whole 8 along y
    """

    TITLE, POSITION, LAP_SAMPLES = "Figure 8", "centre_enu_m", LAP_SAMPLES // 2
    ASKED: ClassVar[Mapping[str, Asked]] = {
        "width_m": Asked("--width", "of a whole figure 8, along x, metres", "Width, east", 16.0),
        "height_m": Asked("--height", "of a whole figure 8, along y, metres", "Height, north", 8.0),
        "period_s": PERIOD,
        "ramp_s": RAMP,
    }

    centre_enu_m: PositionM
    width_m: Size
    height_m: Size

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        return box_about(self.centre_enu_m, self.width_m / 2.0, self.height_m / 2.0)

    def curve(self) -> Curve:
        shape = (self.width_m, self.height_m, self.period_s, self.ramp_s)
        return centred_at(self.centre_enu_m, lambda time_s: figure_8(time_s, *shape))

    def motions(self, slots_turn: bool) -> list[list[Harmonic]]:
        rate_rad_s, a_m, b_m = tau / self.period_s, self.width_m / 2.0, self.height_m / 2.0
        if slots_turn:
            return [
                [
                    Harmonic(rate_rad_s, (a_m, a_m, 0.0), rotates=True),
                    Harmonic(2.0 * rate_rad_s, (b_m, b_m, 0.0), rotates=True),
                ]
            ]
        return [[Harmonic(rate_rad_s, (a_m, 0.0, 0.0)), Harmonic(2.0 * rate_rad_s, (0.0, b_m, 0.0))]]

    @classmethod
    def first(cls, size_m: float, height_m: float) -> Self:
        eight = cls(
            centre_enu_m=(0.0, 0.0, height_m), width_m=2.0 * size_m, height_m=size_m, period_s=100.0, ramp_s=8.0
        )
        return replace(eight, period_s=float(ceil(100.0 * eight.largest_pace()[0] / CRUISE_M_S)))


KIND = Figure8Reference
