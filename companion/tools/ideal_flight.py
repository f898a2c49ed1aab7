"""A flight of five ideal vehicles (double integrators) in a line. The first leads, and neighbours in the line hear each other.

A world that is moved or turned as a whole must give the same flight, moved or turned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import cos, hypot, sin
from random import Random

from companion.core.consensus.law import FlownLaw, formation_state
from companion.laws import FormationState, Law, Neighbour, Values
from companion.types.autopilot import VehicleState
from companion.types.formation import FlownSlot
from companion.types.values import ZERO3, Vector3

STEP_S, FLIGHT_S = 0.02, 20.0
REACHED_M_S2 = 8.0  # of the ideal vehicles


@dataclass(frozen=True, slots=True)
class Placed:
    """Where a world is: turned about the vertical, then moved."""

    shift_enu_m: Vector3 = ZERO3
    angle_rad: float = 0.0

    def turned(self, vector: Vector3) -> Vector3:
        """The vector in that world."""
        x, y, z = vector
        c, s = cos(self.angle_rad), sin(self.angle_rad)
        return (c * x - s * y, s * x + c * y, z)

    def place(self, position_enu_m: Vector3) -> Vector3:
        """The position in that world."""
        x, y, z = self.turned(position_enu_m)
        dx, dy, dz = self.shift_enu_m
        return (x + dx, y + dy, z + dz)


@dataclass(slots=True)
class IdealVehicle:
    """A double integrator that flies the law."""

    law: FlownLaw
    slot: FlownSlot
    position_enu_m: Vector3
    velocity_enu_m_s: Vector3 = ZERO3
    commanded_enu_m_s2: Vector3 = ZERO3
    values: Values = field(default=())

    def seen(self, prc: int) -> Neighbour:
        """As a neighbour knows it."""
        own = formation_state(self.position_enu_m, self.velocity_enu_m_s, self.slot, self.commanded_enu_m_s2)
        vectors = own.position_enu_m, own.velocity_enu_m_s, own.acceleration_enu_m_s2
        return Neighbour(*vectors, prc, self.slot.position_enu_m, STEP_S, self.values)

    def step(self, wanted_enu_m_s2: Vector3) -> None:
        """The next position, with the acceleration cut to what a vehicle reaches."""
        share = min(1.0, REACHED_M_S2 / max(hypot(*wanted_enu_m_s2), 1e-9))
        ax, ay, az = self.commanded_enu_m_s2 = tuple(axis * share for axis in wanted_enu_m_s2)  # type: ignore[assignment]
        (x, y, z), (vx, vy, vz) = self.position_enu_m, self.velocity_enu_m_s
        vx, vy, vz = self.velocity_enu_m_s = (vx + ax * STEP_S, vy + ay * STEP_S, vz + az * STEP_S)
        self.position_enu_m = (x + vx * STEP_S, y + vy * STEP_S, z + vz * STEP_S)


def fly_ideal_line(law: Law, placed: Placed) -> list[list[tuple[Vector3, Vector3]]]:
    """Positions and slots of five vehicles at each step, (x, y, z) in ENU, in the world that is placed so."""
    random = Random(4)
    vehicles = []
    for i in range(5):
        slot = placed.turned((-2.0 * i, 0.5 * i, 0.0))
        start = (-2.0 * i + random.uniform(-1, 1), 0.5 * i + random.uniform(-1, 1), 10.0 + random.uniform(-1, 1))
        vehicles.append(
            IdealVehicle(FlownLaw(law, 0.0), FlownSlot(slot), placed.place(start), values=(ZERO3,) * law.publishes)
        )
    flight = []
    for step in range(int(FLIGHT_S / STEP_S)):
        now_s = step * STEP_S
        rx, ry, rz = placed.place((0.5 * now_s, 0.0, 10.0))
        reference = FormationState((rx, ry, rz), placed.turned((0.5, 0.0, 0.0)))
        _step_line(vehicles, reference, now_s)
        slots = [vehicle.slot.position_enu_m for vehicle in vehicles]
        flight.append(
            [
                (vehicle.position_enu_m, (rx + dx, ry + dy, rz + dz))
                for vehicle, (dx, dy, dz) in zip(vehicles, slots, strict=True)
            ]
        )
    return flight


def _step_line(vehicles: Sequence[IdealVehicle], reference: FormationState, now_s: float) -> None:
    seen = [vehicle.seen(prc) for prc, vehicle in enumerate(vehicles, start=1)]
    wanted = []
    for i, vehicle in enumerate(vehicles):
        state = VehicleState(vehicle.position_enu_m, vehicle.velocity_enu_m_s, position_time_s=now_s)
        neighbours = [*seen[max(0, i - 1) : i], *seen[i + 1 : i + 2]]
        given = (state, vehicle.slot, vehicle.commanded_enu_m_s2, neighbours, reference if i == 0 else None)
        wanted.append((vehicle.law.acceleration(*given), vehicle.law.values(*given)))
    for vehicle, (wanted_enu_m_s2, values) in zip(vehicles, wanted, strict=True):
        vehicle.step(wanted_enu_m_s2)
        vehicle.values = values
