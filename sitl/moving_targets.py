"""What a scenario's fleet may follow: things that move along a curve and tell of it, as `companion.ground.target` would."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated

from msgspec import Meta

from companion.config.fleet import FLEET_NAME, FLEET_NAME_WORDS
from companion.config.reference import CircleReference, Figure8Reference, PointReference, WaypointsReference
from companion.config.values import Section
from companion.types import Vector3

PERIOD_S = 0.1

Tell = Callable[[str, Vector3, Vector3], None]
"""Takes a target's name, its velocity and its position."""


class MovingTarget(Section, frozen=True, kw_only=True):
    """It moves along `path` from `begins_s` of the flight on, and tells of itself from then until `ends_s`."""

    name: Annotated[str, Meta(pattern=FLEET_NAME, description=FLEET_NAME_WORDS)] = "main"
    path: PointReference | Figure8Reference | CircleReference | WaypointsReference
    begins_s: Annotated[float, Meta(ge=0, le=3600)] = 0.0
    ends_s: Annotated[float, Meta(gt=0, le=3600)] = 3600.0


class MovingTargets:
    """Lets each of them tell of itself when it is due."""

    def __init__(self, targets: Sequence[MovingTarget], tell: Tell, began_s: float) -> None:
        self._targets = [(target, target.path.curve()) for target in targets]
        self._tell = tell
        self._began_s = began_s
        self._next_s = began_s

    def go_on(self, now_s: float) -> None:
        """Call it often."""
        if now_s < self._next_s:
            return
        self._next_s = now_s + PERIOD_S
        flight_s = now_s - self._began_s
        for target, curve in self._targets:
            if target.begins_s <= flight_s <= target.ends_s:
                position, velocity, _ = curve(flight_s - target.begins_s)
                self._tell(target.name, velocity, position)
