"""What passes between vehicles and ground: status reports, commands and their answers. MessagePack maps."""

from __future__ import annotations

import msgspec

from companion.types.commands import CONTENT, Command, CommandReply, ReferenceChange
from companion.types.notices import Code
from companion.types.peers import TargetSample, TrafficSample
from companion.types.status import Status
from companion.types.values import Finite, Number
from companion.wire.version import WireError, seal, unsealed


class Percentiles(msgspec.Struct, frozen=True, gc=False):
    """Of one measured time in microseconds."""

    p50: Finite
    p99: Finite
    max: Finite


class Timing(msgspec.Struct, frozen=True, gc=False):
    """How well an agent keeps its 50 Hz, counted since it entered formation (or since its start).

    `late_us`: start of a tick after its due time, one period after the tick before. `missed`: periods without a tick,
    that is how many more periods went by than ticks came; it never falls.
    `telemetry_to_command_us`: from a position's arrival at the socket to its setpoint handed to the socket.
    """

    rate_hz: Finite
    ticks: Number
    missed: Number
    late_us: Percentiles
    telemetry_to_command_us: Percentiles
    cpu_percent: Finite
    rss_mb: Finite


class StatusReport(msgspec.Struct, frozen=True, gc=False):
    """One vehicle's status with its timing."""

    status: Status
    timing: Timing


_encoder = msgspec.msgpack.Encoder()
_report_decoder = msgspec.msgpack.Decoder(StatusReport)
_command_decoder = msgspec.msgpack.Decoder(Command)
_reply_decoder = msgspec.msgpack.Decoder(CommandReply)


def encode(message: StatusReport | Command | CommandReply | TargetSample | TrafficSample) -> bytes:
    """The message as a MessagePack map behind the version byte."""
    return seal(_encoder.encode(message))


def decode_report(data: bytes) -> StatusReport:
    """Raises WireError."""
    return unsealed(_report_decoder, data, Code.REPORT_MALFORMED, "status report")


def decode_command(data: bytes) -> Command:
    """Raises WireError."""
    command = unsealed(_command_decoder, data, Code.COMMAND_MALFORMED, "command")
    wanted = CONTENT.get(command.name, type(None))
    if not isinstance(command.content, wanted):
        raise WireError(
            Code.COMMAND_MALFORMED,
            f"command {command.name} with {type(command.content).__name__}, expected {wanted.__name__}",
        )
    if isinstance(command.content, ReferenceChange):
        for value in command.content.reference.values():
            if isinstance(value, str) and not value.isprintable():  # it is part of replies and logs
                raise WireError(Code.COMMAND_MALFORMED, "command reference with control characters")
    return command


def decode_reply(data: bytes) -> CommandReply:
    """Raises WireError."""
    return unsealed(_reply_decoder, data, Code.REPORT_MALFORMED, "command reply")
