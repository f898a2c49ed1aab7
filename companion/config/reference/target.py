"""A moving target that is followed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar

from msgspec import Meta

from companion.config.reference.base import ACCELERATION, SPEED, Asked, LimitedReference, Speed, any_motions
from companion.config.values import Name, PositionM
from companion.geometry.curves import Harmonic
from companion.types.values import ZERO3


class TargetReference(LimitedReference, frozen=True, tag_field="kind", tag="target"):
    """Follows a moving target, which publishes on formation/FLEET/target/NAME. It stays inside the fence by itself.

    start_enu_m: start, where it waits for the first message of the target
    name: name of the target, NAME of its key
    offset_enu_m: offset of the RFT from the target
    follows_altitude: `true`: z follows the target; `false`: z stays that of the start
    max_age_s: without a newer message for this time the RFT comes to rest
    """

    TITLE, POSITION, PLACE, AWAITED = "Follow a target", "start_enu_m", "start", True
    ASKED: ClassVar[Mapping[str, Asked]] = {
        "max_speed_m_s": SPEED,
        "max_acceleration_m_s2": ACCELERATION,
        "name": Asked("--name", "of the target (default main)", "Target"),
        "offset_enu_m": Asked("--offset", "from the target to the reference, metres"),
        "follows_altitude": Asked("--follows-altitude", "follow the altitude of the target as well"),
    }

    start_enu_m: PositionM
    name: Name = "main"
    offset_enu_m: PositionM = ZERO3
    follows_altitude: bool = False
    max_speed_m_s: Speed = 3.0
    max_age_s: Annotated[float, Meta(gt=0.05, le=10)] = 1.0

    def motions(self, slots_turn: bool) -> list[list[Harmonic]]:
        """It may move at any rate within its limits, in any direction."""
        del slots_turn
        return any_motions(*self.limits, up=1.0 if self.follows_altitude else 0.0)


KIND = TargetReference
