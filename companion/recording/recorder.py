"""Recorder of an agent: its inputs, decisions, timing and events; and of a program on the ground: statuses and commands.

It never raises and never waits for a disk.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import wraps
from math import inf
from pathlib import Path
from typing import Concatenate, NamedTuple, ParamSpec, TypeVar

from msgspec.structs import replace

from companion.config.fleet import FleetConfig
from companion.config.law import law_of
from companion.config.vehicle import AgentConfig
from companion.core.report import Decision
from companion.laws import Law
from companion.recording.codec import Message, as_json, encode, encode_inbox, encode_outbox, log_time_ns
from companion.recording.files import GROUND, MB, MCAP, TLOG, FlightFiles, PartFiles, TlogPart, stamp
from companion.recording.mcap_part import McapPart, MessageChunk, MessageStream
from companion.recording.records import (
    COMMAND,
    DECISION,
    EVENT,
    GROUND_COMMAND,
    GROUND_STATUS,
    INBOX,
    OUTBOX,
    REPLY,
    SOFTWARE,
    STATUS,
    TIMING,
    Header,
    TimingRecord,
    decision_record,
)
from companion.recording.writing import DropReport, Writing
from companion.types.commands import Command
from companion.types.notices import Notice
from companion.types.status import RecordingState
from companion.types.tick import Inbox, Outbox
from companion.wire.messages import StatusReport

# Ticks. One after the other they take half the time, as the processor still has code and data at hand.
ENCODED_TOGETHER = 10
TOPICS = (INBOX, OUTBOX, DECISION, TIMING, STATUS, EVENT, COMMAND, REPLY)
STATUS_PERIOD_S = 0.19  # shortest time between two without events: records every second one, even if slightly early
FAILED = RecordingState("dropping")

_log = logging.getLogger(__name__)


P = ParamSpec("P")
R = TypeVar("R")


def _harmless(method: Callable[Concatenate[Recorder, P], R]) -> Callable[Concatenate[Recorder, P], R | None]:
    """A defect in recording ends the recording, not the flight."""

    @wraps(method)
    def guarded(self: Recorder, /, *args: P.args, **kwargs: P.kwargs) -> R | None:
        if self.has_failed:
            return None
        try:
            return method(self, *args, **kwargs)
        except Exception as error:  # noqa: BLE001 -- whatever it is, the flight goes on
            self.has_failed = True
            _log.error("recording ends after a defect", exc_info=error)
            return None

    return guarded


class _Tick(NamedTuple):
    """A tick that is not encoded yet. All of it is frozen."""

    number: int
    now_s: float
    inbox: Inbox
    decision: Decision
    outbox: Outbox
    report: StatusReport | None
    timing: TimingRecord


class Recorder:
    """Records one start of an agent. `law` is the one flown; `tlog` are the files of raw MAVLink, if any."""

    def __init__(
        self,
        header: Header,
        law: Law,
        writing: Writing,
        mcap: PartFiles[MessageChunk],
        tlog: PartFiles[bytes] | None = None,
    ) -> None:
        self._header, self._law, self._writing, self._tlog = header, law, writing, tlog
        self._stream = MessageStream(header, TOPICS, mcap, writing)
        self._drops = DropReport(writing)
        self._waiting: list[_Tick] = []
        self._packets: list[bytes] = []
        self._status_s = -inf  # when a status was last recorded
        self.ticks = 0  # recorded or lost
        self.has_failed = False

    @property
    def records_mavlink(self) -> bool:
        """Whether `mavlink` keeps packets."""
        return self._tlog is not None

    @property
    def state(self) -> RecordingState:
        """For the status of the vehicle."""
        return FAILED if self.has_failed else self._drops.state

    @_harmless
    def tick(
        self,
        now_s: float,
        inbox: Inbox,
        decision: Decision,
        outbox: Outbox,
        report: StatusReport | None,
        timing: TimingRecord,
    ) -> Notice | None:
        """Record a tick, after all that it sends has left. Returns what is to be reported of the recording itself.

        `outbox` as it was sent (`wire/rounding.py`), `report` as published.
        """
        self.ticks += 1
        self._waiting.append(_Tick(self.ticks, now_s, inbox, decision, outbox, report, timing))
        # Commands may be large: a flood of them is encoded tick by tick.
        if len(self._waiting) < ENCODED_TOGETHER and not (inbox.commands or inbox.checks):
            return None
        self._encode_waiting()
        if not self._stream.hand_on(now_s):
            return None
        self._hand_on_packets()
        notice = self._drops.step(now_s)
        if notice:
            self._add(EVENT, self.ticks, now_s, notice)
        return notice

    @_harmless
    def failure(self, now_s: float, notice: Notice, begun: tuple[float, Inbox] | None) -> None:
        """Record why the agent ends. `begun`: time and input of the tick that failed, if one did; a replay fails in it too."""
        self._encode_waiting()
        if begun is not None:
            self.ticks += 1
            self._stream.add(INBOX, self.ticks, begun[0], encode_inbox(*begun))
        self._add(EVENT, self.ticks, now_s, notice)

    def mavlink(self, packet: bytes, now_s: float) -> None:
        """Record a MAVLink packet of either direction."""
        if self.has_failed:
            return
        self._packets.append(stamp(packet, log_time_ns(self._header, now_s) // 1000))

    @_harmless
    def close(self) -> None:
        """Write what there is and end the files."""
        self._encode_waiting()
        self._stream.flush()
        self._hand_on_packets()
        self._writing.close()

    def _encode_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for tick in waiting:
            self._encode(tick)

    def _encode(self, tick: _Tick) -> None:
        number, now_s, outbox, report = tick.number, tick.now_s, tick.outbox, tick.report
        self._stream.add(INBOX, number, now_s, encode_inbox(now_s, tick.inbox))
        self._stream.add(OUTBOX, number, now_s, encode_outbox(now_s, outbox))
        self._add(DECISION, number, now_s, decision_record(tick.decision, self._law))
        self._add(TIMING, number, now_s, tick.timing)
        for command in tick.inbox.commands:
            self._add(COMMAND, number, now_s, command)
        for reply in outbox.replies:
            self._add(REPLY, number, now_s, reply)
        for event in outbox.events:
            self._add(EVENT, number, now_s, event)
        if report and (outbox.events or now_s - self._status_s >= STATUS_PERIOD_S):
            self._status_s = now_s
            self._add(STATUS, number, now_s, report)

    def _add(self, topic: str, number: int, now_s: float, message: Message) -> None:
        """A message of the tick of this number."""
        self._stream.add(topic, number, now_s, encode(message))

    def _hand_on_packets(self) -> None:
        packets, self._packets = self._packets, []
        if self._tlog and packets:
            self._writing.put(self._tlog, b"".join(packets), len(packets))


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
    files = _mcap_files(FlightFiles(folder, GROUND, KEEP_MB * MB), PART_MB * MB, header, GROUND_TOPICS)
    return GroundRecorder(header, files, writing)


def recorder_of(
    config: AgentConfig, session: int, folder: Path, unix_s: float, monotonic_s: float, writing: Writing
) -> Recorder:
    """The recorder of an agent. `unix_s` and `monotonic_s` are the same moment. No file is made before the first record."""
    vehicle, settings = config.vehicle, config.vehicle.recording
    header = Header(
        software=SOFTWARE,
        fleet=config.fleet.name,
        vehicle_id=vehicle.id,
        session=session,
        part=1,
        unix_s=unix_s,
        monotonic_s=monotonic_s,
        fleet_file=as_json(config.fleet),
        vehicle_file=as_json(vehicle),
    )
    flight, part_bytes = FlightFiles(folder, f"vehicle_{vehicle.id}", settings.keep_mb * MB), settings.part_mb * MB
    mcap = _mcap_files(flight, part_bytes, header, TOPICS)
    tlog = PartFiles(flight, TLOG, part_bytes, lambda _part: TlogPart()) if settings.tlog else None
    return Recorder(header, law_of(config.fleet.law), writing, mcap, tlog)


def _mcap_files(flight: FlightFiles, part_bytes: int, header: Header, topics: Sequence[str]) -> PartFiles[MessageChunk]:
    return PartFiles(flight, MCAP, part_bytes, lambda part: McapPart(replace(header, part=part), topics))
