"""What a vehicle steers to: the reference of a leader, or the weighted mean of its neighbours."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from companion.laws import FormationState, Neighbour, Own
from companion.types.values import Vector3


def followed(
    own: Own, neighbours: Sequence[Neighbour], weights: Sequence[float], reference: FormationState | None
) -> FormationState | None:
    """The reference, where there is one, with the acceleration that keeps a vehicle with drag on it; None without anything."""
    if reference is not None:
        (vx, vy, vz), (ax, ay, az), c = reference.velocity_enu_m_s, reference.acceleration_enu_m_s2, own.drag_1_s
        return FormationState(
            reference.position_enu_m, reference.velocity_enu_m_s, (ax + c * vx, ay + c * vy, az + c * vz)
        )
    if not neighbours:
        return None
    return FormationState(
        weighted_mean(weights, [neighbour.position_enu_m for neighbour in neighbours]),
        weighted_mean(weights, [neighbour.velocity_enu_m_s for neighbour in neighbours]),
        weighted_mean(weights, [neighbour.acceleration_enu_m_s2 for neighbour in neighbours]),
    )


def weighted_mean(weights: Iterable[float], vectors: Iterable[Vector3]) -> Vector3:
    """The sum of these vectors with these weights, which add up to one."""
    x = y = z = 0.0
    for weight, (vx, vy, vz) in zip(weights, vectors, strict=True):
        x, y, z = x + weight * vx, y + weight * vy, z + weight * vz
    return (x, y, z)
