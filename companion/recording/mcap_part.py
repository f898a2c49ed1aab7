"""One MCAP file: messages of a second as a chunk, and the bytes of the file's beginning, of each chunk, and of its end.

A chunk is put together in the event loop: framed there, compressed and written elsewhere. The records are those of the package
`mcap`. Its `Writer` is not used: it frames each message in Python, which here would hold the interpreter in the writing thread.
There is no message index: uncompressed, it would be a fifth of a file. Viewers then read a file from its beginning, as they do
with one that power loss has cut.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Sequence

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, DataEnd, Footer, McapRecord, Metadata, MetadataIndex, Schema, Statistics
from mcap.records import Chunk as ChunkRecord
from mcap.records import Header as McapHeader

from companion.recording.codec import log_time_ns, metadata_of
from companion.recording.files import PartFiles, PartFormat
from companion.recording.records import FORMAT, MESSAGE_ENCODING, SCHEMA_ENCODING, Header, schema
from companion.recording.writing import Writing

FRAME = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE = 0x05
_FIELDS = FRAME.size - 9  # bytes of the length that are not data
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
        head = FRAME.pack(_MESSAGE, _FIELDS + len(data), channel_id, sequence % _MOST_SEQUENCE, time_ns, time_ns)
        self.frames += (head, data)
        self.bytes += len(head) + len(data)
        self.counts[channel_id] = self.counts.get(channel_id, 0) + 1


MAGIC = b"\x89MCAP0\r\n"  # first and last bytes of a file; mcap.writer, which has them too, would take 2 MB of memory
CRC_BYTES = 4  # at the end of a footer, the one field that its checksum leaves out
# Level 1 with long matches: 6 us of a core for a tick. Level 9 takes five times as long for files an eighth smaller, and its
# tables push what a tick needs out of the processor's cache; a table of 2**13 recent places is in the smallest one.
COMPRESSION = zstandard.ZstdCompressionParameters.from_level(1, source_size=150_000, min_match=7, hash_log=13)


def channel_ids(topics: Sequence[str]) -> dict[str, int]:
    """The id of each topic's channel in a file of these topics."""
    return {topic: number for number, topic in enumerate(topics, start=1)}


class McapPart(PartFormat[MessageChunk]):
    """The bytes of one file, with a chunk as a piece."""

    def __init__(self, header: Header, topics: Sequence[str]) -> None:
        self._header = header
        self._described = _described(topics)
        self._compressor = zstandard.ZstdCompressor(compression_params=COMPRESSION)
        self._counts: Counter[int] = Counter()
        self._chunks = 0
        self._start_ns: int | None = None
        self._end_ns = 0

    def opening(self) -> bytes:
        """The magic bytes, the metadata and the topics with their schemas."""
        before, metadata = self._before_messages()
        return before + metadata + self._compressed(_bytes_of(*self._described), 0, 0)

    def piece(self, chunk: MessageChunk) -> bytes:
        """A chunk, compressed. zstd and the checksum of large chunks release the interpreter."""
        self._counts.update(chunk.counts)
        self._start_ns = chunk.start_ns if self._start_ns is None else min(self._start_ns, chunk.start_ns)
        self._end_ns = max(self._end_ns, chunk.end_ns)
        return self._compressed(b"".join(chunk.frames), chunk.start_ns, chunk.end_ns)

    def closing(self, offset: int) -> bytes:
        """The end of a file that has `offset` bytes so far."""
        data_end = _bytes_of(DataEnd(0))
        before, metadata = self._before_messages()
        index = MetadataIndex(offset=len(before), length=len(metadata), name=FORMAT)
        summary = _bytes_of(*self._described, self._statistics(), index)
        summary_start = offset + len(data_end)
        footer = _bytes_of(Footer(summary_start, 0, 0))
        crc = zlib.crc32(footer[:-CRC_BYTES], zlib.crc32(summary))
        return data_end + summary + _bytes_of(Footer(summary_start, 0, crc)) + MAGIC

    def _before_messages(self) -> tuple[bytes, bytes]:
        """What precedes the metadata record, and the metadata record."""
        header = McapHeader(profile=FORMAT, library=self._header.software)
        metadata = Metadata(name=FORMAT, metadata=metadata_of(self._header))
        return MAGIC + _bytes_of(header), _bytes_of(metadata)

    def _compressed(self, data: bytes, start_ns: int, end_ns: int) -> bytes:
        self._chunks += 1
        return _bytes_of(
            ChunkRecord(
                compression="zstd",
                data=self._compressor.compress(data),
                message_start_time=start_ns,
                message_end_time=end_ns,
                uncompressed_crc=zlib.crc32(data),
                uncompressed_size=len(data),
            )
        )

    def _statistics(self) -> Statistics:
        channels = [record for record in self._described if isinstance(record, Channel)]
        return Statistics(
            attachment_count=0,
            channel_count=len(channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunks,
            message_count=self._counts.total(),
            message_end_time=self._end_ns,
            message_start_time=self._start_ns or 0,
            metadata_count=1,
            schema_count=len(self._described) - len(channels),
        )


def _described(topics: Sequence[str]) -> list[McapRecord]:
    """A schema and a channel for each topic."""
    records: list[McapRecord] = []
    for topic, number in channel_ids(topics).items():
        name, data = schema(topic)
        records.append(Schema(id=number, name=name, encoding=SCHEMA_ENCODING, data=data))
        metadata: dict[str, str] = {}
        records.append(
            Channel(id=number, topic=topic, message_encoding=MESSAGE_ENCODING, metadata=metadata, schema_id=number)
        )
    return records


def _bytes_of(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


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
