"""Recordings of several vehicles on one clock, which none of them has, and which of them belong to one flight.

A packet that leaves at `sent_s` of clock a and is received at `received_s` of clock b shows that b is at most received - sent
ahead of a. Packets the other way show how far it is ahead at least. The line in the middle of this corridor is the offset, as
in NTP. It is exact where the shortest delays of both directions are equal. Otherwise it is wrong by half their difference, and
never by more than half the width of the corridor.

The peer packets in /inbox compare the clocks of each pair of vehicles. Agents receive packets only at their ticks and 2 ms
before them, so a shortest delay is up to 18 ms: two vehicles are aligned to some milliseconds, and never worse than 10 ms as
long as both receive each other. A folder with all files of a board has those of other days as well: what begins far from the
flight is none of it.
"""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import combinations

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from companion.recording.codec import DECODE_ERRORS, LAST_S
from companion.recording.mcap_file import Warn
from companion.recording.reader import Recording
from companion.recording.records import INBOX

EVERY = 5  # packets of every fifth tick are enough
SAME_BOOT_S = 2.0  # two starts of one computer without a boot between them agree by so much on when it booted

Key = tuple[int, int]  # vehicle id and session


class _Head(Struct, array_like=True, gc=False):
    """The first fields of a PeerPacket."""

    vehicle_id: int
    session: int
    sequence: int
    formation_hash: msgspec.Raw
    phase: msgspec.Raw
    role: msgspec.Raw
    position_enu_m: msgspec.Raw
    velocity_enu_m_s: msgspec.Raw
    acceleration_enu_m_s2: msgspec.Raw
    state_age_s: msgspec.Raw
    sent_s: float


class _Received(Struct, array_like=True, gc=False):
    """The first fields of a ReceivedPeerPacket."""

    received_s: float
    packet: _Head


class _Packets(Struct, gc=False):
    peers: tuple[_Received, ...] = ()


_decoder = msgspec.json.Decoder(_Packets)


@dataclass(frozen=True, slots=True)
class RecordingClock:
    """The clock of one recording. Common time is the Unix time of the first vehicle, and Unix time of none of the others.

    `width_s`: twice the largest error against the first vehicle; None where the clock could not be compared, so that common
    time is by its own Unix time.
    """

    at_s: float
    unix_s: float  # common time at `at_s`
    rate: float  # how much faster common time runs than this clock, seconds per second
    width_s: float | None = None

    def common_s(self, now_s: float) -> float:
        """Common time of a moment of the vehicle's monotonic clock."""
        return self.unix_s + (now_s - self.at_s) * (1.0 + self.rate)

    @property
    def is_aligned(self) -> bool:
        return self.width_s is not None


def align(recordings: Sequence[Recording], warn: Warn) -> tuple[RecordingClock, ...]:
    """The clock of each recording. The reference is the first recording of those that are connected with the most others.

    Of several such groups, as with all flights of a day in one folder, it is the latest by its own clocks.
    """
    lines = _lines(recordings, warn)
    own = [RecordingClock(one.header.monotonic_s, one.header.unix_s, 0.0) for one in recordings]
    groups = [_connected(start, own[start], lines) for start in range(len(recordings))]
    best = max(groups, key=lambda group: (len(group), max(own[i].unix_s for i in group)), default={})
    if len(best) == 1:
        best = {}
    return tuple(best.get(index, clock) for index, clock in enumerate(own))


def _connected(start: int, clock: RecordingClock, lines: dict[tuple[int, int], ClockLine]) -> dict[int, RecordingClock]:
    """The clocks that are connected with this one, each over the narrowest corridors."""
    clocks: dict[int, RecordingClock] = {}
    waiting = {start: replace(clock, width_s=0.0)}
    while waiting:
        index = min(waiting, key=lambda i: (waiting[i].width_s or 0.0, i))
        known = clocks[index] = waiting.pop(index)
        for (a, b), line in lines.items():
            if a == index and b not in clocks:
                reached = _behind(known, line)
                waiting[b] = min(waiting.get(b, reached), reached, key=lambda one: one.width_s or 0.0)
    return clocks


def _behind(known: RecordingClock, line: ClockLine) -> RecordingClock:
    """The clock b of a line whose clock a is known."""
    return RecordingClock(
        at_s=line.at_s + line.offset_s,
        unix_s=known.common_s(line.at_s),
        rate=(1.0 + known.rate) / (1.0 + line.rate) - 1.0,
        width_s=(known.width_s or 0.0) + line.width_s,
    )


def _lines(recordings: Sequence[Recording], warn: Warn) -> dict[tuple[int, int], ClockLine]:
    """Between all recordings that can be compared, in both directions."""
    keys: list[Key] = [(one.vehicle_id, one.header.session) for one in recordings]
    received = {key: _times(one, set(keys), warn) for key, one in zip(keys, recordings, strict=True) if one.vehicle_id}
    lines: dict[tuple[int, int], ClockLine] = {}
    for a, b in combinations(range(len(recordings)), 2):
        from_a, from_b = received.get(keys[b], {}).get(keys[a]), received.get(keys[a], {}).get(keys[b])
        line = fit_line(*from_a, *from_b) if from_a and from_b else _same_boot(recordings[a], recordings[b])
        if line:
            lines[a, b], lines[b, a] = line, _reversed(line)
    return lines


def _reversed(line: ClockLine) -> ClockLine:
    return ClockLine(line.at_s + line.offset_s, -line.offset_s, 1.0 / (1.0 + line.rate) - 1.0, line.width_s)


def _same_boot(a: Recording, b: Recording) -> ClockLine | None:
    """Two starts on one computer have one monotonic clock, if it did not boot between them."""
    if a.vehicle_id != b.vehicle_id or not a.vehicle_id:
        return None
    booted_apart_s = (a.header.unix_s - a.header.monotonic_s) - (b.header.unix_s - b.header.monotonic_s)
    return ClockLine(a.header.monotonic_s, 0.0, 0.0, 0.0) if abs(booted_apart_s) < SAME_BOOT_S else None


def _times(recording: Recording, senders: Collection[Key], warn: Warn) -> dict[Key, tuple[Floats, Floats]]:
    """When each packet of these senders was sent, by the sender's clock, and received, by that of the recording."""
    sent: dict[Key, array[float]] = defaultdict(lambda: array("d"))
    received: dict[Key, array[float]] = defaultdict(lambda: array("d"))
    for message in recording.undecoded([INBOX], warn):
        if message.sequence % EVERY:
            continue
        try:
            packets = _decoder.decode(message.data).peers
        except DECODE_ERRORS:
            continue  # one message less; where it matters, others report it
        for one in packets:
            received_s, head = one.received_s, one.packet
            key = (head.vehicle_id, head.session)
            if key in senders and abs(head.sent_s) < LAST_S and abs(received_s) < LAST_S:
                sent[key].append(head.sent_s)
                received[key].append(received_s)
    return {key: (np.array(sent[key]), np.array(received[key])) for key in sent}


Floats = NDArray[np.float64]

MAX_RATE = 3e-4  # seconds per second; the clocks of two computers drift apart by less
RATE_NEEDS_S = 30.0  # a rate that only messages nearer to each other than this show is noise
BIN_S = 5.0  # one bound for each direction in this time
SURE = 20  # from so many messages in a bin the second best is used: one wrong sending time must not decide
RATE_STEPS = 80  # steps of the search; each cuts the interval by a third


@dataclass(frozen=True, slots=True)
class ClockLine:
    """Clock b minus clock a at the time `a_s` of clock a: offset_s + rate * (a_s - at_s). `width_s` is that of the corridor."""

    at_s: float
    offset_s: float
    rate: float
    width_s: float


def fit_line(sent_a_s: Floats, received_b_s: Floats, sent_b_s: Floats, received_a_s: Floats) -> ClockLine | None:
    """The line by the messages from a to b and from b to a; None where there are none in one direction."""
    if not len(sent_a_s) or not len(sent_b_s):
        return None
    at_s = float(np.mean(sent_a_s))
    upper_at_s, upper_s = _least(sent_a_s - at_s, received_b_s - sent_a_s)
    lower_at_s, negative_s = _least(received_a_s - at_s, received_a_s - sent_b_s)
    lower_s = -negative_s

    def corridor(rate: float) -> tuple[float, float]:
        """Highest line below and lowest line above all bounds, by their offsets at `at_s`."""
        return float(np.max(lower_s - rate * lower_at_s)), float(np.min(upper_s - rate * upper_at_s))

    rate = _widest(corridor)
    least_s, most_s = corridor(rate)
    return ClockLine(at_s, (least_s + most_s) / 2.0, rate, abs(most_s - least_s))


def _least(at_s: Floats, apart_s: Floats) -> tuple[Floats, Floats]:
    """The smallest value in each bin of time, or the second one where there are many, and its time."""
    order = np.lexsort((apart_s, np.floor(at_s / BIN_S)))
    bins = np.floor(at_s[order] / BIN_S)
    first = np.flatnonzero(np.diff(bins, prepend=np.nan) != 0)
    count = np.diff(np.append(first, len(bins)))
    chosen = order[first + (count >= SURE)]
    return at_s[chosen], apart_s[chosen]


def _widest(corridor: Callable[[float], tuple[float, float]]) -> float:
    """The rate with the widest corridor. The width is concave in the rate."""

    def width(rate: float) -> float:
        least_s, most_s = corridor(rate)
        return most_s - least_s - abs(rate) * RATE_NEEDS_S

    low, high = -MAX_RATE, MAX_RATE
    for _ in range(RATE_STEPS):
        third = (high - low) / 3.0
        if width(low + third) < width(high - third):
            low += third
        else:
            high -= third
    return (low + high) / 2.0


APART_S = 3600.0  # what begins by more before or after all of a flight is none of it
NAMED = 5  # at most so many of the left-out recordings are named


def of_one_flight(
    recordings: Sequence[Recording], clocks: Sequence[RecordingClock], warn: Warn
) -> list[tuple[Recording, RecordingClock]]:
    """Those whose clocks are aligned, and what begins near them; without any, the latest and what begins near it.

    `warn` gets one line where others are left out. There is at least one recording.
    """
    pairs = list(zip(recordings, clocks, strict=True))
    begins_s = [clock.common_s(one.header.monotonic_s) for one, clock in pairs]
    of_flight_s = [s for s, clock in zip(begins_s, clocks, strict=True) if clock.is_aligned] or [max(begins_s)]
    first_s, last_s = min(of_flight_s) - APART_S, max(of_flight_s) + APART_S
    others = [one for (one, _), s in zip(pairs, begins_s, strict=True) if not first_s <= s <= last_s]
    if others:
        warn(_left_out(others))
    return [pair for pair, s in zip(pairs, begins_s, strict=True) if first_s <= s <= last_s]


def _left_out(others: Sequence[Recording]) -> str:
    named = ", ".join(f"{one.name} of {_date(one.header.unix_s)}" for one in others[:NAMED])
    more = f" and {len(others) - NAMED} more" if len(others) > NAMED else ""
    count = "1 recording" if len(others) == 1 else f"{len(others)} recordings"
    return (
        f"{count} of more than an hour before or after this flight, by the clocks on board, left out: {named}{more};"
        " give each flight its own folder"
    )


FIRST_DATE_UNIX_S = 946684800.0  # of 2000: a clock that was never set is in 1970 or 1980, a virtual one begins in 1970


def _date(unix_s: float) -> str:
    return f"{datetime.fromtimestamp(unix_s, UTC):%Y-%m-%d %H:%M} UTC"
