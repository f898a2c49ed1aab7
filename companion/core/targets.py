"""Newest believable word of targets that an RFT may follow. Whoever the network lets publish one is believed within reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from math import hypot, isfinite

from msgspec import Struct

from companion.core.peers import CREEP, MAX_COORDINATE_M, MAX_SENT_S
from companion.types import ZERO3, ReceivedTarget, TargetSample, Vector3

MAX_SPEED_M_S = 100.0
TOO_LATE_S = 1.0  # held up by more than this on its way


class Target(Struct, frozen=True, gc=False):
    """What was heard last of one target. `measured_s` is when it was so, on this vehicle's clock; see `core/peers.py`."""

    sample: TargetSample
    received_s: float
    least_apart_s: float
    measured_s: float

    def position_at(self, now_s: float) -> Vector3 | None:
        """Carried on with its velocity."""
        if self.sample.position_enu_m is None:
            return None
        age_s = now_s - self.measured_s
        (x, y, z), (vx, vy, vz) = self.sample.position_enu_m, self.sample.velocity_enu_m_s
        return (x + vx * age_s, y + vy * age_s, z + vz * age_s)


class Targets:
    """Checks every word: order, finite, plausible, age. `rejected` counts what was refused, by reason."""

    def __init__(self) -> None:
        self._newest: dict[str, Target] = {}
        self.rejected: Counter[str] = Counter()

    def fold(self, received: Iterable[ReceivedTarget], names: Collection[str]) -> None:
        """Of other names than these nothing is kept."""
        for word in received:
            if word.name not in names:
                continue
            newest = self._newest.get(word.name)
            if reason := _refusal(word, newest):
                self.rejected[f"target: {reason}"] += 1
            else:
                self._newest[word.name] = _timed(word, newest)

    def newest(self, name: str) -> Target | None:
        return self._newest.get(name)


def _refusal(word: ReceivedTarget, newest: Target | None) -> str | None:
    sample = word.sample
    numbers = (*(sample.position_enu_m or ZERO3), *sample.velocity_enu_m_s, sample.sent_s)
    if not all(isfinite(number) for number in numbers):
        return "numbers not finite"
    if sample.position_enu_m is not None and max(abs(c) for c in sample.position_enu_m) > MAX_COORDINATE_M:
        return "position not plausible"
    if hypot(*sample.velocity_enu_m_s) > MAX_SPEED_M_S:
        return "speed not plausible"
    if not 0.0 <= sample.sent_s <= MAX_SENT_S:
        return "time of sending not plausible"
    if newest is None:
        return None
    if newest.sample.session != sample.session:
        return "two of one name" if word.received_s - newest.measured_s < TOO_LATE_S else None
    if sample.sequence <= newest.sample.sequence:
        return "out of order or replayed"
    return "comes too late" if word.received_s - _timed(word, newest).measured_s > TOO_LATE_S else None


def _timed(word: ReceivedTarget, newest: Target | None) -> Target:
    """What held it up counts from the shortest way of its session, slowly forgotten: clocks drift apart."""
    apart_s = least_apart_s = word.received_s - word.sample.sent_s
    if newest is not None and newest.sample.session == word.sample.session:
        least_apart_s = min(apart_s, newest.least_apart_s + CREEP * (word.received_s - newest.received_s))
    return Target(word.sample, word.received_s, least_apart_s, word.sample.sent_s + least_apart_s)
