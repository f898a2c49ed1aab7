"""Findings of the flight itself: failsafes, refused commands, lost peers, vehicles too close to each other."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence

import numpy as np

from companion.config.fleet import FleetConfig
from companion.core.safety.failsafe import FAILSAFES, STOP, FailsafeSettings, schedule
from companion.report.distances import PairDistance
from companion.report.findings import Episode, Finding, FindingKind, Severity, finding, runs
from companion.report.flight import Bools, FlightRecords, Floats, GivenCommand, VehicleLog
from companion.types.code_table import code_entries
from companion.types.flight import FLAG_TEXTS, STREAMING, FailsafeAction, HealthFlag
from companion.types.notices import Code

SAME_TICK_S = 0.005  # an event this near to a tick belongs to it
GIVEN_AGAIN_S = 5.0  # a refused command that is accepted within this time is information
LOST_S = 0.25  # in three reports in a row
LOST_APART_S = 1.0
REPORT_S = 0.35  # a report counts until the next one, at most for this time
ENCOUNTERS_APART_S = 2.0  # what is nearer again within this time is the same encounter
FLAGS_APART_S = 2.0  # a flag that comes and goes within this time is one finding
IN_EVERY_PHASE = frozenset(code for code, entry in code_entries().items() if entry.in_every_phase)
STOPPING_FLAGS = frozenset(row.condition for row in FAILSAFES if STOP in row.steps)
STREAMING_PHASES = tuple(str(phase) for phase in STREAMING)


def settings_of(fleet: FleetConfig | None) -> FailsafeSettings:
    """What the fleet file chooses; the defaults without one."""
    if fleet is None:
        return FailsafeSettings()
    action = FailsafeAction[fleet.low_battery_action.upper()]
    return FailsafeSettings(action, fleet.land_after_s, fleet.leader_holds_after_s)


def raised_flags(vehicle: VehicleLog, settings: FailsafeSettings) -> Iterator[Finding]:
    """One finding for each time a flag was raised in the air. Critical where a failsafe beyond a warning came due."""
    streaming = np.asarray(np.isin(vehicle.ticks.phase, STREAMING_PHASES), dtype=np.bool_)
    schedules = {HealthFlag(row.condition): schedule(row.steps, settings) for row in FAILSAFES}
    for flag in HealthFlag:
        raised = vehicle.ticks.flags.get(flag)
        # The positions of all vehicles show SEPARATION_VIOLATED better than one vehicle's view: see `closeness`.
        if raised is None or flag is HealthFlag.SEPARATION_VIOLATED:
            continue
        for episode in runs(vehicle.ticks.time_s, counts_of(vehicle, flag), FLAGS_APART_S):
            streamed = bool(streaming[episode.first : episode.last + 1].any())
            yield _of_flag(vehicle, flag, episode, _action(schedules[flag], episode, streamed))


def counts_of(vehicle: VehicleLog, flag: str) -> Bools:
    """Per tick: whether the flag is raised where it counts: on the ground most flags are expected."""
    streaming = np.isin(vehicle.ticks.phase, STREAMING_PHASES)
    return np.asarray(
        vehicle.ticks.flags[flag] & vehicle.in_air() & (streaming | (flag in IN_EVERY_PHASE)), dtype=np.bool_
    )


def _action(steps: tuple[tuple[float, FailsafeAction], ...], episode: Episode, streaming: bool) -> FailsafeAction:
    """The strongest step that came due while the flag was raised; a warning where no step is taken.

    The steps count from when the flag is raised: once it is cleared, they begin again.
    """
    due = [action for due_s, action in steps if due_s <= episode.longest_s + 0.02]
    return max(due, default=FailsafeAction.WARN) if streaming else FailsafeAction.WARN


def _of_flag(vehicle: VehicleLog, flag: HealthFlag, episode: Episode, action: FailsafeAction) -> Finding:
    beyond = action not in (FailsafeAction.NONE, FailsafeAction.WARN, FailsafeAction.STOP_STREAM)
    text = f"{FLAG_TEXTS[flag]} {episode.duration_text}"
    if beyond:
        text += f"; failsafe: {action.name.lower()}"
    elif action is FailsafeAction.STOP_STREAM:
        text += "; no setpoint was sent in that time"
    severity = Severity.CRITICAL if beyond else Severity.WARNING
    begins_s = episode.interval.begins_s
    return finding(Code(flag), vehicle.vehicle_id, begins_s, text, lasts_s=episode.held_s, severity=severity)


def failsafe_events(vehicle: VehicleLog) -> Iterator[Finding]:
    """Events that are findings by themselves."""
    for event in vehicle.events:
        entry = code_entries().get(event.code)
        if entry and entry.event:
            yield finding(event.code, vehicle.vehicle_id, event.time_s, event.text)


def streams_ended(vehicle: VehicleLog) -> Iterator[Finding]:
    """Events that end the setpoints of an agent in the air, because its input was not valid.

    `raised_flags` does not find them all: the flag may be raised in the tick of the event alone.
    """
    streaming = np.isin(vehicle.ticks.phase, STREAMING_PHASES)
    ended = np.flatnonzero(streaming[:-1] & ~streaming[1:]) + 1
    ended_s = vehicle.ticks.time_s[ended[vehicle.in_air()[ended]]]
    for event in vehicle.events:
        if event.code in STOPPING_FLAGS and _is_near(ended_s, event.time_s):
            yield finding(
                event.code,
                vehicle.vehicle_id,
                event.time_s,
                event.text,
                kind=FindingKind.FAILSAFE,
                severity=Severity.CRITICAL,
            )


def _is_near(times_s: Floats, time_s: float) -> bool:
    """Whether one of these rising times is within SAME_TICK_S."""
    row = int(np.searchsorted(times_s, time_s - SAME_TICK_S, side="right"))
    return row < times_s.size and bool(times_s[row] < time_s + SAME_TICK_S)


def disarmed_in_air(vehicle: VehicleLog) -> Iterator[Finding]:
    """The autopilot disarmed while it reported to be in the air."""
    statuses = vehicle.statuses
    fell = np.flatnonzero(statuses.armed[:-1] & ~statuses.armed[1:] & statuses.in_air[:-1] & statuses.in_air[1:])
    for row in fell:
        time_s = float(statuses.time_s[row + 1])
        text = f"disarmed in the air, {_height_text(vehicle, time_s)}, in mode {statuses.mode[row]}"
        yield finding(Code.AUTOPILOT_DISARMED, vehicle.vehicle_id, time_s, text)


def _height_text(vehicle: VehicleLog, time_s: float) -> str:
    height_m = float(np.interp(time_s, vehicle.ticks.time_s, vehicle.ticks.position_enu_m[:, 2]))
    return "at an unknown height" if np.isnan(height_m) else f"{height_m:.1f} m above the origin"


def refused_commands(vehicle: VehicleLog) -> Iterator[Finding]:
    """One finding for each command; its code is that of the answer. One that was accepted soon after is information."""
    accepted_s: dict[tuple[str, str], list[float]] = {}
    for one in sorted(vehicle.commands, key=lambda command: command.time_s):
        if one.accepted:
            accepted_s.setdefault((one.name, one.operator), []).append(one.time_s)
    for command in vehicle.commands:
        label = f"command {command.name} (number {command.number}, {command.operator})"
        if command.answered_s is None:
            text = f"{label} has no recorded answer"
            yield finding(Code.NO_REPLY, vehicle.vehicle_id, command.time_s, text)
        elif not command.accepted and command.code is not None:
            again_s = _accepted_after_s(accepted_s.get((command.name, command.operator), []), command)
            text = f"{label} refused: {command.text}" + ("" if again_s is None else f"; accepted {again_s:.1f} s later")
            severity = Severity.WARNING if again_s is None else Severity.INFO
            yield finding(
                command.code, vehicle.vehicle_id, command.time_s, text, kind=FindingKind.REFUSED, severity=severity
            )


def _accepted_after_s(accepted_s: Sequence[float], refused: GivenCommand) -> float | None:
    """After what time it was given again with success, by the rising times at which it was; None if not soon."""
    row = bisect_left(accepted_s, refused.time_s)
    again_s = accepted_s[row] - refused.time_s if row < len(accepted_s) else GIVEN_AGAIN_S + 1.0
    return again_s if again_s <= GIVEN_AGAIN_S else None


def lost_peers(flight: FlightRecords) -> Iterator[Finding]:
    """One finding for each time a vehicle did not receive another one that was in the air and had been received before."""
    for vehicle in flight.vehicles:
        for other in flight.vehicles:
            if other is not vehicle:
                yield from _lost(vehicle, other)


def _lost(vehicle: VehicleLog, other: VehicleLog) -> Iterator[Finding]:
    statuses = vehicle.statuses
    fresh = np.array([other.vehicle_id in peers for peers in statuses.peers], dtype=np.bool_)
    if not fresh.any():
        return
    known = np.arange(fresh.size) > int(np.argmax(fresh))
    missing = ~fresh & known & statuses.in_air & other.in_air_at(statuses.time_s)
    for episode in runs(statuses.time_s, missing, LOST_APART_S, REPORT_S):
        if episode.longest_s >= LOST_S:
            text = f"no packets of vehicle {other.vehicle_id} {episode.duration_text}"
            ended_s = _last_record_s(other, episode.interval.ends_s)
            if episode.interval.ends_s - ended_s > REPORT_S:
                text += f"; its records end at {ended_s:.1f} s, in the air"
            begins_s = episode.interval.begins_s
            yield finding(Code.PEER_STALE, vehicle.vehicle_id, begins_s, text, lasts_s=episode.held_s)


def _last_record_s(vehicle: VehicleLog, until_s: float) -> float:
    """Time of its last tick up to a time, of which there is at least one."""
    own_s = vehicle.ticks.time_s
    return float(own_s[np.searchsorted(own_s, until_s, side="right") - 1])


def too_close(pairs: Sequence[PairDistance], separation_m: float | None) -> Iterator[Finding]:
    """One finding for each encounter. None can be judged without `separation_m`."""
    if separation_m is None:
        return
    for pair in pairs:
        distance_m = np.where(pair.judged, pair.distance_m, np.inf)
        for episode in runs(pair.time_s, distance_m < separation_m, ENCOUNTERS_APART_S):
            row = episode.first + int(np.argmin(distance_m[episode.first : episode.last + 1]))
            a, b = pair.pair
            text = (
                f"vehicles {a} and {b} were {distance_m[row]:.2f} m apart at {pair.time_s[row]:.1f} s,"
                f" separation_m is {separation_m:g} m"
            )
            yield finding(Code.SEPARATION_VIOLATED, a, episode.interval.begins_s, text, lasts_s=episode.held_s)
