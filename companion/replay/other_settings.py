"""A recording, replayed with other settings: what the agent would have commanded in each recorded situation.

The inputs stay those of the flight: the vehicle does not fly by the other commands, nor do the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import degrees, sqrt

from msgspec import Struct

from companion.assembly import build_agent
from companion.core.agent import Agent
from companion.recording.codec import RecordError
from companion.recording.configuration import recorded_config
from companion.recording.mcap_file import Warn
from companion.recording.reader import MissingTicksError, RecordedTick, Recording
from companion.replay.same_settings import Progress
from companion.types.autopilot import AttitudeTarget
from companion.types.errors import CompanionError
from companion.wire.rounding import as_sent


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
    first_tick: int | None  # of a difference
    first_s: float | None  # the same, since the first tick
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
        return as_sent(agent.step(tick.now_s, tick.inbox)).attitude_target
    except Exception as error:
        raise _AgentFailedError(f"the agent fails at tick {tick.number}: {type(error).__name__}: {error}") from error
