"""A second of messages, as it is put together in the event loop: framed there, compressed and written elsewhere."""

from __future__ import annotations

import struct

_FRAME = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE = 0x05
_FIELDS = _FRAME.size - 9  # bytes of the length that are not data
_MOST_SEQUENCE = 2**32


class MessageChunk:
    """Messages in the order of `add`, each as an MCAP record. Times are nanoseconds of Unix time."""

    def __init__(self) -> None:
        self.frames: list[bytes] = []
        self.counts: dict[int, int] = {}  # messages by channel
        self.bytes = 0
        self.start_ns = 0
        self.end_ns = 0

    def __len__(self) -> int:
        return sum(self.counts.values())

    def add(self, channel_id: int, sequence: int, time_ns: int, data: bytes) -> None:
        """Add a message. Its time must not be negative."""
        if not self.frames:
            self.start_ns = self.end_ns = time_ns
        self.start_ns, self.end_ns = min(self.start_ns, time_ns), max(self.end_ns, time_ns)
        head = _FRAME.pack(_MESSAGE, _FIELDS + len(data), channel_id, sequence % _MOST_SEQUENCE, time_ns, time_ns)
        self.frames += (head, data)
        self.bytes += len(head) + len(data)
        self.counts[channel_id] = self.counts.get(channel_id, 0) + 1
