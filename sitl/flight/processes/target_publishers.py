"""The moving targets of a scenario, published over Zenoh."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack

from companion.ground.publishers import TargetPublisher
from companion.types.values import Vector3
from sitl.flight.moving_targets import MovingTargets
from sitl.flight.scenario import Scenario


def publish_targets(scenario: Scenario, endpoints: Sequence[str], began_s: float, stack: ExitStack) -> MovingTargets:
    """One publisher per target, closed with `stack`."""
    publishers = {
        target.name: stack.enter_context(TargetPublisher(scenario.fleet.name, endpoints, target.name))
        for target in scenario.targets
    }

    def publish(name: str, velocity_enu_m_s: Vector3, position_enu_m: Vector3) -> None:
        publishers[name].publish(velocity_enu_m_s, position_enu_m)

    return MovingTargets(scenario.targets, publish, began_s)
