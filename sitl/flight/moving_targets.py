"""Moving targets of a scenario: each moves along a curve and publishes its state, as `companion.ground.publishers` does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated

from msgspec import Meta

from companion.config.reference import CircleReference, Figure8Reference, PointReference, WaypointsReference
from companion.config.values import Name, Section
from companion.types.values import Vector3

PERIOD_S = 0.1

Publish = Callable[[str, Vector3, Vector3], None]
"""Takes a target's name, its velocity [m/s] and its position [m], ENU."""


class MovingTarget(Section, frozen=True, kw_only=True):
    """A target that moves along a curve and publishes its position and velocity, for a reference that follows it."""

    name: Annotated[Name, Meta(description="name of the target, as a reference names it")] = "main"
    path: Annotated[
        PointReference | Figure8Reference | CircleReference | WaypointsReference, Meta(description="the curve")
    ]
    begins_s: Annotated[
        float, Meta(ge=0, le=3600, description="time of the flight at which it begins to move and publish")
    ] = 0.0
    ends_s: Annotated[
        float, Meta(gt=0, le=3600, description="time of the flight after which it no longer publishes")
    ] = 3600.0


class MovingTargets:
    """Publishes the state of each target when it is due."""

    def __init__(self, targets: Sequence[MovingTarget], publish: Publish, began_s: float) -> None:
        self._targets = [(target, target.path.curve()) for target in targets]
        self._publish = publish
        self._began_s = began_s
        self._next_s = began_s

    def update(self, now_s: float) -> None:
        """Publish what is due. To be called more often than every PERIOD_S."""
        if now_s < self._next_s:
            return
        self._next_s = now_s + PERIOD_S
        flight_s = now_s - self._began_s
        for target, curve in self._targets:
            if target.begins_s <= flight_s <= target.ends_s:
                position, velocity, _ = curve(flight_s - target.begins_s)
                self._publish(target.name, velocity, position)
