"""Axes of a motion-capture system and those of the fleet frame (ENU, bodies FLU)."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin
from typing import Literal

from companion.geometry.frames import Quaternion
from companion.geometry.vectors import dot, plus, scaled
from companion.types.values import Vector3

UpAxis = Literal["y", "z"]
CaptureAxis = Literal["x", "-x", "y", "-y", "z", "-z"]
UNIT: dict[str, Vector3] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
UNIT |= {f"-{name}": scaled(axis, -1.0) for name, axis in UNIT.items()}


def cross(a: Vector3, b: Vector3) -> Vector3:
    """Vector product of a and b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@dataclass(frozen=True, slots=True)
class CaptureAxes:
    """Which axes of the capture frame point forward, left and up, for the room and for each body; all right-handed.

    Forward is `turn_rad` to the left of east. Of a body it is its nose.
    """

    forward: Vector3
    left: Vector3
    up: Vector3
    turn_rad: float

    @classmethod
    def of(cls, up: UpAxis, forward: CaptureAxis, turn_deg: float = 0.0) -> CaptureAxes:
        """By the names of the axes, which differ."""
        return cls(UNIT[forward], cross(UNIT[up], UNIT[forward]), UNIT[up], radians(turn_deg))

    def to_fleet(self, position: Vector3, quaternion: Quaternion) -> tuple[Vector3, Quaternion]:
        """A position in ENU, and the quaternion (w, x, y, z) that turns the FLU body into ENU."""
        w, *axis = quaternion
        turned = _yawed_quaternion((w, *self._flu((axis[0], axis[1], axis[2]))), self.turn_rad)
        return _yawed(self._flu(position), self.turn_rad), turned

    def to_capture(self, position_enu_m: Vector3, quaternion: Quaternion) -> tuple[Vector3, Quaternion]:
        """The inverse of `to_fleet`."""
        w, x, y, z = _yawed_quaternion(quaternion, -self.turn_rad)
        return self._from_flu(_yawed(position_enu_m, -self.turn_rad)), (w, *self._from_flu((x, y, z)))

    def _flu(self, vector: Vector3) -> Vector3:
        return (dot(self.forward, vector), dot(self.left, vector), dot(self.up, vector))

    def _from_flu(self, vector: Vector3) -> Vector3:
        along, across, up = vector
        return plus(plus(scaled(self.forward, along), scaled(self.left, across)), scaled(self.up, up))


def _yawed(vector: Vector3, angle_rad: float) -> Vector3:
    x, y, z = vector
    c, s = cos(angle_rad), sin(angle_rad)
    return (c * x - s * y, s * x + c * y, z)


def _yawed_quaternion(quaternion: Quaternion, angle_rad: float) -> Quaternion:
    w, x, y, z = quaternion
    c, s = cos(0.5 * angle_rad), sin(0.5 * angle_rad)
    return (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)
