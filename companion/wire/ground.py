"""What passes between vehicles and ground: status reports, commands and their answers. MessagePack maps."""

from __future__ import annotations

import re
from typing import TypeVar

import msgspec

from companion.types import CONTENT, Command, CommandReply, Status
from companion.wire.version import DECODE_ERRORS, WireError, seal, unseal

T = TypeVar("T")

OPERATOR = r"[A-Za-z0-9][A-Za-z0-9_.@+-]{0,62}"  # it is shown on terminals and in logs
OPERATOR_WORDS = "1 to 63 letters, digits, _ . @ + -, a letter or digit first, like anna@ground"


class Percentiles(msgspec.Struct, frozen=True, gc=False):
    """Of one measured time in microseconds."""

    p50: float
    p99: float
    max: float


class Timing(msgspec.Struct, frozen=True, gc=False):
    """How well an agent keeps its 50 Hz, counted since it entered formation (or since its start).

    `late_us`: start of a tick after its due time, one period after the tick before. `missed`: periods without a tick,
    that is how many more periods went by than ticks came; it never falls.
    `telemetry_to_command_us`: from a position's arrival at the socket to its setpoint handed to the socket.
    """

    rate_hz: float
    ticks: int
    missed: int
    late_us: Percentiles
    telemetry_to_command_us: Percentiles
    cpu_percent: float
    rss_mb: float


class StatusReport(msgspec.Struct, frozen=True, gc=False):
    """One vehicle's status with its timing."""

    status: Status
    timing: Timing


_encoder = msgspec.msgpack.Encoder()
_report_decoder = msgspec.msgpack.Decoder(StatusReport)
_command_decoder = msgspec.msgpack.Decoder(Command)
_reply_decoder = msgspec.msgpack.Decoder(CommandReply)


def encode(message: StatusReport | Command | CommandReply) -> bytes:
    return seal(_encoder.encode(message))


def decode_report(data: bytes) -> StatusReport:
    """Raises WireError."""
    return _decode(_report_decoder, data, "status report")


def decode_command(data: bytes) -> Command:
    """Raises WireError."""
    command = _decode(_command_decoder, data, "command")
    wanted = CONTENT.get(command.name, type(None))
    if not isinstance(command.content, wanted):
        raise WireError(f"command {command.name} with {type(command.content).__name__}, expected {wanted.__name__}")
    if not re.fullmatch(OPERATOR, command.operator):
        raise WireError(f"command {command.name} of an operator without a proper name")
    if not 0 < command.number < 2**63:
        raise WireError(f"command {command.name} with a number out of range")
    return command


def decode_reply(data: bytes) -> CommandReply:
    """Raises WireError."""
    return _decode(_reply_decoder, data, "command reply")


def _decode(decoder: msgspec.msgpack.Decoder[T], data: bytes, what: str) -> T:
    try:
        return decoder.decode(unseal(data))
    except DECODE_ERRORS as error:
        raise WireError(f"malformed {what}") from error
