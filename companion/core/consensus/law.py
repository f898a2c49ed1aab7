"""Formation law: eq. 14 with the weights of Algorithm 2, the two average laws of the paper and the cooperative law.

PrC and weights (Algorithms 1 and 2) are here too, and the RFT that a vehicle publishes which is kept off its slot.
All laws are one formula with different data: gains, weighting of the neighbours, whether a leader uses its neighbours, and
the share of the neighbours' acceleration that is fed forward.
With d_ij = d_i0 - d_j0 every relative error of the paper is a difference of two formation states:
x_i - x_j - d_ij = (x_i - d_i0) - (x_j - d_j0).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import dist, inf

from msgspec import Struct

from companion.types.formation import FlownSlot
from companion.types.values import ZERO3, Vector3


@dataclass(frozen=True, slots=True)
class Gains:
    """K = [k1, k2]: k1 on position [1/s^2], k2 on velocity [1/s]."""

    position_1_s2: float
    velocity_1_s: float


PAPER_GAINS = Gains(1.39, 1.2)  # K of section 5.1.1


@dataclass(frozen=True, slots=True)
class FormationLaw:
    """Parameters of a law.

    Where `leader_uses_neighbours` is False a leader tracks the RFT alone.
    `feedforward` is g: a follower adds g sum_j w_ij u_j, its neighbours' last acceleration commands with the same weights,
    and a leader adds g (r'' + c r'), with its drag c; u_j contains what vehicle j does against its own. Followers may be
    neighbours of each other, so the sum feeds back; g < 1 keeps it finite.
    """

    gains: Gains
    weighting: Weighting
    leader_uses_neighbours: bool
    feedforward: float = 0.0


def used_weights(law: FormationLaw, leads: bool, prcs: Sequence[int]) -> tuple[float, ...]:
    """w_ij of the neighbours with these PrCs, in their order; empty for a leader under a law that does not use them."""
    return neighbour_weights(prcs, law.weighting) if law.leader_uses_neighbours or not leads else ()


def weighted(gains: Gains = PAPER_GAINS, exponent: float = 1.0) -> FormationLaw:
    """Eq. 14 with Algorithms 1 and 2: the paper's law at exponent 1."""
    return FormationLaw(gains, Weighting(exponent), leader_uses_neighbours=True)


def average_22(gains: Gains = PAPER_GAINS) -> FormationLaw:
    """Eq. 22: equal weights for all neighbours, leaders coupled to theirs too."""
    return FormationLaw(gains, Weighting(0.0), leader_uses_neighbours=True)


def average_26(gains: Gains = PAPER_GAINS) -> FormationLaw:
    """Eq. 26: followers average their neighbours, leaders track the reference alone."""
    return FormationLaw(gains, Weighting(0.0), leader_uses_neighbours=False)


def cooperative() -> FormationLaw:
    """Extension of the paper that settles long chains fast, with attitude lag, noise, delay and packet loss.

    Weights that fall to a thirtieth with every hop: no vehicle follows its own followers, however deep it is. Gains with 0.85
    of critical damping at lambda = 1, where the paper's have 0.51. And nearly all of the neighbours' acceleration fed forward;
    `sitl study` has the comparison that ratio and share are chosen by. A larger k2 for the same k1 costs twice: a velocity
    error e shifts a vehicle by k2/k1 e, and with slow attitude loops and late packets the leader and its followers begin to
    oscillate.
    """
    return FormationLaw(Gains(2.0, 2.4), Weighting(0.0, 0.03), leader_uses_neighbours=True, feedforward=0.98)


class FormationState(Struct, frozen=True, gc=False):
    """State of a vehicle minus that of its slot: x - d_i0, velocity and last commanded acceleration.

    In perfect formation the formation states of all vehicles equal R of the RFT.
    """

    position_enu_m: Vector3
    velocity_enu_m_s: Vector3
    acceleration_enu_m_s2: Vector3 = ZERO3


def formation_state(
    position_enu_m: Vector3,
    velocity_enu_m_s: Vector3,
    slot: FlownSlot,
    acceleration_enu_m_s2: Vector3 = ZERO3,
) -> FormationState:
    """State of a vehicle minus that of its slot, ENU."""
    (x, y, z), (vx, vy, vz) = position_enu_m, velocity_enu_m_s
    (ax, ay, az), (dax, day, daz) = acceleration_enu_m_s2, slot.acceleration_enu_m_s2
    (dx, dy, dz), (dvx, dvy, dvz) = slot.position_enu_m, slot.velocity_enu_m_s
    return FormationState((x - dx, y - dy, z - dz), (vx - dvx, vy - dvy, vz - dvz), (ax - dax, ay - day, az - daz))


def target(
    law: FormationLaw, neighbours: Sequence[tuple[int, FormationState]], reference: FormationState | None
) -> FormationState | None:
    """The RFT that the law steers to: R of a leader, of a follower the weighted mean of its neighbours; None without any."""
    if reference is not None or not neighbours:
        return reference
    weights = neighbour_weights([prc for prc, _ in neighbours], law.weighting)
    states = [(s.position_enu_m, s.velocity_enu_m_s, s.acceleration_enu_m_s2) for _, s in neighbours]
    means = [
        tuple([sum(w * vector[axis] for w, vector in zip(weights, vectors, strict=True)) for axis in range(3)])
        for vectors in zip(*states, strict=True)
    ]
    return FormationState(*means)


def formation_acceleration(
    law: FormationLaw,
    own: FormationState,
    neighbours: Sequence[tuple[int, FormationState]],
    reference: FormationState | None,
    drag_1_s: float = 0.0,
) -> Vector3:
    """u_i of eq. 14 plus feed-forward, m/s^2 in ENU on all three axes. Zero for a follower without neighbours.

    `neighbours` are (PrC, formation state); `reference` is R = [r, r'] for a leader, None for a follower.
    `drag_1_s` is the deceleration by drag per m/s of this vehicle.
    """
    used = _used(law, neighbours, reference is not None)
    position_error, velocity_error = _error(own, used, reference)
    fed_back = feedback(law.gains, position_error, velocity_error)
    if law.feedforward == 0.0:
        return fed_back
    ax, ay, az = _mean_acceleration(used) if reference is None else _along(reference, drag_1_s)
    x, y, z = fed_back
    return (x + law.feedforward * ax, y + law.feedforward * ay, z + law.feedforward * az)


Weighted = Sequence[tuple[float, FormationState]]
"""(w_ij, formation state) of each neighbour that counts."""


def _used(law: FormationLaw, neighbours: Sequence[tuple[int, FormationState]], leads: bool) -> Weighted:
    if leads and not law.leader_uses_neighbours:
        return ()
    weights = neighbour_weights([prc for prc, _ in neighbours], law.weighting)
    return [(weight, state) for weight, (_, state) in zip(weights, neighbours, strict=True)]


def _error(own: FormationState, used: Weighted, reference: FormationState | None) -> tuple[Vector3, Vector3]:
    """z_i of eq. 11 without the offsets, as (position error m, velocity error m/s): w_ij is 1 for the reference."""
    (x, y, z), (vx, vy, vz) = own.position_enu_m, own.velocity_enu_m_s
    ex = ey = ez = evx = evy = evz = 0.0
    for weight, target in used:
        (tx, ty, tz), (tvx, tvy, tvz) = target.position_enu_m, target.velocity_enu_m_s
        ex, ey, ez = ex + weight * (x - tx), ey + weight * (y - ty), ez + weight * (z - tz)
        evx, evy, evz = evx + weight * (vx - tvx), evy + weight * (vy - tvy), evz + weight * (vz - tvz)
    if reference is not None:
        (rx, ry, rz), (rvx, rvy, rvz) = reference.position_enu_m, reference.velocity_enu_m_s
        ex, ey, ez = ex + (x - rx), ey + (y - ry), ez + (z - rz)
        evx, evy, evz = evx + (vx - rvx), evy + (vy - rvy), evz + (vz - rvz)
    return (ex, ey, ez), (evx, evy, evz)


def _along(reference: FormationState, drag_1_s: float) -> Vector3:
    """r'' + c r': what keeps a vehicle with drag on the reference."""
    (vx, vy, vz), (ax, ay, az) = reference.velocity_enu_m_s, reference.acceleration_enu_m_s2
    return (ax + drag_1_s * vx, ay + drag_1_s * vy, az + drag_1_s * vz)


def _mean_acceleration(used: Weighted) -> Vector3:
    """sum_j w_ij u_j."""
    x = y = z = 0.0
    for weight, target in used:
        ax, ay, az = target.acceleration_enu_m_s2
        x, y, z = x + weight * ax, y + weight * ay, z + weight * az
    return (x, y, z)


def feedback(gains: Gains, position_error_m: Vector3, velocity_error_m_s: Vector3) -> Vector3:
    """-K [position error, velocity error]."""
    k1, k2 = gains.position_1_s2, gains.velocity_1_s
    px, py, pz = position_error_m
    vx, vy, vz = velocity_error_m_s
    return (-k1 * px - k2 * vx, -k1 * py - k2 * vy, -k1 * pz - k2 * vz)


@dataclass(frozen=True, slots=True)
class Weighting:
    """How the share of a neighbour falls with its PrC p: as ratio^p / p^exponent.

    Exponent 1 and ratio 1 is the paper's Algorithm 2, exponent 0 and ratio 1 the average of eq. 22. A power is sharp between
    the first hops and nearly flat behind twenty: a vehicle there would follow its own followers. A ratio rho < 1 (0 < rho) is
    as sharp at every hop: of two neighbours at p - 1 and p + 1 the second has rho^2 times the weight of the first.
    """

    exponent: float = 1.0
    ratio: float = 1.0


def neighbour_weights(prcs: Sequence[int], weighting: Weighting) -> tuple[float, ...]:
    """w_ij = s_j / sum_j s_j with the shares s_j of neighbours with PrCs p_j >= 1, in their order.

    The weights add up to one. There are none without neighbours, where the paper's algorithm would divide by zero.
    """
    return _weights(tuple(prcs), weighting.exponent, weighting.ratio)


@lru_cache(maxsize=256)  # PrCs change seldom, and every tick needs their weights
def _weights(prcs: tuple[int, ...], exponent: float, ratio: float) -> tuple[float, ...]:
    # rho^p of the 160th hop is below the smallest float, so hops are counted from the nearest neighbour.
    least = min(prcs, default=1)
    shares = [prc**-exponent * ratio ** (prc - least) for prc in prcs]
    total = sum(shares)
    return tuple([share / total for share in shares])


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


INTERVENES_M_S2 = 0.3  # a smaller intervention comes and goes with noise
LASTS_S = 3.0  # the vehicle counts as kept off for this time after the last intervention
BACK_WITHIN_M = 0.1  # this near to its slot, a vehicle publishes its own position again
# So does it where the vehicle comes no nearer: on an RFT that moves, the law itself may lag more than that.
NEARER_M, NEARER_WITHIN_S = 0.02, 1.0


class KeptOff:
    """Whether the separation filter keeps this vehicle off its slot, and the RFT that it publishes in place of its own offset.

    The law compares positions minus slots. A vehicle that makes way for another one is off its slot for seconds, and its peers
    would follow it: it would pull the whole formation aside, vehicles that wait for each other would not come apart, and they
    would reach their slots late or never. So it publishes the RFT that the law gives it, as if it were in its slot.
    """

    def __init__(self) -> None:
        self._intervened_s = -inf
        self.is_kept_off = False
        self._nearest_m, self._nearer_s = (
            inf,
            -inf,
        )  # least distance from the slot on the way back, and when it was reached

    def intervened(self, now_s: float, taken_m_s2: float) -> bool:
        """Whether it is, or was and is not back yet. `taken_m_s2`: of the acceleration that the law wants, by vehicles."""
        if taken_m_s2 > INTERVENES_M_S2:
            self._intervened_s, self.is_kept_off, self._nearest_m = now_s, True, inf
        return self.is_kept_off

    def rft(self, now_s: float, own: FormationState, target: FormationState) -> FormationState | None:
        """The RFT to publish: that of the law. None from when this vehicle is back in its slot, or as near as it comes."""
        if now_s - self._intervened_s <= LASTS_S:
            return target
        off_m = dist(own.position_enu_m, target.position_enu_m)
        if off_m < self._nearest_m - NEARER_M:
            self._nearest_m, self._nearer_s = off_m, now_s
        if off_m < BACK_WITHIN_M or now_s - self._nearer_s > NEARER_WITHIN_S:
            self.is_kept_off = False
            return None
        return target

    def end(self) -> None:
        """Outside formation."""
        self._intervened_s, self.is_kept_off = -inf, False
