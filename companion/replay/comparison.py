"""A recording, fed to an agent again.

With its own configuration every output must be the recorded one, bit for bit. With other settings the result is what the agent
would have commanded in each recorded situation: the inputs stay those of the flight, as the vehicle does not fly by the other
commands, nor do the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from math import degrees, sqrt
from typing import Any, NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from companion.assembly import build_agent
from companion.core.agent import Agent
from companion.recording.codec import RecordError, encode_outbox, recorded_config
from companion.recording.mcap_file import Warn
from companion.recording.reader import MissingTicksError, RecordedTick, Recording
from companion.types.autopilot import AttitudeTarget
from companion.types.errors import CompanionError
from companion.types.status import Status
from companion.types.tick import Outbox
from companion.wire.rounding import round_outbox

Progress = Callable[[int, float], None]
"""Called with the number of ticks replayed so far, and the time of the last one since the first."""


class FirstDifference(Struct, frozen=True, kw_only=True):
    """`time_s`: since the first tick. `utc_s`: by the clock of the vehicle. `recorded`, `computed`: as text."""

    tick: int
    time_s: float
    utc_s: float
    field: str
    recorded: str
    computed: str


class ReplayResult(Struct, frozen=True, kw_only=True):
    """`ticks`: those that were compared, the different one among them. `unusable`: why there are no more, "" at the end.

    `not_recorded`: ticks whose output is not in the recording.
    """

    vehicle_id: int
    session: int
    software: str
    ticks: int
    not_recorded: int = 0
    difference: FirstDifference | None = None
    unusable: str = ""


def replay(recording: Recording, progress: Progress, warn: Warn) -> ReplayResult:
    """Feeds every recorded input to the agent until an output differs. Raises ConfigError for an unusable configuration."""
    header = recording.header
    agent = build_agent(recorded_config(recording.parts[0].path, header), header.session)
    ticks = not_recorded = 0
    begin_s, difference, unusable = None, None, ""
    try:
        for tick in recording.ticks(warn):
            begin_s = tick.now_s if begin_s is None else begin_s
            found = _compared(agent, tick)
            ticks += 1
            not_recorded += not tick.output
            progress(ticks, tick.now_s - begin_s)
            if found:
                difference = FirstDifference(
                    tick=tick.number,
                    time_s=round(tick.now_s - begin_s, 6),
                    utc_s=round(header.unix_s + tick.now_s - header.monotonic_s, 6),
                    **found._asdict(),
                )
                break
    except (MissingTicksError, RecordError) as error:
        unusable = str(error)
    return ReplayResult(
        vehicle_id=header.vehicle_id,
        session=header.session,
        software=header.software,
        ticks=ticks,
        not_recorded=not_recorded,
        difference=difference,
        unusable=unusable or ("" if ticks else "no ticks are recorded"),
    )


def _compared(agent: Agent, tick: RecordedTick) -> Difference | None:
    try:
        computed = round_outbox(agent.step(tick.now_s, tick.inbox))
    except Exception as error:  # noqa: BLE001 -- a defect of the agent is what a replay is to find
        return Difference("the agent", "an output" if tick.output else "no output", f"{type(error).__name__}: {error}")
    if not tick.output or encode_outbox(tick.now_s, computed) == tick.output:
        return None
    return first_difference(tick.outbox(), computed)


class Deviation(Struct, frozen=True):
    """Of the other command from the recorded one, over the ticks with both."""

    largest: float = 0.0
    rms: float = 0.0


class SettingsComparison(Struct, frozen=True, kw_only=True):
    """`commands`: ticks with a setpoint in both. `unusable`: why there are no more ticks, "" at the end of the recording."""

    vehicle_id: int
    session: int
    ticks: int
    commands: int
    only_recorded: int  # ticks with a setpoint in the recording alone
    only_computed: int
    roll_deg: Deviation
    pitch_deg: Deviation
    thrust_norm: Deviation
    first_tick: int | None  # first tick with a difference
    first_s: float | None  # time of that tick since the first one
    unusable: str = ""


class CommandPair(Struct, frozen=True):
    """The commands of one tick. `time_s`: since the first tick."""

    vehicle_id: int
    session: int
    time_s: float
    recorded: AttitudeTarget | None
    computed: AttitudeTarget | None


class _AgentFailedError(CompanionError):
    """str() says where and why."""


class _Sums:
    """The largest and the mean square of differences."""

    def __init__(self) -> None:
        self._largest = self._squares = 0.0
        self._count = 0

    def add(self, difference: float) -> None:
        self._largest = max(self._largest, abs(difference))
        self._squares += difference * difference
        self._count += 1

    def deviation(self) -> Deviation:
        return Deviation(self._largest, sqrt(self._squares / self._count)) if self._count else Deviation()


class _Commands:
    """Compares the commands of the ticks, one after the other."""

    def __init__(self) -> None:
        self.roll_deg, self.pitch_deg, self.thrust_norm = _Sums(), _Sums(), _Sums()
        self.both = self.only_recorded = self.only_computed = 0

    def add(self, recorded: AttitudeTarget | None, computed: AttitudeTarget | None) -> None:
        if recorded and computed:
            self.both += 1
            self.roll_deg.add(degrees(computed.roll_rad - recorded.roll_rad))
            self.pitch_deg.add(degrees(computed.pitch_rad - recorded.pitch_rad))
            self.thrust_norm.add(computed.thrust_norm - recorded.thrust_norm)
        elif recorded:
            self.only_recorded += 1
        elif computed:
            self.only_computed += 1


def compare(
    recording: Recording, overrides: Sequence[str], row: Callable[[CommandPair], None], progress: Progress, warn: Warn
) -> SettingsComparison:
    """Feeds every recorded input to an agent with these settings. `row` gets the commands of each tick. Raises ConfigError."""
    header, path = recording.header, recording.parts[0].path
    formation_hash = recorded_config(path, header).fleet.formation_hash()
    agent = build_agent(recorded_config(path, header, overrides), header.session, formation_hash)
    commands, ticks, begin_s, first, unusable = _Commands(), 0, 0.0, None, ""
    try:
        for tick in recording.ticks(warn):
            begin_s = begin_s if ticks else tick.now_s
            ticks += 1
            computed = _command(agent, tick)
            if not tick.output:
                continue
            recorded = tick.outbox().attitude_target
            commands.add(recorded, computed)
            if first is None and recorded != computed:
                first = (tick.number, round(tick.now_s - begin_s, 6))
            row(CommandPair(header.vehicle_id, header.session, round(tick.now_s - begin_s, 6), recorded, computed))
            progress(ticks, tick.now_s - begin_s)
    except (MissingTicksError, RecordError, _AgentFailedError) as error:
        unusable = str(error)
    return SettingsComparison(
        vehicle_id=header.vehicle_id,
        session=header.session,
        ticks=ticks,
        commands=commands.both,
        only_recorded=commands.only_recorded,
        only_computed=commands.only_computed,
        roll_deg=commands.roll_deg.deviation(),
        pitch_deg=commands.pitch_deg.deviation(),
        thrust_norm=commands.thrust_norm.deviation(),
        first_tick=first[0] if first else None,
        first_s=first[1] if first else None,
        unusable=unusable,
    )


def _command(agent: Agent, tick: RecordedTick) -> AttitudeTarget | None:
    """Raises _AgentFailedError."""
    try:
        return round_outbox(agent.step(tick.now_s, tick.inbox)).attitude_target
    except Exception as error:
        raise _AgentFailedError(f"the agent fails at tick {tick.number}: {type(error).__name__}: {error}") from error


LONGEST = 100  # characters of a value that is shown
MISSING = "none"


class Difference(NamedTuple):
    """`field` is the path, like attitude_target.roll_rad; the values are as text, with all digits."""

    field: str
    recorded: str
    computed: str


def first_difference(recorded: Outbox, computed: Outbox) -> Difference | None:
    """In the order of an Outbox; None if they are equal.

    Of the rejected messages a recording has more: those refused before they came to the agent are not part of its input.
    """
    if recorded.status and computed.status and _no_more(computed.status, recorded.status):
        computed = replace(computed, status=replace(computed.status, rejected=recorded.status.rejected))
    return next(_differences("", recorded, computed), None)


def _no_more(computed: Status, recorded: Status) -> bool:
    return all(count <= recorded.rejected.get(key, 0) for key, count in computed.rejected.items())


def _differences(field: str, recorded: Any, computed: Any) -> Iterator[Difference]:
    if isinstance(recorded, Struct) and type(recorded) is type(computed):
        for name in recorded.__struct_fields__:
            inner = f"{field}.{name}".lstrip(".")
            yield from _differences(inner, getattr(recorded, name), getattr(computed, name))
    elif isinstance(recorded, tuple | list) and isinstance(computed, tuple | list) and len(recorded) == len(computed):
        for index, (one, other) in enumerate(zip(recorded, computed, strict=True)):
            yield from _differences(f"{field}[{index}]", one, other)
    elif isinstance(recorded, Mapping) and isinstance(computed, Mapping):
        for key in sorted(recorded.keys() | computed.keys()):
            yield from _differences(f"{field}.{key}", recorded.get(key), computed.get(key))
    elif repr(recorded) != repr(computed):  # repr gives the shortest digits with the same bits
        yield Difference(field, _shown(recorded), _shown(computed))


def _shown(value: Any) -> str:
    if value is None:
        return MISSING
    text = repr(value.value if isinstance(value, Enum) else value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
