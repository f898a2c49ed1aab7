"""Recorder on the ground: the statuses of all vehicles as they are received, and the commands as they are given."""

from __future__ import annotations

from pathlib import Path

from msgspec.structs import replace

from companion.config.fleet import FleetConfig
from companion.recording.codec import encode
from companion.recording.configuration import as_json
from companion.recording.records import GROUND_COMMAND, GROUND_STATUS, SOFTWARE, Header
from companion.recording.writer.chunk import MessageChunk
from companion.recording.writer.drops import DropReport
from companion.recording.writer.files import PartFiles
from companion.recording.writer.folder import GROUND, MB, MCAP, FlightFiles
from companion.recording.writer.mcap_part import McapPart
from companion.recording.writer.stream import MessageStream
from companion.recording.writer.writing import Writing
from companion.types.commands import Command
from companion.types.notices import Notice
from companion.wire.messages import StatusReport

GROUND_TOPICS = (GROUND_STATUS, GROUND_COMMAND)
KEEP_MB, PART_MB = 2000, 50


class GroundRecorder:
    """Records one start of a program on the ground. Times are of its monotonic clock; `sequence` counts the messages.

    All methods are called in one thread, `step` once a second.
    """

    def __init__(self, header: Header, files: PartFiles[MessageChunk], writing: Writing) -> None:
        self._writing = writing
        self._stream = MessageStream(header, GROUND_TOPICS, files, writing)
        self._drops = DropReport(writing)
        self._messages = 0

    def status(self, report: StatusReport, now_s: float) -> None:
        """Record a status when it is received."""
        self._add(GROUND_STATUS, now_s, encode(report))

    def command(self, command: Command, now_s: float) -> None:
        """Record a command when it is given."""
        self._add(GROUND_COMMAND, now_s, encode(command))

    def step(self, now_s: float) -> Notice | None:
        """Hand on what is a second old, also where nothing more comes. Returns what is to be reported of the recording."""
        self._stream.hand_on(now_s)
        return self._drops.step(now_s)

    def close(self) -> None:
        """Write what there is and end the file."""
        self._stream.flush()
        self._writing.close()

    def _add(self, topic: str, now_s: float, data: bytes) -> None:
        self._messages += 1
        self._stream.add(topic, self._messages, now_s, data)


def ground_recorder(
    fleet_name: str, fleet: FleetConfig | None, folder: Path, unix_s: float, monotonic_s: float, writing: Writing
) -> GroundRecorder:
    """A recorder into this folder. `fleet` is None where the program has no fleet file.

    `unix_s` and `monotonic_s` are the same moment. No file is made before the first record.
    """
    header = Header(
        software=SOFTWARE,
        fleet=fleet_name,
        vehicle_id=0,
        session=0,
        part=1,
        unix_s=unix_s,
        monotonic_s=monotonic_s,
        fleet_file=as_json(fleet) if fleet else "",
        vehicle_file="",
    )
    flight = FlightFiles(folder, GROUND, KEEP_MB * MB)
    return GroundRecorder(
        header,
        PartFiles(flight, MCAP, PART_MB * MB, lambda part: McapPart(replace(header, part=part), GROUND_TOPICS)),
        writing,
    )
