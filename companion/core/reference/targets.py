"""Newest plausible sample of each target that an RFT may follow. Any sender that the network admits is accepted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from math import hypot, isfinite

from msgspec import Struct

from companion.core.consensus.message_order import Disorder, Stream, following
from companion.core.consensus.peers import MAX_SENT_S
from companion.geometry.vectors import extrapolated
from companion.types.notices import Code
from companion.types.peers import ReceivedTarget, TargetSample
from companion.types.rejections import counted
from companion.types.values import MAX_COORDINATE_M, ZERO3, Vector3

CODES = {
    Disorder.TWO_SENDERS: Code.TARGET_NAME_TWICE,
    Disorder.OUT_OF_ORDER: Code.TARGET_OUT_OF_ORDER,
    Disorder.LATE: Code.TARGET_LATE,
    Disorder.TIME: Code.TARGET_TIME_IMPLAUSIBLE,
}
MAX_SPEED_M_S = 100.0
TOO_LATE_S = 1.0  # longest accepted transport delay


class Target(Struct, frozen=True, gc=False):
    """Newest sample of one target, with its times on this vehicle's clock as in `PeerState`."""

    sample: TargetSample
    received_s: float
    least_apart_s: float
    measured_s: float

    def position_at(self, now_s: float) -> Vector3 | None:
        """Position extrapolated over its age; None for a target that reports only a velocity."""
        if self.sample.position_enu_m is None:
            return None
        return extrapolated(self.sample.position_enu_m, self.sample.velocity_enu_m_s, now_s - self.measured_s)


class Targets:
    """Newest sample of each target. Samples are checked for order, plausible numbers and delay.

    `rejected` counts refused samples by code.
    """

    def __init__(self) -> None:
        self._newest: dict[str, Target] = {}
        self._streams: dict[str, Stream] = {}
        self.rejected: Counter[str] = Counter()

    def fold(self, received: Iterable[ReceivedTarget], names: Collection[str]) -> None:
        """Check and take these samples. Samples of targets not in `names` are ignored."""
        for sample in received:
            if sample.name not in names:
                continue
            if code := _refusal(sample.sample) or self._refusal_of_order(sample):
                self.rejected = counted(self.rejected, code)
            else:
                stream = self._streams[sample.name]
                measured_s = sample.received_s - stream.late_s(sample.sample.sent_s)
                self._newest[sample.name] = Target(
                    sample.sample, sample.received_s, stream.clock.least_apart_s, measured_s
                )

    def _refusal_of_order(self, received: ReceivedTarget) -> Code | None:
        sample = received.sample
        stream, disorder = following(
            self._streams.get(received.name),
            sample.session,
            sample.sequence,
            sample.sent_s,
            received.received_s,
            TOO_LATE_S,
        )
        self._streams[received.name] = stream
        return CODES[disorder] if disorder else None

    def newest(self, name: str) -> Target | None:
        """Newest sample of a target, of any age."""
        return self._newest.get(name)


def _refusal(sample: TargetSample) -> Code | None:
    numbers = (*(sample.position_enu_m or ZERO3), *sample.velocity_enu_m_s, sample.sent_s)
    if not all(isfinite(number) for number in numbers):
        return Code.TARGET_NOT_FINITE
    if sample.position_enu_m is not None and max(abs(c) for c in sample.position_enu_m) > MAX_COORDINATE_M:
        return Code.TARGET_POSITION_IMPLAUSIBLE
    if hypot(*sample.velocity_enu_m_s) > MAX_SPEED_M_S:
        return Code.TARGET_SPEED_IMPLAUSIBLE
    return None if 0.0 <= sample.sent_s <= MAX_SENT_S else Code.TARGET_TIME_IMPLAUSIBLE
