"""Recordings in a folder: found, grouped, read in order; damaged and hostile files never end the reading of the others."""

import os
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import Writer
from msgspec.structs import replace

from companion.recording.codec import encode_outbox
from companion.recording.mcap_file import MAGIC, MAX_RECORD
from companion.recording.reader import MissingTicksError, Recording, RecordingError, recordings
from companion.recording.records import EVENT, INBOX, OUTBOX, TIMING, TimingRecord
from companion.types.notices import Code, Notice
from companion.types.tick import Inbox, Outbox
from recordings import HEADER, RecordingFile, time_of, write_ticks

TICKS = range(1, 301)


def read_numbers(recording: Recording, warn: Callable[[str], None]) -> list[int]:
    """Numbers of the ticks whose input can be read."""
    return [round(message.value[1].late_s * 1e3) for message in recording.read([INBOX], warn)]


@pytest.fixture
def lines() -> list[str]:
    return []


# ------------------------------------------------------------ whole files


def test_parts_and_starts_are_grouped_and_in_order(tmp_path: Path, lines: list[str]) -> None:
    second = replace(HEADER, vehicle_id=2)
    restart = replace(HEADER, session=8, unix_s=HEADER.unix_s + 60.0)
    write_ticks(tmp_path / "b.mcap", range(1, 11))
    write_ticks(tmp_path / "a.mcap", range(11, 21), replace(HEADER, part=2))
    write_ticks(tmp_path / "two" / "x.mcap", range(1, 6), second)
    write_ticks(tmp_path / "two" / "deep" / "y.mcap", range(1, 6), restart)
    found = recordings(tmp_path, lines.append)
    assert [(one.vehicle_id, one.header.session, len(one.parts)) for one in found] == [(1, 7, 2), (1, 8, 1), (2, 7, 1)]
    assert read_numbers(found[0], lines.append) == list(range(1, 21))
    assert not lines


def test_ticks_have_input_and_output(tmp_path: Path, lines: list[str]) -> None:
    write_ticks(tmp_path / "a.mcap", TICKS)
    (recording,) = recordings(tmp_path, lines.append)
    ticks = list(recording.ticks(lines.append))
    assert [tick.number for tick in ticks] == list(TICKS)
    assert ticks[4] == (5, time_of(5), Inbox(late_s=0.005), encode_outbox(time_of(5), Outbox()))
    assert ticks[4].outbox() == Outbox()
    assert not lines


def test_messages_have_the_time_of_the_vehicles_clock(tmp_path: Path, lines: list[str]) -> None:
    file = RecordingFile(tmp_path / "a.mcap")
    file.write(EVENT, 123.456789, Notice(Code.PEER_STALE, "2: no packet"))
    file.write(TIMING, 124.0, TimingRecord(124.0, 1, 2, 3, None))
    file.close()
    (recording,) = recordings(tmp_path / "a.mcap", lines.append)
    (event,) = recording.read([EVENT], lines.append)
    assert event.now_s == pytest.approx(123.456789, abs=1e-9)
    assert event.value == Notice(Code.PEER_STALE, "2: no packet")


def test_the_same_part_twice_is_used_once(tmp_path: Path, lines: list[str]) -> None:
    write_ticks(tmp_path / "a.mcap", range(1, 4))
    (tmp_path / "copy.mcap").write_bytes((tmp_path / "a.mcap").read_bytes())
    (recording,) = recordings(tmp_path, lines.append)
    assert len(recording.parts) == 1
    assert len(lines) == 1
    assert "copy.mcap: the same part" in lines[0]


def test_a_missing_part_ends_the_ticks(tmp_path: Path, lines: list[str]) -> None:
    write_ticks(tmp_path / "a.mcap", range(1, 4), replace(HEADER, part=2))
    (recording,) = recordings(tmp_path, lines.append)
    assert recording.missing_parts == ("part 1 of the recording is not here",)
    assert read_numbers(recording, lines.append) == [1, 2, 3]
    with pytest.raises(MissingTicksError, match="part 1"):
        list(recording.ticks(lines.append))


def test_however_many_parts_are_missing_one_line_names_them(tmp_path: Path, lines: list[str]) -> None:
    write_ticks(tmp_path / "a.mcap", range(1, 4), replace(HEADER, part=99_999))
    (recording,) = recordings(tmp_path, lines.append)
    assert recording.missing_parts == ("parts 1 to 99998 of the recording are not here",)


@pytest.mark.parametrize(
    ("numbers", "reason"),
    [([1, 2, 4], "tick 3 is not"), ([1, 5], "ticks 2 to 4"), ([2], "tick 1 is not"), ([1, 2, 2], "tick 2 comes after")],
)
def test_a_tick_that_is_not_recorded_ends_them(
    numbers: list[int], reason: str, tmp_path: Path, lines: list[str]
) -> None:
    write_ticks(tmp_path / "a.mcap", numbers)
    (recording,) = recordings(tmp_path, lines.append)
    with pytest.raises(MissingTicksError, match=reason):
        list(recording.ticks(lines.append))


def test_a_tick_whose_output_is_lost_is_still_a_tick(tmp_path: Path, lines: list[str]) -> None:
    file = RecordingFile(tmp_path / "a.mcap")
    file.tick(1, 100.0, Inbox(), None)
    file.tick(2, 100.02, Inbox(), Outbox())
    file.tick(3, 100.04, Inbox(), None)
    file.close()
    (recording,) = recordings(tmp_path, lines.append)
    ticks = list(recording.ticks(lines.append))
    assert [(tick.number, bool(tick.output)) for tick in ticks] == [(1, False), (2, True), (3, False)]


# ------------------------------------------------------------ truncated and damaged files


def chunk_places(data: bytes) -> list[tuple[int, int]]:
    """Begin and end of each chunk record."""
    places, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == Opcode.CHUNK:
            places.append((at, at + 9 + length))
        at += 9 + length
    return places


def test_a_truncated_file_gives_all_ticks_before(tmp_path: Path, lines: list[str]) -> None:
    path = write_ticks(tmp_path / "a.mcap", TICKS)
    data = path.read_bytes()
    *_, (_, end_before), (begin, end) = chunk_places(data)
    for cut in (end_before, begin + 3, begin + 100, end - 1):
        path.write_bytes(data[:cut])
        lines.clear()
        (recording,) = recordings(tmp_path, lines.append)
        numbers = read_numbers(recording, lines.append)
        assert numbers == list(range(1, len(numbers) + 1))
        assert len(numbers) > 200
        assert len(lines) == 1
        assert "without its end" in lines[0]
        assert "damaged" not in lines[0]


def test_damage_in_the_middle_loses_only_what_it_hits(tmp_path: Path, lines: list[str]) -> None:
    path = write_ticks(tmp_path / "a.mcap", TICKS)
    data = path.read_bytes()
    begin, end = chunk_places(data)[2]
    length_of_it = struct.pack("<Q", 10**18)
    damages = {
        "content": data[: begin + 80] + b"\0" * 20 + data[begin + 100 :],
        "zeros": data[:begin] + bytes(end - begin) + data[end:],
        "missing": data[:begin] + data[begin + 50 :],
        "long": data[: begin + 1] + length_of_it + data[begin + 9 :],
        "short": data[: begin + 1] + struct.pack("<Q", 60) + data[begin + 9 :],
    }
    for name, damaged in damages.items():
        path.write_bytes(damaged)
        lines.clear()
        (recording,) = recordings(tmp_path, lines.append)
        numbers = read_numbers(recording, lines.append)
        assert numbers[0] == 1, name
        assert numbers[-1] == 300, name
        assert numbers == sorted(set(numbers)), name
        assert 200 < len(numbers) < 300, name
        assert len(lines) == 1, name
        assert f"the first at byte {begin}" in lines[0] or name == "short", name
        with pytest.raises(MissingTicksError):
            list(recording.ticks(lines.append))


def test_without_the_first_chunk_the_summary_names_the_topics(tmp_path: Path, lines: list[str]) -> None:
    path = write_ticks(tmp_path / "a.mcap", TICKS)
    data = path.read_bytes()
    begin, end = chunk_places(data)[0]
    path.write_bytes(data[:begin] + bytes(end - begin) + data[end:])
    (recording,) = recordings(tmp_path, lines.append)
    assert read_numbers(recording, lines.append)[-1] == 300
    assert len(lines) == 1
    path.write_bytes(data[:begin] + bytes(end - begin) + data[end:-500])
    assert read_numbers(recording, lines.append) == []
    assert "messages of unknown topics" in lines[1]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_ticks(tmp_path_factory.mktemp("whole") / "a.mcap", range(1, 101)).read_bytes()


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_damage_leaves_right_ticks_or_none(whole: bytes, data: st.DataObject, tmp_path: Path) -> None:
    """Whatever is overwritten, what is read is what was recorded: chunks have a check sum."""
    at = data.draw(st.integers(0, len(whole) - 1))
    other = data.draw(st.binary(min_size=1, max_size=30))
    (tmp_path / "a.mcap").write_bytes(whole[:at] + other + whole[at + len(other) :])
    lines: list[str] = []
    try:
        (recording,) = recordings(tmp_path, lines.append)
    except RecordingError:
        assert len(lines) == 1
        return
    numbers = read_numbers(recording, lines.append)
    assert set(numbers) <= set(range(1, 101))
    assert len(numbers) == 100 or lines


def test_a_message_that_is_none_is_left_out_with_a_line(tmp_path: Path, lines: list[str]) -> None:
    file = RecordingFile(tmp_path / "a.mcap")
    for number, data in enumerate((b"{}", b"[1", b'{"code":1,"text":"a"}'), 1):
        file.raw(EVENT, time_of(number), data)
    file.write(EVENT, 101.0, Notice(Code.PEER_STALE, "text"))
    file.raw(OUTBOX, 102.0, b"garbage", 1)
    file.close()
    (recording,) = recordings(tmp_path, lines.append)
    assert [message.value.text for message in recording.read([EVENT], lines.append)] == ["text"]
    assert len(lines) == 1
    assert "3 messages cannot be read, the first of /event" in lines[0]


# ------------------------------------------------------------ files of others, hostile files


def other_program(path: Path) -> None:
    writer = Writer(str(path))
    writer.start()
    channel = writer.register_channel("/tf", "ros1", writer.register_schema("tf", "ros1msg", b""))
    writer.add_message(channel, 1, b"data", 1)
    writer.finish()


def newer(path: Path) -> None:
    write_ticks(path, [1], replace(HEADER, version=99))


def bad_header(path: Path) -> None:
    write_ticks(path, [1], replace(HEADER, part=10**12))


def empty(path: Path) -> None:
    path.write_bytes(b"")


def text(path: Path) -> None:
    path.write_text("hello, this is a text\n" * 100)


def only_magic(path: Path) -> None:
    path.write_bytes(MAGIC)


def huge_lengths(path: Path) -> None:
    path.write_bytes(MAGIC + (b"\x0c" + struct.pack("<Q", 2**63)) * 10)


def huge_inner_lengths(path: Path) -> None:
    content = struct.pack("<I", 2**32 - 1) + b"name" * 10
    path.write_bytes(MAGIC + struct.pack("<BQ", Opcode.METADATA, len(content)) + content)


def pipe(path: Path) -> None:
    os.mkfifo(path)


def folder(path: Path) -> None:
    path.mkdir()


def nowhere(path: Path) -> None:
    path.symlink_to(path.parent / "missing")


def test_a_single_file_that_is_no_recording_is_told_what_is_expected(tmp_path: Path, lines: list[str]) -> None:
    (tmp_path / "notes.txt").write_text("no recording")
    with pytest.raises(RecordingError, match=r"notes\.txt: no recording of an agent; give a file \*\.mcap of a flight"):
        recordings(tmp_path / "notes.txt", lines.append)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (other_program, "not a recording of an agent"),
        (newer, "version 99 of the format, expected 1"),
        (bad_header, "header is not valid"),
        (empty, "not an MCAP file"),
        (text, "not an MCAP file"),
        (only_magic, "not a recording of an agent"),
        (huge_lengths, "not a recording of an agent"),
        (huge_inner_lengths, "header is damaged"),
        (pipe, "not a regular file"),
        (folder, "not a regular file"),
        (nowhere, "No such file"),
    ],
)
def test_a_file_that_cannot_be_used_is_one_line_beside_the_others(
    make: Callable[[Path], None], reason: str, tmp_path: Path, lines: list[str]
) -> None:
    make(tmp_path / "bad.mcap")
    with pytest.raises(RecordingError, match="none of its 1"):
        recordings(tmp_path, lines.append)
    write_ticks(tmp_path / "good.mcap", [1, 2])
    lines.clear()
    (recording,) = recordings(tmp_path, lines.append)
    assert len(lines) == 1
    assert "bad.mcap: " in lines[0]
    assert reason in lines[0]
    assert read_numbers(recording, lines.append) == [1, 2]


def chunk(compressed: bytes, claimed: int) -> bytes:
    content = (
        struct.pack("<QQQI", 0, 0, claimed, 0) + b"\x04\0\0\0zstd" + struct.pack("<Q", len(compressed)) + compressed
    )
    return struct.pack("<BQ", Opcode.CHUNK, len(content)) + content


@pytest.mark.parametrize("claimed", [1000, MAX_RECORD, 2**33])
def test_a_decompression_bomb_uses_little_memory(claimed: int, tmp_path: Path, lines: list[str]) -> None:
    path = write_ticks(tmp_path / "a.mcap", range(1, 101))
    data = path.read_bytes()
    compressor = zstandard.ZstdCompressor().compressobj()  # 512 MB of zeros
    bomb = b"".join(compressor.compress(bytes(2**20)) for _ in range(512)) + compressor.flush()
    _, end = chunk_places(data)[0]
    path.write_bytes(data[:end] + chunk(bomb, claimed) + data[end:])
    (recording,) = recordings(tmp_path, lines.append)
    tracemalloc.start()
    numbers = read_numbers(recording, lines.append)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert numbers == list(range(1, 101))
    assert peak < 4 * MAX_RECORD
    assert len(lines) == 1


def test_a_frame_that_claims_a_huge_size_is_not_believed(tmp_path: Path, lines: list[str]) -> None:
    """zstandard allocates what the frame claims where it is asked for all of it."""
    path = write_ticks(tmp_path / "a.mcap", range(1, 101))
    data = path.read_bytes()
    frame = b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 2**40) + b"\x01\x00\x00"
    _, end = chunk_places(data)[0]
    path.write_bytes(data[:end] + chunk(frame, 1000) + data[end:])
    (recording,) = recordings(tmp_path, lines.append)
    assert read_numbers(recording, lines.append) == list(range(1, 101))
    assert len(lines) == 1


def test_long_recordings_need_no_more_memory(tmp_path: Path, lines: list[str]) -> None:
    write_ticks(tmp_path / "a.mcap", range(1, 5001))
    (recording,) = recordings(tmp_path, lines.append)
    tracemalloc.start()
    assert sum(1 for _ in recording.ticks(lines.append)) == 5000
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 500_000


def test_a_folder_without_recordings_is_one_line(tmp_path: Path, lines: list[str]) -> None:
    with pytest.raises(RecordingError, match="no recordings here"):
        recordings(tmp_path, lines.append)
    with pytest.raises(RecordingError, match="no such folder"):
        recordings(tmp_path / "missing", lines.append)


def test_names_of_files_cannot_control_a_terminal(tmp_path: Path, lines: list[str]) -> None:
    (tmp_path / "a\x1b[2J.mcap").write_bytes(b"")
    with pytest.raises(RecordingError):
        recordings(tmp_path, lines.append)
    assert lines[0].isprintable()
