"""A recording, replayed with its own configuration: every output of the agent must be the recorded one."""

from __future__ import annotations

from collections.abc import Callable

from msgspec import Struct

from companion.assembly import build_agent
from companion.core.agent import Agent
from companion.recording.codec import RecordError, encode_outbox
from companion.recording.configuration import recorded_config
from companion.recording.mcap_file import Warn
from companion.recording.reader import MissingTicksError, RecordedTick, Recording
from companion.replay.differences import Difference, first_difference
from companion.wire.rounding import as_sent

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
                    field=found.field,
                    recorded=found.recorded,
                    computed=found.computed,
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
        computed = as_sent(agent.step(tick.now_s, tick.inbox))
    except Exception as error:  # noqa: BLE001 -- a defect of the agent is what a replay is to find
        return Difference("the agent", "an output" if tick.output else "no output", f"{type(error).__name__}: {error}")
    if not tick.output or encode_outbox(tick.now_s, computed) == tick.output:
        return None
    return first_difference(tick.outbox(), computed)
