"""The bytes of a file: read by the library of MCAP, with its checksums, whole and cut off."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, SeekingReader

from companion.recording.mcap_file import McapFile
from companion.recording.mcap_part import McapPart, MessageChunk
from companion.recording.records import FORMAT, GROUND_COMMAND, GROUND_STATUS, Header

TOPICS = (GROUND_STATUS, GROUND_COMMAND)
HEADER = Header(
    software="test", fleet="one", vehicle_id=0, session=1, part=2, unix_s=1.5, monotonic_s=0.5, fleet_file="{}", vehicle_file=""
)  # fmt: skip
messages = st.lists(st.tuples(st.sampled_from([1, 2]), st.integers(0, 2**63), st.binary(max_size=50)), max_size=20)


def file_of(*chunks: list[tuple[int, int, bytes]]) -> tuple[bytes, list[int]]:
    """A whole file, and its length after the opening and after each chunk."""
    part = McapPart(HEADER, TOPICS)
    data = part.opening()
    lengths = [len(data)]
    for content in chunks:
        chunk = MessageChunk()
        for number, (channel_id, time_ns, payload) in enumerate(content):
            chunk.add(channel_id, number, time_ns, payload)
        data += part.piece(chunk)
        lengths.append(len(data))
    return data + part.closing(len(data)), lengths


@given(st.lists(messages.filter(bool), max_size=4))
def test_the_library_reads_what_was_written(chunks: list[list[tuple[int, int, bytes]]]) -> None:
    data, _ = file_of(*chunks)
    for reader in (
        SeekingReader(BytesIO(data), validate_crcs=True),
        NonSeekingReader(BytesIO(data), validate_crcs=True),
    ):
        read = [(c.id, m.log_time, m.data) for _, c, m in reader.iter_messages(log_time_order=False)]
        assert read == [message for chunk in chunks for message in chunk]


def test_metadata_topics_and_statistics_are_found_from_the_end() -> None:
    data, _ = file_of([(1, 10, b"{}"), (2, 30, b"{}")], [(1, 20, b"{}")])
    reader = SeekingReader(BytesIO(data), validate_crcs=True)
    (metadata,) = reader.iter_metadata()
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert metadata.name == FORMAT
    assert metadata.metadata["part"] == "2"
    assert [channel.topic for channel in summary.channels.values()] == list(TOPICS)
    assert all(summary.schemas[channel.schema_id].data for channel in summary.channels.values())
    assert summary.statistics.channel_message_counts == {1: 2, 2: 1}
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (10, 30)


@pytest.mark.parametrize("chunks_left", [0, 1, 2])
def test_a_file_that_is_cut_off_holds_its_whole_chunks(tmp_path: Path, chunks_left: int) -> None:
    data, lengths = file_of([(1, 10, b"{}")], [(1, 20, b"{}")], [(1, 30, b"{}")])
    cut = data[: lengths[chunks_left] + 5]
    path = tmp_path / "cut.mcap"
    path.write_bytes(cut)
    warnings: list[str] = []
    read = [message.log_time_ns for message in McapFile(path).messages(TOPICS, warnings.append)]
    assert read == [10, 20, 30][:chunks_left]
    assert len(warnings) == 1


def test_the_same_messages_give_the_same_bytes() -> None:
    content = [(1, 10, b"{}"), (2, 20, b"[1]")]
    assert file_of(content) == file_of(content)
