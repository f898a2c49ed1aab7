"""The `reference` of a leader's vehicle file, or of a scenario: where the RFT leads."""

from __future__ import annotations

from math import hypot, pi, radians, sqrt, tan
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from companion.config.fleet import FleetConfig
from companion.config.values import PositionM, Seconds, Section
from companion.config_file import ConfigError
from companion.curves import figure_8
from companion.types import GRAVITY_M_S2, Vector3

LAP_SAMPLES = 2000


class PointReference(Section, frozen=True, tag_field="kind", tag="point"):
    """RFT that stands still, r = point, r' = 0."""

    point_enu_m: PositionM

    @property
    def start_enu_m(self) -> Vector3:
        return self.point_enu_m

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """The box that it never leaves: lowest and highest coordinates."""
        return self.point_enu_m, self.point_enu_m


class Figure8Reference(Section, frozen=True, tag_field="kind", tag="figure_8"):
    """RFT on a level 8 along x that begins at its centre with zero speed and gets up to its pace within `ramp_s`.

    `period_s` is a lap's time at full pace.
    """

    centre_enu_m: PositionM
    width_m: Annotated[float, Meta(gt=0, le=1000, description="of the whole 8, along x")]
    height_m: Annotated[float, Meta(gt=0, le=1000, description="of the whole 8, along y")]
    period_s: Annotated[float, Meta(ge=1, le=3600)]
    ramp_s: Seconds = 5.0

    @property
    def start_enu_m(self) -> Vector3:
        return self.centre_enu_m

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """The box that it never leaves: lowest and highest coordinates."""
        (x, y, z), a, b = self.centre_enu_m, self.width_m / 2.0, self.height_m / 2.0
        return (x - a, y - b, z), (x + a, y + b, z)

    def largest_speed_m_s(self) -> float:
        """At the centre."""
        return 2.0 * pi / self.period_s * hypot(self.width_m / 2.0, self.height_m)

    def largest_acceleration_m_s2(self) -> float:
        """While it gets up to its pace and on the first full lap."""
        times_s = (index / LAP_SAMPLES * (self.ramp_s + self.period_s) for index in range(LAP_SAMPLES))
        shape = (self.width_m, self.height_m, self.period_s, self.ramp_s)
        return max(hypot(*figure_8(time_s, *shape)[2]) for time_s in times_s)


Reference = PointReference | Figure8Reference


def check_reference(file: Path, fleet: FleetConfig, reference: Reference) -> None:
    """Every vehicle's place r + d_i0 lies inside the fence all along, and the fleet can fly it. Raises ConfigError."""
    envelope = fleet.envelope
    lowest, highest = reference.corners_enu_m()
    field = "centre_enu_m" if isinstance(reference, Figure8Reference) else "point_enu_m"
    for member in fleet.vehicles:
        for axis, least, most, d, low, high in zip(
            "xyz",
            lowest,
            highest,
            member.slot_enu_m,
            envelope.fence_min_enu_m,
            envelope.fence_max_enu_m,
            strict=True,
        ):
            for r in (least, most):
                if not low <= r + d <= high:
                    raise ConfigError(
                        file,
                        f"reference.{field}",
                        f"puts vehicle {member.id} at {axis} = {r + d:g} m, outside the fence ({low:g} to {high:g})",
                    )
    if isinstance(reference, Figure8Reference):
        _check_pace(file, fleet, reference)


def _check_pace(file: Path, fleet: FleetConfig, reference: Figure8Reference) -> None:
    """An 8 that is too fast cannot be flown, or its flyers are not believed."""
    most_m_s2 = GRAVITY_M_S2 * tan(radians(fleet.envelope.max_tilt_deg))
    slower = sqrt(reference.largest_acceleration_m_s2() / most_m_s2)
    if slower > 1.0:
        raise ConfigError(
            file,
            "reference.period_s",
            f"{reference.period_s:g} s with ramp_s {reference.ramp_s:g} asks for"
            f" {reference.largest_acceleration_m_s2():.1f} m/s^2, envelope.max_tilt_deg {fleet.envelope.max_tilt_deg:g} gives"
            f" {most_m_s2:.1f}; expected at least {reference.period_s * slower + 0.05:.1f} s with ramp_s"
            f" {reference.ramp_s * slower + 0.05:.1f}, or a smaller figure",
        )
    speed_m_s, believed_m_s = reference.largest_speed_m_s(), fleet.peers.max_speed_m_s
    if speed_m_s > believed_m_s:
        raise ConfigError(
            file,
            "reference.period_s",
            f"{reference.period_s:g} s asks for {speed_m_s:.1f} m/s, peers.max_speed_m_s believes {believed_m_s:g};"
            f" expected at least {reference.period_s * speed_m_s / believed_m_s + 0.05:.1f} s, or a smaller figure",
        )
