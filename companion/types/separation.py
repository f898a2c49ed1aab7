"""What the separation filter reports: the vehicle that is nearest to its required distance, and the change of the command."""

from __future__ import annotations

from msgspec import Struct

from companion.types.bounds import Finite, Word


class NearestVehicle(Struct, frozen=True, gc=False):
    """The vehicle with the least room above its required distance, at present. Distances are of `geometry/separation.py`.

    `name` is its id in the fleet, or the name of the traffic. `required_m` is `separation_m` with all margins.
    """

    name: Word
    distance_m: Finite
    required_m: Finite


class SeparationReport(Struct, frozen=True, gc=False):
    """What the separation filter sees and does. `changed_m_s2` is the change of the commanded acceleration, 0 without one.

    `violated`: a vehicle is nearer than `separation_m`, by the own position and its last packet. It may be another one than
    `nearest`, whose required distance may be larger.
    """

    nearest: NearestVehicle | None = None
    changed_m_s2: Finite = 0.0
    violated: bool = False
