"""The law in flight: what it is asked at each position, and what it remembers. PrC (Algorithm 1) is here too.

With d_ij = d_i0 - d_j0 every relative error of the paper is a difference of two formation states:
x_i - x_j - d_ij = (x_i - d_i0) - (x_j - d_j0).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import inf, isfinite

from msgspec.structs import asdict, replace

from companion.laws import FormationState, Law, Memory, Neighbour, Own, Values
from companion.laws._trial import MOST_M_S2
from companion.types.autopilot import VehicleState
from companion.types.errors import CompanionError
from companion.types.formation import FlownSlot, Gains
from companion.types.values import MAX_COORDINATE_M, ZERO3, Vector3

STEP_S = 0.02  # of the first position in formation
SHORTEST_STEP_S, LONGEST_STEP_S = 0.001, 0.5


class LawError(CompanionError):
    """The law raised an exception, or gave something that cannot be flown. The agent ends by a hand-over, as by a defect."""


class FlownLaw:
    """The law of one vehicle, with its memory. `drag_1_s` is the deceleration by drag per m/s of this vehicle."""

    def __init__(self, law: Law, drag_1_s: float) -> None:
        self.law = law
        self._drag_1_s = drag_1_s
        self._nothing: Memory = (ZERO3,) * law.memory
        self._memory = self._nothing
        self._asked_s: float | None = None  # time of the position that it was last asked about

    def acceleration(
        self,
        vehicle: VehicleState,
        slot: FlownSlot,
        commanded_enu_m_s2: Vector3,
        neighbours: Sequence[Neighbour],
        reference: FormationState | None,
    ) -> Vector3:
        """u_i at a new position in formation, m/s^2 in ENU, relative to the slot's own motion. Raises LawError."""
        own = self._own(vehicle, slot, commanded_enu_m_s2)
        try:
            x, y, z = self.law.acceleration(own, neighbours, reference)
            # False for NaN
            flyable = -MOST_M_S2 < x < MOST_M_S2 and -MOST_M_S2 < y < MOST_M_S2 and -MOST_M_S2 < z < MOST_M_S2
            memory = self.law.remember(own, neighbours, reference) if self._nothing else ()
        except Exception as error:  # the law may be the code of a user
            raise LawError(f"the law raises {type(error).__name__}: {error}") from error
        if not flyable:
            raise LawError(f"the law gives an acceleration of {(x, y, z)} m/s^2; expected numbers up to {MOST_M_S2:g}")
        self._asked_s = vehicle.position_time_s
        if self._nothing:
            self._memory = finite_vectors(memory, self.law.memory, inf, "remembers")
        return (x, y, z)

    def values(
        self,
        vehicle: VehicleState,
        slot: FlownSlot,
        commanded_enu_m_s2: Vector3,
        neighbours: Sequence[Neighbour],
        reference: FormationState | None,
        rft: FormationState | None = None,
    ) -> Values:
        """What the law publishes, of a vehicle that is kept off its slot as if it flew by `rft`. Raises LawError."""
        if not self.law.publishes:
            return ()
        own = self._own(vehicle, slot, commanded_enu_m_s2)
        if rft is not None:
            own = replace(own, **asdict(rft))
        try:
            values = self.law.publish(own, neighbours, reference)
        except Exception as error:  # as above
            raise LawError(f"the law raises {type(error).__name__}: {error}") from error
        return finite_vectors(values, self.law.publishes, MAX_COORDINATE_M, "publishes")

    def end(self) -> None:
        """Outside formation: forget."""
        self._memory, self._asked_s = self._nothing, None

    def _own(self, vehicle: VehicleState, slot: FlownSlot, commanded_enu_m_s2: Vector3) -> Own:
        (x, y, z), (vx, vy, vz) = vehicle.position_enu_m, vehicle.velocity_enu_m_s
        (dx, dy, dz), (dvx, dvy, dvz) = slot.position_enu_m, slot.velocity_enu_m_s
        (ax, ay, az), (dax, day, daz) = commanded_enu_m_s2, slot.acceleration_enu_m_s2
        step_s = STEP_S if self._asked_s is None else vehicle.position_time_s - self._asked_s
        return Own(
            (x - dx, y - dy, z - dz),
            (vx - dvx, vy - dvy, vz - dvz),
            (ax - dax, ay - day, az - daz),
            slot.position_enu_m,
            self._drag_1_s,
            min(max(step_s, SHORTEST_STEP_S), LONGEST_STEP_S),
            self._memory,
        )


def formation_state(
    position_enu_m: Vector3, velocity_enu_m_s: Vector3, slot: FlownSlot, acceleration_enu_m_s2: Vector3 = ZERO3
) -> FormationState:
    """State of a vehicle minus that of its slot, ENU."""
    (x, y, z), (vx, vy, vz) = position_enu_m, velocity_enu_m_s
    (ax, ay, az), (dax, day, daz) = acceleration_enu_m_s2, slot.acceleration_enu_m_s2
    (dx, dy, dz), (dvx, dvy, dvz) = slot.position_enu_m, slot.velocity_enu_m_s
    return FormationState((x - dx, y - dy, z - dz), (vx - dvx, vy - dvy, vz - dvz), (ax - dax, ay - day, az - daz))


def feedback(gains: Gains, position_error_m: Vector3, velocity_error_m_s: Vector3) -> Vector3:
    """-K [position error, velocity error]."""
    k1, k2 = gains.position_1_s2, gains.velocity_1_s
    px, py, pz = position_error_m
    vx, vy, vz = velocity_error_m_s
    return (-k1 * px - k2 * vx, -k1 * py - k2 * vy, -k1 * pz - k2 * vz)


def next_prc(is_leader: bool, neighbour_prcs: Iterable[int], n: int) -> int:
    """p_i(k+1) of Algorithm 1 (line 3 corrected: per[j] = p_j(k)).

    `n` is the number of vehicles; a follower without neighbours gets n, a leader 1.
    """
    if is_leader:
        return 1
    least = n - 1
    for prc in neighbour_prcs:
        if prc < least:
            least = prc
    return least + 1


def finite_vectors(vectors: Memory, count: int, most: float, verb: str) -> Memory:
    """Raises LawError where these are not as many vectors of finite numbers up to `most`, beyond which peers refuse them."""
    try:
        if len(vectors) == count and all(
            isfinite(x + y + z) and -most <= min(x, y, z) <= max(x, y, z) <= most for x, y, z in vectors
        ):
            return vectors
    except (TypeError, ValueError):  # other types
        pass
    raise LawError(f"the law {verb} {vectors!r:.80}; expected {count} vectors of three finite numbers up to {most:g}")
