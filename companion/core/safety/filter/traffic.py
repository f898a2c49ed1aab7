"""Newest position of each vehicle outside the fleet. Their number is bounded: of too many, the nearest are kept."""

from __future__ import annotations

from collections.abc import Iterable
from math import dist

from companion.types.peers import ReceivedTraffic
from companion.types.values import Vector3

KEPT = 16
EXPIRES_S = 30.0


class Traffic:
    """The newest sample by name. The wire has checked the numbers."""

    def __init__(self) -> None:
        self.newest: dict[str, ReceivedTraffic] = {}

    def step(self, now_s: float, own_enu_m: Vector3, received: Iterable[ReceivedTraffic]) -> None:
        """Take these samples and forget those older than EXPIRES_S."""
        newest = self.newest
        for one in received:
            known = newest.get(one.name)
            if known is None or _measured_s(one) > _measured_s(known):
                newest[one.name] = one
        if not newest:
            return
        for name in [name for name, one in newest.items() if now_s - _measured_s(one) > EXPIRES_S]:
            del newest[name]
        while len(newest) > KEPT:
            del newest[max(newest, key=lambda name: dist(newest[name].sample.position_enu_m, own_enu_m))]


def _measured_s(one: ReceivedTraffic) -> float:
    return one.received_s - one.sample.age_s
