"""Offset between a sender's clock and the own one, from times of sending and receipt. The vehicles share no clock.

The offset of a stream of messages is the smallest received minus sent time. One wrong time of sending must not decide it: each
offset has a support, the number of messages that agreed with it, and an offset with enough of it is established. A single
message lowers an established offset by STEP_S at most; several do, and cost it its support. Messages that disagree form a
rival offset. A rival that arrives earlier is physically possible only if the offset was wrong: a few messages in a row
suffice. A rival that arrives later looks like a congested link, whose data are old: it wins only over an offset that is not
established.
"""

from __future__ import annotations

from msgspec import Struct

DRIFT = 2e-4  # seconds per second; the clocks of two computers drift apart by less
STEP_S = 0.005  # a message may lower an offset with support by this much
EARLY_S = 0.1  # and one without support; an earlier message is refused
AGREES_S = 0.02  # later than the offset: a message that supports it
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

    @property
    def is_established(self) -> bool:
        """Whether later messages are late, however many there are."""
        return self.support > LATE_MESSAGES - 1

    def agrees(self, apart_s: float, received_s: float, max_late_s: float) -> bool:
        """Whether a message is neither early nor more than `max_late_s` late."""
        return is_in_time(apart_s - self.at(received_s), max_late_s)

    def with_message(self, apart_s: float, received_s: float, least_s: float) -> ClockOffset:
        """The offset after a message that agrees. `least_s` is the offset `at(received_s)`."""
        early_s = least_s - apart_s
        if early_s <= 0.0:
            support = self.support + 1.0 if early_s >= -AGREES_S else self.support
            return ClockOffset(least_s, received_s, support if support < LATE_MESSAGES else LATE_MESSAGES)
        step_s = min(early_s, STEP_S if self.support > LATE_MESSAGES / 2 else EARLY_S)
        support = self.support * max(0.0, 1.0 - step_s / AGREES_S) + 1.0
        return ClockOffset(least_s - step_s, received_s, min(support, LATE_MESSAGES))

    def with_rival_message(self, apart_s: float, received_s: float) -> ClockOffset:
        """As a rival: the smallest offset of messages in a row, and their number."""
        return ClockOffset(min(self.at(received_s), apart_s), received_s, self.support + 1.0)


def is_in_time(late_s: float, max_late_s: float) -> bool:
    """Whether a message this much later than the least delayed one is neither early nor too late."""
    return -EARLY_S <= late_s <= max_late_s


def replaces(rival: ClockOffset, offset: ClockOffset) -> bool:
    """Whether a rival offset has enough support, from messages in a row."""
    if rival.at(offset.received_s) < offset.least_apart_s:
        return rival.support > EARLY_MESSAGES - 1
    return not offset.is_established and rival.support > LATE_MESSAGES - 1
