"""Order of the messages of one sender, and the offset between its clock and the own one.

The problem. Messages arrive late, twice, out of order, or not at all; a sender restarts and counts from 0 again; a recorded
message is sent once more. Sender and receiver share no clock: the age of a position cannot be read, and a message that was
held back for a second looks like a new one. What a message says about itself may be wrong, by a defect or by intent.

The model. A stream is one start of one sender: its random session, a sequence that rises, and times of sending by a clock
that runs as fast as the own one (within DRIFT) from another zero. Received minus sent time is the offset of the clocks plus
the delay of that message. The smallest such difference is the best guess of the offset; what a message has above it is its
delay.

One wrong time of sending must not decide the offset. So it has a support, the number of messages that agreed with it, and
with enough of it the offset is established. A single message lowers an established offset by STEP_S at most; several do, and
cost it its support. Messages that disagree form a rival offset. A rival that arrives earlier is physically possible only if
the offset was wrong: a few messages in a row suffice. A rival that arrives later looks like a congested link, whose data are
old: it wins only over an offset that is not established.

What always holds:
- a message is used once, and none before one that was used, as long as the sender is not silent;
- no delay is below zero, and no message is used that an established offset shows to be later than allowed;
- nothing that one message says locks the next ones out: after a silence, order and session begin again;
- messages apart, an offset grows by DRIFT alone.

The smallest difference as the offset is that of NTP's clock filter (RFC 5905, section 10), without its answers: these senders
only send.
"""

from __future__ import annotations

from enum import Enum, auto

from msgspec import Struct

SEQUENCES_AHEAD = 500  # largest step of the sequence, plus SEQUENCES_PER_S since the last message; 50 a second are sent
SEQUENCES_PER_S = 1000.0
DRIFT = 2e-4  # seconds per second; the clocks of two computers drift apart by less
STEP_S = 0.005  # a message may lower an offset with support by this much
EARLY_S = 0.1  # likewise for an offset without support; an earlier message is refused
AGREES_S = 0.02  # a message that is later than the offset by at most this supports it
EARLY_MESSAGES = 5  # so many early messages in a row lower the offset by more
LATE_MESSAGES = 25  # so many in a row raise the offset; an offset with as much support is never raised


class Disorder(Enum):
    """Why a message is refused."""

    TWO_SENDERS = auto()
    OUT_OF_ORDER = auto()
    LATE = auto()
    TIME = auto()  # sent in the future, by its sender's own clock


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
        return -EARLY_S <= apart_s - self.at(received_s) <= max_late_s

    def with_rival_message(self, apart_s: float, received_s: float) -> ClockOffset:
        """As a rival: the smallest offset of messages in a row, and their number."""
        return ClockOffset(min(self.at(received_s), apart_s), received_s, self.support + 1.0)


class Stream(Struct, frozen=True, gc=False):
    """The last message used of one sender, the offset of its clock, and a rival offset from messages in a row.

    `late_s` is the delay of that message beyond the least delayed one. An earlier one counts as not delayed.
    """

    session: int
    sequence: int
    clock: ClockOffset
    rival: ClockOffset | None = None
    late_s: float = 0.0


def following(
    before: Stream | None, session: int, sequence: int, sent_s: float, received_s: float, silent_s: float
) -> tuple[Stream, Disorder | None]:
    """(stream, None) with a message that is used, or (stream, reason) where it is refused.

    `silent_s`: after such a silence the order of messages begins again, and longer delays are refused. A wrong sequence, or
    another session, therefore counts for so long only.
    """
    apart_s = received_s - sent_s
    if before is None:
        return Stream(session, sequence, ClockOffset(apart_s, received_s)), None
    clock = before.clock
    silence_s = received_s - clock.received_s
    silent = silence_s > silent_s
    if session != before.session:
        if silent:
            return Stream(session, sequence, ClockOffset(apart_s, received_s)), None
        return before, Disorder.TWO_SENDERS
    least_s, support = clock.least_apart_s + DRIFT * silence_s, clock.support
    late_s = apart_s - least_s
    late, agrees = late_s > AGREES_S, -EARLY_S <= late_s <= silent_s
    if agrees:
        most = before.sequence + SEQUENCES_AHEAD + SEQUENCES_PER_S * silence_s
        if not silent and not before.sequence < sequence <= most:
            return before, Disorder.OUT_OF_ORDER
        if late_s < 0.0:
            most_s = STEP_S if support > LATE_MESSAGES / 2 else EARLY_S
            step_s = -late_s if -late_s < most_s else most_s
            least_s, left = least_s - step_s, 1.0 - step_s / AGREES_S
            support = support * left + 1.0 if left > 0.0 else 1.0
        elif not late:
            support += 1.0
        after = ClockOffset(least_s, received_s, support if support < LATE_MESSAGES else LATE_MESSAGES)
        delay_s = apart_s - least_s
        delay_s = delay_s if delay_s > 0.0 else 0.0  # not max(): it is slow, and every packet comes here
        if not late or clock.is_established:
            return Stream(session, sequence, after, None, delay_s), None
    rival = before.rival
    if rival and rival.agrees(apart_s, received_s, silent_s):
        rival = rival.with_rival_message(apart_s, received_s)
    else:
        rival = ClockOffset(apart_s, received_s)
    if replaces(rival, clock):
        return Stream(session, sequence, rival, late_s=max(0.0, apart_s - rival.least_apart_s)), None
    if agrees:
        return Stream(session, sequence, after, rival, delay_s), None
    return Stream(session, before.sequence, clock, rival), Disorder.LATE if late else Disorder.TIME


def replaces(rival: ClockOffset, offset: ClockOffset) -> bool:
    """Whether a rival offset has enough support, from messages in a row."""
    if rival.at(offset.received_s) < offset.least_apart_s:
        return rival.support > EARLY_MESSAGES - 1
    return not offset.is_established and rival.support > LATE_MESSAGES - 1
