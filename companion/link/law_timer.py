"""How long the calls of a law take, measured around it: the core has no clock."""

from __future__ import annotations

import time
from collections.abc import Sequence

from companion.laws import FormationState, Law, Memory, Neighbour, Own, Values
from companion.types.values import Vector3


class LawTimer(Law, frozen=True):
    """The law, with the time that its calls took since `read_s`. What counts is the clock: a law may also wait."""

    law: Law
    taken_s: list[float]

    @property
    def memory(self) -> int:  # type: ignore[override]
        """Of the law."""
        return self.law.memory

    @property
    def publishes(self) -> int:  # type: ignore[override]
        """Of the law."""
        return self.law.publishes

    def read_s(self) -> float:
        """The time since the last reading, seconds, to 0.1 ms."""
        taken_s = round(sum(self.taken_s), 4)
        self.taken_s.clear()
        return taken_s

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        """Of the law."""
        began_s = time.monotonic()
        try:
            return self.law.acceleration(own, neighbours, reference)
        finally:
            self.taken_s.append(time.monotonic() - began_s)

    def remember(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Memory:
        """Of the law."""
        began_s = time.monotonic()
        try:
            return self.law.remember(own, neighbours, reference)
        finally:
            self.taken_s.append(time.monotonic() - began_s)

    def publish(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Values:
        """Of the law."""
        began_s = time.monotonic()
        try:
            return self.law.publish(own, neighbours, reference)
        finally:
            self.taken_s.append(time.monotonic() - began_s)

    def weights(self, leads: bool, prcs: Sequence[int]) -> tuple[float, ...]:
        """Of the law; after the setpoint, so it is not measured."""
        return self.law.weights(leads, prcs)
