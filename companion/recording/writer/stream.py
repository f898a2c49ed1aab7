"""Messages of one recording -> chunks of a second."""

from __future__ import annotations

from collections.abc import Sequence

from companion.recording.codec import log_time_ns
from companion.recording.records import Header
from companion.recording.writer.chunk import MessageChunk
from companion.recording.writer.files import PartFiles
from companion.recording.writer.mcap_part import channel_ids
from companion.recording.writer.writing import Writing

# From its first message to its last: an agent's chunks, of whole tens of ticks, have a second. That is what a power loss may
# take, and a compromise: shorter chunks compress worse.
CHUNK_S = 0.9
# All packets of 250 vehicles have half of it. Whatever else a stranger sends must fill neither the memory nor the disk.
MOST_BYTES = 8_000_000
TOO_MUCH = f"more than {MOST_BYTES // 1_000_000} MB in a second: the network is flooded"


class MessageStream:
    """Frames messages and hands them on once a second, as one chunk."""

    def __init__(self, header: Header, topics: Sequence[str], files: PartFiles[MessageChunk], writing: Writing) -> None:
        self._header, self._files, self._writing = header, files, writing
        self._ids = channel_ids(topics)
        self._chunk = MessageChunk()
        self._began_s = 0.0

    def add(self, topic: str, sequence: int, now_s: float, data: bytes) -> None:
        """Add a message of this moment, or drop it where a chunk has MOST_BYTES already."""
        if self._chunk.bytes > MOST_BYTES:
            self._writing.drop(1, TOO_MUCH)
            return
        if not self._chunk.frames:
            self._began_s = now_s
        self._chunk.add(self._ids[topic], sequence, log_time_ns(self._header, now_s), data)

    def hand_on(self, now_s: float) -> bool:
        """Hand on what is a second old. Returns whether there was any."""
        if not self._chunk.frames or now_s - self._began_s < CHUNK_S:
            return False
        self.flush()
        return True

    def flush(self) -> None:
        """Hand on what there is."""
        if self._chunk.frames:
            self._writing.put(self._files, self._chunk, len(self._chunk))
            self._chunk = MessageChunk()
