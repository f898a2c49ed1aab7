"""Parts that the scenarios of `sitl study` and `sitl switching` share."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from companion.config.fleet import Envelope, FormationMember, GeodeticOrigin
from companion.types.flight import Role
from companion.types.values import Vector3
from sitl.study.shapes import LEADER

ORIGIN = GeodeticOrigin(latitude_deg=47.397742, longitude_deg=8.545594, altitude_amsl_m=488.0)


def members_of(slots_enu_m: Mapping[int, Vector3], leaders: Collection[int] = (LEADER,)) -> tuple[FormationMember, ...]:
    """Members in rising order of their ids."""
    return tuple(
        FormationMember(id=i, role=Role.LEADER if i in leaders else Role.FOLLOWER, slot_enu_m=slots_enu_m[i])
        for i in sorted(slots_enu_m)
    )


def wide_fence(distance_m: float) -> Envelope:
    """Default limits with a fence at this distance from the origin in all horizontal directions."""
    return Envelope(fence_min_enu_m=(-distance_m, -distance_m, -5.0), fence_max_enu_m=(distance_m, distance_m, 50.0))
