"""Offset between a sender's clock and the own one, from times of sending and receipt. The vehicles share no clock.

The offset of a stream of messages is the smallest received minus sent time. One wrong time of sending must not decide it: each
offset has a support, the number of messages that agreed with it. Messages that disagree are refused, and form a rival offset.
A rival that arrives earlier is physically possible only if the offset was wrong: a few messages in a row suffice. A rival that
arrives later looks like a congested link, whose data are old: it wins only over an offset with less support.
"""

from __future__ import annotations

from msgspec import Struct

DRIFT = 2e-4  # seconds per second; the clocks of two computers drift apart by less
EARLY_S = 0.1  # a message may lower the offset by this much at once
AGREES_S = 0.05  # from the offset
EARLY_MESSAGES = 5  # in a row, to lower the offset by more
LATE_MESSAGES = 25  # in a row, to raise it; also the support of an established offset, which is never raised


class ClockOffset(Struct, frozen=True, gc=False):
    """Received minus sent time of the least delayed message, at `received_s`; the number of messages that agree, limited."""

    least_apart_s: float
    received_s: float
    support: float = 1.0

    def at(self, received_s: float) -> float:
        """The least offset at this time: it grows slowly, because the clocks drift apart."""
        return self.least_apart_s + DRIFT * (received_s - self.received_s)

    def agrees(self, apart_s: float, received_s: float, max_late_s: float) -> bool:
        """Whether a message is neither early nor more than `max_late_s` late."""
        return -EARLY_S <= apart_s - self.at(received_s) <= max_late_s

    def with_message(self, apart_s: float, received_s: float) -> ClockOffset:
        """The offset after a message that agrees."""
        least_s = self.at(received_s)
        late_s = apart_s - least_s
        if late_s < 0.0:
            return ClockOffset(apart_s, received_s, self.support * (1.0 + late_s / EARLY_S) + 1.0)
        support = min(self.support + 1.0, LATE_MESSAGES) if late_s <= AGREES_S else self.support
        return ClockOffset(least_s, received_s, support)


def replaces(rival: ClockOffset, offset: ClockOffset) -> bool:
    """Whether a rival offset has enough support, from messages in a row."""
    if rival.at(offset.received_s) < offset.least_apart_s:
        return rival.support > EARLY_MESSAGES - 1
    return offset.support <= LATE_MESSAGES - 1 < rival.support
