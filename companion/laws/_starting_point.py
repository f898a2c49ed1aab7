"""A law of your own: what it is for, and where its equation comes from.

Every vehicle asks its own copy 50 times a second, at each new position. `companion law check FILE` tries it.
"""

from __future__ import annotations

from collections.abc import Sequence

from companion.laws import FormationState, Gain, Law, Neighbour, Own
from companion.types.values import Vector3


class StartingPoint(Law, frozen=True):
    """u_i = -k1 e_i - k2 e'_i, e_i = the mean of x_i - x_j over the neighbours j; a leader follows its reference.

    position_gain_1_s2: k1, on the position error
    velocity_gain_1_s: k2, on the velocity error
    """

    # Parameters: type with bounds, default. A fleet file sets them under law.parameters. `Gain` is above 0, up to 10;
    # others: Annotated[float, Meta(ge=0, le=1)], with typing.Annotated and msgspec.Meta.
    position_gain_1_s2: Gain = 2.0
    velocity_gain_1_s: Gain = 2.4

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        """The wanted acceleration u_i, (x, y, z) in ENU, m/s^2.

        Positions are relative to slots: in perfect formation all of them are equal. Use differences of them, and the law
        works wherever the formation is. `reference` is that of a leader, None for a follower. A follower may have no
        neighbours; a neighbour may be at the same place as this vehicle.
        """
        followed = [reference] if reference is not None else list(neighbours)
        wanted = [0.0, 0.0, 0.0]
        for other in followed:
            for axis in range(3):
                error_m = own.position_enu_m[axis] - other.position_enu_m[axis]
                error_m_s = own.velocity_enu_m_s[axis] - other.velocity_enu_m_s[axis]
                wanted[axis] -= (self.position_gain_1_s2 * error_m + self.velocity_gain_1_s * error_m_s) / len(followed)
        x, y, z = wanted
        return (x, y, z)
