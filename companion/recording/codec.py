"""Messages of a recording <-> JSON, and the configuration in its header.

`/inbox` and `/outbox` are exact, also for NaN, infinity and -0.0: what is decoded is what was encoded. What is empty or None
is left out; telemetry, packets and the like are arrays (`exact_json.py`). The other messages are plain JSON. The header has
fleet file and vehicle file as JSON, with all defaults.

In MCAP: `log_time` is that of `log_time_ns`, and `sequence` of /inbox and /outbox is the number of the tick in its start, from
1, so that a reader sees a gap.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar, get_args

import msgspec
from msgspec import Struct
from msgspec.structs import fields

from companion.config.file import ConfigError, convert
from companion.config.fleet import FleetConfig
from companion.config.fleet_check import fleet_problems
from companion.config.named_files import changed
from companion.config.validation import Problem, each
from companion.config.values import Section
from companion.config.vehicle import AgentConfig, VehicleConfig, membership_problems
from companion.recording.exact_json import Form, decode_exact, encode_exact, form_of, has_not_finite
from companion.recording.records import FORMAT, FORMAT_VERSION, DecisionRecord, Header, TimingRecord
from companion.types.autopilot import AutopilotRequest
from companion.types.commands import Command, CommandReply
from companion.types.errors import CompanionError
from companion.types.notices import Notice
from companion.types.tick import Inbox, Outbox
from companion.types.values import MAX_VEHICLES
from companion.wire.messages import FlatReport, StatusReport, flat_report, report_of

T = TypeVar("T")
Tick = TypeVar("Tick", bound=Struct)
Message = DecisionRecord | TimingRecord | StatusReport | Notice | Command | CommandReply

LAST_S = 1e10  # latest time of any clock, the year 2286: its nanoseconds fit into an MCAP time
MAX_PART = 100_000

_REQUESTS = {type_.__name__: type_ for type_ in get_args(AutopilotRequest)}
DECODE_ERRORS = (msgspec.MsgspecError, ValueError, RecursionError, LookupError, AttributeError, TypeError)


class RecordError(CompanionError):
    """A message that cannot be decoded."""


class _TickCodec(Generic[Tick]):
    """Exact JSON of an Inbox or an Outbox with its time: an object with the fields that are not empty."""

    def __init__(self, type_: type[Tick]) -> None:
        forms: dict[str, Form[Any]] = {field.name: form_of(field.type, _REQUESTS) for field in fields(type_)}
        self._type = type_
        self._packs = [(name, form.pack) for name, form in forms.items()]
        self._unpacks = [(name, form.unpack) for name, form in forms.items()]
        self._wire: type[Any] = msgspec.defstruct(
            type_.__name__,
            [("now_s", float), *((field.name, forms[field.name].wire, field.default) for field in fields(type_))],
            forbid_unknown_fields=True,
        )
        self._decoder = msgspec.json.Decoder(self._wire)

    def encode(self, now_s: float, tick: Tick) -> bytes:
        """The message of the tick at `now_s`."""
        record: dict[str, Any] = {"now_s": now_s}
        for name, pack in self._packs:
            value = getattr(tick, name)
            if value or value.__class__ is float:  # 0.0 too: -0.0 is another number
                record[name] = pack(value) if pack else value
        return encode_exact(record)

    def decode(self, data: bytes) -> tuple[float, Tick]:
        """Time and content of a message. Raises RecordError."""
        try:
            exact = has_not_finite(data)
            wire: Any = msgspec.convert(decode_exact(data), self._wire) if exact else self._decoder.decode(data)
            values = {}
            for name, unpack in self._unpacks:
                value = getattr(wire, name)
                values[name] = unpack(value) if unpack and value is not None else value
            return wire.now_s, self._type(**values)
        except DECODE_ERRORS as error:
            raise RecordError(f"not an {self._type.__name__}: {_short(error)}") from error


_inbox, _outbox = _TickCodec(Inbox), _TickCodec(Outbox)
_encoder = msgspec.json.Encoder()

encode_inbox, decode_inbox = _inbox.encode, _inbox.decode  # the message of /inbox
encode_outbox, decode_outbox = _outbox.encode, _outbox.decode


def encode(message: Message) -> bytes:
    """A message of another topic. NaN and infinity become null."""
    return _encoder.encode(flat_report(message) if isinstance(message, StatusReport) else message)


class TopicDecoder(Generic[T]):
    """Decodes the messages of one topic: `TopicDecoder(Notice)` those of /event."""

    def __init__(self, type_: type[T]) -> None:
        self._type = type_
        self._decoder = msgspec.json.Decoder(type_)
        self._read: Callable[[Any], Any] = report_of if type_ is FlatReport else lambda message: message

    def decode(self, data: bytes) -> T:
        """The message. Raises RecordError."""
        try:
            message: T = self._read(self._decoder.decode(data))
            return message
        except DECODE_ERRORS as error:
            raise RecordError(f"not a {self._type.__name__}: {_short(error)}") from error


def log_time_ns(header: Header, now_s: float) -> int:
    """Unix time of a moment of the vehicle's monotonic clock, as MCAP holds it."""
    return round(header.unix_s * 1e9) + round((now_s - header.monotonic_s) * 1e9)


def monotonic_s(header: Header, time_ns: int) -> float:
    """The moment of the vehicle's monotonic clock, to the nanosecond."""
    return header.monotonic_s + (time_ns - round(header.unix_s * 1e9)) / 1e9


def metadata_of(header: Header) -> dict[str, str]:
    """The content of the MCAP metadata record, which has the name FORMAT."""
    return {field: str(getattr(header, field)) for field in header.__struct_fields__}


def header_of(metadata: Mapping[str, str]) -> Header:
    """The header of a recording. Raises RecordError, also for a newer version."""
    if metadata.get("format") != FORMAT:
        raise RecordError(f"not a recording of {FORMAT}")
    version = metadata.get("version", "")
    if version != str(FORMAT_VERSION):
        raise RecordError(
            f"version {version[:20]} of the format, expected {FORMAT_VERSION}; use the release that wrote it"
        )
    try:
        header = msgspec.convert(dict(metadata), Header, strict=False)
    except DECODE_ERRORS as error:
        raise RecordError(f"its header is not valid: {_short(error)}") from error
    if not (abs(header.unix_s) < LAST_S and abs(header.monotonic_s) < LAST_S):
        raise RecordError("its header is not valid: times out of range")
    if not (0 <= header.vehicle_id <= MAX_VEHICLES and 1 <= header.part <= MAX_PART):
        raise RecordError("its header is not valid: vehicle id or part out of range")
    return header


def _short(error: Exception) -> str:
    """The reason in one line; a value of a damaged message may be of any length."""
    return " ".join(str(error).split())[:200]


EXAMPLE = "fleet.law.name=average_22 or vehicle.drag_1_s=0.3"


class _Files(Section, frozen=True):
    fleet: FleetConfig
    vehicle: VehicleConfig


def as_json(file: FleetConfig | VehicleConfig) -> str:
    """For a header. The paths in a vehicle file are part of it; nothing that they name is."""
    return msgspec.json.encode(file).decode()


def recorded_fleet(path: Path, header: Header) -> FleetConfig:
    """The fleet file of a recording; `path` names the recording in errors. Raises ConfigError."""
    return convert(path, _plain(path, header.fleet_file, "fleet file"), FleetConfig, fleet_problems)


def recorded_config(path: Path, header: Header, overrides: Sequence[str] = ()) -> AgentConfig:
    """The configuration of a recorded agent, with overrides "fleet.KEY=VALUE" and "vehicle.KEY=VALUE".

    `path` names the recording in errors. Nothing that a vehicle file names is opened. Raises ConfigError.
    """
    files = {
        "fleet": _plain(path, header.fleet_file, "fleet file"),
        "vehicle": _plain(path, header.vehicle_file, "vehicle file"),
    }
    config = _checked(path, files, header.vehicle_id)
    if not overrides:
        return config
    return changed(files, overrides, EXAMPLE, lambda named, content: _checked(named, content, header.vehicle_id))


def _plain(path: Path, text: str, what: str) -> Any:
    try:
        return msgspec.json.decode(text)
    except DECODE_ERRORS as error:
        raise ConfigError(path, "", f"its {what} is not valid JSON") from error


def _checked(path: Path, files: dict[str, Any], vehicle_id: int) -> AgentConfig:
    def problems(read: _Files) -> Iterator[Problem]:
        yield from fleet_problems(read.fleet, "fleet.")
        yield from each(_of_vehicle(read.vehicle, read.fleet, vehicle_id))

    read = convert(path, files, _Files, problems)
    member = read.fleet.member(vehicle_id)
    assert member is not None, "a vehicle without a slot is a problem of its file"
    return AgentConfig(read.vehicle, read.fleet, member)


def _of_vehicle(vehicle: VehicleConfig, fleet: FleetConfig, vehicle_id: int) -> Iterator[Problem]:
    if vehicle.id != vehicle_id:
        yield Problem("vehicle.id", f"{vehicle.id} is not the vehicle that was recorded; expected {vehicle_id}")
    for problem in membership_problems(vehicle, fleet, Path("fleet")):
        yield Problem(f"vehicle.{problem.field}", problem.text)
