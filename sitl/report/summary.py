"""The summary of a flight: summary.json, the lines printed at its end, and whether the machine was too busy for real time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import msgspec
from msgspec import Struct

from companion.ground.answers import id_list
from companion.types.autopilot import AutopilotKind
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, Role
from companion.types.notices import Code
from companion.types.status import Status
from companion.wire.messages import Percentiles
from sitl.report.metrics import TrackSource

T = TypeVar("T")

SCHEMA = 1
MAX_EACH = 8  # vehicles or pairs whose figures are printed in one line


class TickFigures(Struct, frozen=True, kw_only=True):
    """How well an agent kept its 50 Hz in formation; times in microseconds."""

    rate_hz: float
    ticks: int
    missed: int
    late_us: Percentiles


class VehicleSummary(Struct, frozen=True, kw_only=True):
    """Figures of one vehicle, from its agent's status reports and its track.

    Timing is None without a report in formation, and in virtual time; `sensors` without a stand-in, `autopilot` where another
    program has started it, too.
    """

    id: int
    role: str
    autopilot: AutopilotKind | None = None
    sensors: str | None = None
    tick: TickFigures | None
    telemetry_to_command_us: Percentiles | None
    cpu_percent: float | None
    rss_mb: float | None
    final_error_m: float | None
    tracking_error_m: float | None  # about the RFT, second half of the formation: sitl/report/metrics.py
    behind_leader_m: float | None  # likewise about the leader, while it follows
    largest_step_deg: float | None  # of the commanded attitude, setpoint to setpoint
    filter_acted_s: float | None = None  # so long the separation filter changed what the law commanded, in formation
    rejected: dict[str, int]  # counted rejections by reason


class RunSummary(Struct, frozen=True, kw_only=True):
    """One flight. Figures of the formation are None if none was flown; `failure` is None for a flight without one.

    `real_time_factor`: seconds flown per second of computing time; None for real processes.
    `tracks`: the source of distances and errors: true positions, of stand-ins or of real autopilots in their own simulation, or
    the estimates of external autopilots. `sensors` and `seed` are those of stand-ins. `overload`: the agents' timing beyond
    the limits of real time, None within them.
    `largest_error_m` and `reference_moves` are those of FormationFigures. `under_way_s`: for each vehicle whose
    slot still moved to its place when the formation ended, for how long it would have moved.
    """

    schema: int = SCHEMA
    scenario: str
    law: str
    law_parameters: dict[str, bool | int | float | str]
    vehicles: list[VehicleSummary]
    tracks: TrackSource = "true"
    sensors: str | None
    seed: int | None
    failure: str | None
    flight_s: float
    real_time_factor: float | None = None
    duration_s: float | None
    pairs: list[str]  # of vehicles with the nearest slots
    wanted_distance_m: dict[str, float] | None
    max_distance_m: dict[str, float] | None
    min_distance_m: dict[str, float] | None
    final_distance_m: dict[str, float] | None
    reference_moves: bool | None = None
    settle_s: float | None
    largest_error_m: float | None = None
    under_way_s: dict[int, float] = {}
    final_error_m: float | None
    overload: str | None = None
    smallest_distance_m: float | None
    commands: list[CommandGiven]
    events: list[ReportedEvent]


def write_json(path: Path, content: object) -> None:
    path.write_bytes(msgspec.json.format(msgspec.json.encode(content), indent=2) + b"\n")


def read_summary(path: Path) -> RunSummary:
    """Read a summary.json that `write_json` wrote."""
    return msgspec.json.decode(path.read_bytes(), type=RunSummary)


def in_words(summary: RunSummary) -> str:
    """The result as a few printed lines."""
    landed = f"{'did not arrive, ' if summary.under_way_s else 'flown and '}landed in {summary.flight_s:.0f} s"
    head = f"{summary.scenario}, {summary.law}: {summary.failure or landed}"
    if summary.max_distance_m is None or summary.wanted_distance_m is None:
        return "\n".join([head, *_overload_lines(summary)])
    lines = [head, f"  formation         {summary.duration_s:.1f} s", *_autopilots(summary)]
    if summary.tracks == "estimated":
        lines.append("  positions         as estimated by the vehicles; their true errors are unknown")
    pairs = summary.pairs
    if pairs:
        largest = _each({pair: summary.max_distance_m[pair] for pair in pairs}, "", digits=2)
        lines.append(f"  largest distance  {largest}   {_wanted(summary, summary.wanted_distance_m)}")
    if summary.smallest_distance_m is not None:
        lines.append(f"  smallest distance {summary.smallest_distance_m:.2f} m, of any two in the whole flight")
    to_slots = ", to the slots on their way" if summary.under_way_s else ""
    lines.append(f"{_settled(summary)}; final error {summary.final_error_m:.3f} m{to_slots}")
    lines.extend(_tracking_in_words(summary))
    lines.extend(_filter_in_words(summary))
    lines.extend(_answers_in_words(summary))
    lines.extend(_ticks_in_words(summary))
    lines.extend(_overload_lines(summary))
    if (factor := summary.real_time_factor) is not None:
        times = f"{factor:.0f}" if factor >= 10.0 else f"{factor:.2g}"  # large fleets are slower than real time
        lines.append(f"  virtual time      {times} times as fast as real time")
    return "\n".join(lines)


def _wanted(summary: RunSummary, wanted_m: Mapping[str, float]) -> str:
    """Beside the largest distances: one for all pairs, else one for each in their order, or that of the pair shown."""
    if summary.under_way_s:
        return "(slots still on their way)"
    pairs, largest_m = summary.pairs, summary.max_distance_m or {}
    shown = pairs if len(pairs) <= MAX_EACH else [max(pairs, key=lambda pair: largest_m[pair])]
    each = [f"{wanted_m[pair]:.2f}" for pair in shown]
    return f"(wanted {each[0] if len(set(each)) == 1 else ', '.join(each)} m)"


def _autopilots(summary: RunSummary) -> list[str]:
    """Named where they differ, and where they are no stand-ins."""
    ids: dict[str, list[int]] = {}
    for vehicle in summary.vehicles:
        ids.setdefault(str(vehicle.autopilot), []).append(vehicle.id)
    named = "   ".join(f"{name} {', '.join(map(str, own))}" for name, own in ids.items())
    real = "   (real ones, in their own simulation)" if _are_real(summary) else ""
    return [f"  autopilots        {named}{real}"] if len(ids) > 1 or real else []


def _are_real(summary: RunSummary) -> bool:
    return summary.tracks == "true" and summary.sensors is None


def _settled(summary: RunSummary) -> str:
    """About a moving reference errors need not stay small: then the largest of the second half is reported."""
    if summary.under_way_s:
        return f"  settled           never: {_under_way(summary.under_way_s)}"
    if summary.settle_s is not None:
        return f"  settled           {summary.settle_s:.1f} s to 10 cm"
    if not summary.reference_moves:
        errs = "" if summary.sensors in (None, "ideal") else f", with the errors of the sensors ({summary.sensors})"
        return f"  settled           never to 10 cm{errs}"
    most = f"at most {summary.largest_error_m:.3f} m off in the second half"
    return f"  settled           never to 10 cm about a moving reference; {most}"


def _under_way(left_s: Mapping[int, float]) -> str:
    """Which slots were on their way at the end, and for how long still."""
    return f"the slots of {id_list(left_s)} were still on their way, for another {max(left_s.values()):.0f} s"


def _overload_lines(summary: RunSummary) -> list[str]:
    limit = OF_STAND_INS if summary.sensors else OF_AUTOPILOTS
    return [f"  {overload_line(summary.overload, limit)}"] if summary.overload else []


def _tracking_in_words(summary: RunSummary) -> list[str]:
    lines: list[str] = []
    if summary.under_way_s:  # errors to slots on their way say nothing of the formation
        return lines
    if about_rft := {v.id: v.tracking_error_m for v in summary.vehicles if v.tracking_error_m is not None}:
        lines.append(f"  tracking error    {_each(about_rft)}   (RMS about the RFT, second half)")
    if about_leader := {v.id: v.behind_leader_m for v in summary.vehicles if v.behind_leader_m is not None}:
        lines.append(f"  while following   {_each(about_leader)}   (likewise, about the leader)")
    if steps_deg := [v.largest_step_deg for v in summary.vehicles if v.largest_step_deg is not None]:
        lines.append(f"  attitude steps    at most {max(steps_deg):.1f} degrees from one setpoint to the next")
    return lines


def _filter_in_words(summary: RunSummary) -> list[str]:
    """Only where it acted: figures of a law that it changed are not those of the law alone."""
    acted_s = {one.id: one.filter_acted_s for one in summary.vehicles if one.filter_acted_s}
    if not acted_s:
        return []
    longest = max(acted_s, key=lambda i: acted_s[i])
    each = "   ".join(f"{i} {seconds:.1f} s" for i, seconds in acted_s.items())
    times = (
        each
        if len(acted_s) <= MAX_EACH
        else f"on {len(acted_s)} vehicles, at most {acted_s[longest]:.1f} s, vehicle {longest}"
    )
    return [f"  separation filter {times}   (it changed what the law commanded)"]


def _answers_in_words(summary: RunSummary) -> list[str]:
    answered_s = [asked.answered_in_s for asked in summary.commands]
    in_time_s = [seconds for seconds in answered_s if seconds is not None]
    if not in_time_s:
        return []
    missing = f", {len(answered_s) - len(in_time_s)} not by all" if len(in_time_s) < len(answered_s) else ""
    return [f"  commands          {len(answered_s)} given, answered by all within {max(in_time_s):.2f} s{missing}"]


def _each(values_m: Mapping[T, float], whose: str = "vehicle ", digits: int = 3) -> str:
    """All values by vehicle or pair if they fit into a line, else the largest."""
    if len(values_m) <= MAX_EACH:
        return "   ".join(f"{i} {value_m:.{digits}f} m" for i, value_m in values_m.items())
    worst = max(values_m, key=lambda i: values_m[i])
    return f"at most {values_m[worst]:.{digits}f} m, {whose}{worst}"


def _ticks_in_words(summary: RunSummary) -> list[str]:
    ticks = [vehicle.tick for vehicle in summary.vehicles if vehicle.tick]
    if not ticks:
        return []
    slowest, fastest = min(tick.rate_hz for tick in ticks), max(tick.rate_hz for tick in ticks)
    rate = f"{slowest:.2f}" if f"{slowest:.2f}" == f"{fastest:.2f}" else f"{slowest:.2f} to {fastest:.2f}"
    missed, count = sum(tick.missed for tick in ticks), sum(tick.ticks for tick in ticks)
    return [f"  control loop      {rate} Hz, {missed} of {missed + count} ticks missed"]


MAX_MISSED_SHARE, MAX_LATENCY_MS = 0.005, 5.0  # of the ticks; p99 from telemetry to command. Idle: none, below 1 ms
IF_TOO_BUSY = "distrust the figures, or fly in virtual time: sitl run"
OF_STAND_INS = "the machine was too busy for real time: {}; " + IF_TOO_BUSY
OF_AUTOPILOTS = "the machine or the autopilots were too slow for real time: {}"  # PX4's clock may run 2 % slow


def overload(ticks: int, missed: int, slowest_us: float) -> str | None:
    """What was measured beyond the limits, in one line; None within them, and in virtual time.

    `ticks` and `missed` are sums over all agents; `slowest_us` is the largest p99 from telemetry to command.
    """
    found = []
    if missed > MAX_MISSED_SHARE * (ticks + missed):
        share = 100.0 * missed / (ticks + missed)
        found.append(f"{share:.1f} % of the ticks missed (limit {100.0 * MAX_MISSED_SHARE:g} %)")
    if slowest_us > 1000.0 * MAX_LATENCY_MS:
        found.append(f"{slowest_us / 1000.0:.1f} ms from telemetry to command (p99, limit {MAX_LATENCY_MS:g} ms)")
    return ", ".join(found) or None


def overload_line(found: str, line: str = OF_STAND_INS) -> str:
    return line.format(found)


class ReportedEvent(Struct, frozen=True, kw_only=True):
    """An event that a vehicle reported, `time_s` after the flight's beginning."""

    time_s: float
    vehicle: int
    code: Code
    event: str


class CommandGiven(Struct, frozen=True, kw_only=True):
    """A command to several vehicles at once, `time_s` after the flight's beginning.

    `answered_in_s` is the time until the last of them had answered; None if one did not.
    """

    time_s: float
    command: CommandName
    in_words: str  # with its arguments
    vehicles: list[int]
    answered_in_s: float | None


class TopologyChange(Struct, frozen=True, kw_only=True):
    """A vehicle's role and neighbours from `time_s` after the flight's beginning until its next change."""

    time_s: float
    vehicle: int
    role: Role
    epoch: int
    prc: int
    neighbours: tuple[int, ...]
    in_formation: bool

    def same_as(self, status: Status) -> bool:
        own = (self.role, self.epoch, self.prc, self.neighbours, self.in_formation)
        lead, neighbours = status.leadership, status.neighbourhood.neighbours
        reported = (lead.role, lead.epoch, lead.prc, neighbours, status.phase is FlightPhase.FORMATION)
        return own == reported
