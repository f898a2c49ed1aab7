"""Order of the messages of one sender: session, sequence and delay. Nothing that one message says locks the next ones out."""

from __future__ import annotations

from enum import Enum, auto

from msgspec import Struct

from companion.core.consensus.clock_offset import AGREES_S, ClockOffset, is_in_time, replaces

SEQUENCES_AHEAD = 500  # and SEQUENCES_PER_S since the last message; 50 a second are sent
SEQUENCES_PER_S = 1000.0


class Disorder(Enum):
    """Why a message is refused."""

    TWO_SENDERS = auto()
    OUT_OF_ORDER = auto()
    LATE = auto()
    TIME = auto()  # sent in the future, by its sender's own clock


class Stream(Struct, frozen=True, gc=False):
    """The last message used of one sender, the offset of its clock, and a rival offset from messages in a row."""

    session: int
    sequence: int
    clock: ClockOffset
    rival: ClockOffset | None = None

    @property
    def received_s(self) -> float:
        return self.clock.received_s

    def late_s(self, sent_s: float) -> float:
        """Delay of the last message beyond the least delayed one. An earlier one counts as not delayed."""
        clock = self.clock
        late_s = clock.received_s - sent_s - clock.least_apart_s
        return late_s if late_s > 0.0 else 0.0


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
    clock, rival = before.clock, before.rival
    silence_s = received_s - clock.received_s
    silent = silence_s > silent_s
    if session != before.session:
        if silent:
            return Stream(session, sequence, ClockOffset(apart_s, received_s)), None
        return before, Disorder.TWO_SENDERS
    least_s = clock.at(received_s)
    late_s = apart_s - least_s
    late, agrees = late_s > AGREES_S, is_in_time(late_s, silent_s)
    most = before.sequence + SEQUENCES_AHEAD + SEQUENCES_PER_S * silence_s
    if agrees and not silent and not before.sequence < sequence <= most:
        return before, Disorder.OUT_OF_ORDER
    if agrees and (not late or clock.is_established):
        return Stream(session, sequence, clock.with_message(apart_s, received_s, least_s)), None
    if rival and rival.agrees(apart_s, received_s, silent_s):
        rival = rival.with_rival_message(apart_s, received_s)
    else:
        rival = ClockOffset(apart_s, received_s)
    if replaces(rival, clock):
        return Stream(session, sequence, rival), None
    if agrees:
        return Stream(session, sequence, clock.with_message(apart_s, received_s, least_s), rival), None
    return Stream(session, before.sequence, clock, rival), Disorder.LATE if late else Disorder.TIME
