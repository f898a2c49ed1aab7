"""Recordings of several vehicles on one clock, which none of them has.

The peer packets in /inbox compare the clocks of each pair of vehicles (`clock_line.py`). Agents receive packets only at their
ticks, so a shortest delay is up to 20 ms: two vehicles are aligned to some milliseconds, and never worse than 10 ms as long as
both receive each other.
"""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import msgspec
import numpy as np
from msgspec import Struct

from companion.recording.clock_line import ClockLine, Floats, fitted_line
from companion.recording.codec import DECODE_ERRORS, LAST_S
from companion.recording.mcap_file import Warn
from companion.recording.reader import Recording
from companion.recording.records import INBOX

EVERY = 5  # of this many ticks the packets of one are used
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


class _Packets(Struct, gc=False):
    peers: tuple[tuple[float, _Head], ...] = ()


_decoder = msgspec.json.Decoder(_Packets)


@dataclass(frozen=True, slots=True)
class RecordingClock:
    """The clock of one recording. Common time is the Unix time of the first vehicle, and Unix time of none of the others.

    `width_s`: twice the largest error against the first vehicle; None where the clock could not be compared, so that common
    time is by its own Unix time.
    """

    at_s: float
    unix_s: float  # common time at `at_s`
    rate: float  # of common time against this clock, minus 1
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
        line = fitted_line(*from_a, *from_b) if from_a and from_b else _same_boot(recordings[a], recordings[b])
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
        for received_s, head in packets:
            key = (head.vehicle_id, head.session)
            if key in senders and abs(head.sent_s) < LAST_S and abs(received_s) < LAST_S:
                sent[key].append(head.sent_s)
                received[key].append(received_s)
    return {key: (np.array(sent[key]), np.array(received[key])) for key in sent}
