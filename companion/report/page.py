"""The page: one HTML file with everything in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, tzinfo

import jinja2
from markupsafe import Markup, escape

from companion import __version__
from companion.report.configuration import member_rows, recording_rows, settings_rows
from companion.report.figures.all import Section, sections_of
from companion.report.figures.style import TimeAxis, marks_of
from companion.report.finding import FindingRow, Severity, rows_of
from companion.report.findings.timing import LATE_P99_MS, TO_COMMAND_P99_MS
from companion.report.flight import FlightEvent, FlightRecords, GivenCommand
from companion.report.judge import Judged
from companion.report.summary import FlightSummary

SIGNS = {Severity.CRITICAL: "✖", Severity.WARNING: "▲", Severity.INFO: "●"}  # distinct without colour
MOST_EVENTS, MOST_COMMANDS = 400, 1000


@dataclass(frozen=True, slots=True)
class EventRow:
    vehicle_id: int
    event: FlightEvent


@dataclass(frozen=True, slots=True)
class CommandRow:
    vehicle_id: int
    command: GivenCommand


def page_of(one: Judged, zone: tzinfo) -> str:
    """Draws the figures and writes the page. `zone`: of the local times."""
    axis = TimeAxis(one.flight.ends_s, one.flight.begin_unix_s, zone, marks_of(rows_of(one.summary.findings)))
    return page(one.flight, one.summary, sections_of(one, axis), axis)


def page(flight: FlightRecords, summary: FlightSummary, sections: Sequence[Section], axis: TimeAxis) -> str:
    """The whole page. It requests nothing from a network and prints on A4."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("companion.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"sign": SIGNS.__getitem__, "number": number, "clock": axis.clock, "prose": prose}
    rows = rows_of(summary.findings)
    commands, events = command_rows(flight), event_rows(flight)
    begin = datetime.fromtimestamp(axis.begin_unix_s, axis.zone)
    return environment.get_template("report.html.j2").render(
        flight=flight,
        summary=summary,
        rows=rows,
        verdict=verdict(rows),
        sections=sections,
        date=f"{begin:%A, %d %B %Y}",
        zone=f"{begin:UTC%z}"[:6] + ":" + f"{begin:%z}"[3:5],
        counts=[(severity, counted(rows, severity)) for severity in Severity],
        commands=commands[:MOST_COMMANDS],
        commands_left_out=max(0, len(commands) - MOST_COMMANDS),
        events=events[:MOST_EVENTS],
        events_left_out=max(0, len(events) - MOST_EVENTS),
        settings=settings_rows(flight.fleet) if flight.fleet else [],
        members=member_rows(flight.fleet) if flight.fleet else [],
        recordings=recording_rows(flight),
        limits={"late_p99_ms": LATE_P99_MS, "to_command_p99_ms": TO_COMMAND_P99_MS},
        software=__version__,
    )


def counted(rows: Sequence[FindingRow], severity: Severity) -> int:
    """Rows of the page of one severity."""
    return sum(row.finding.severity is severity for row in rows)


def verdict(rows: Sequence[FindingRow]) -> str:
    """ "2 critical findings and 1 warning", or that there are none."""
    critical, warnings = counted(rows, Severity.CRITICAL), counted(rows, Severity.WARNING)
    parts = []
    if critical:
        parts.append(f"{critical} critical finding{'s' if critical > 1 else ''}")
    if warnings:
        parts.append(f"{warnings} warning{'s' if warnings > 1 else ''}")
    if not parts:
        informative = counted(rows, Severity.INFO)
        return f"No findings but {informative} for information" if informative else "No findings"
    return " and ".join(parts)


def number(value: float | None, digits: int = 1) -> str:
    """A number with so many digits, "-" for an unknown one."""
    return "-" if value is None else f"{value:.{digits}f}"


def prose(text: str) -> Markup:
    """A text of the explanations: what is in backticks is code."""
    parts = [escape(part) for part in text.split("`")]
    return Markup("").join(Markup("<code>{}</code>").format(part) if i % 2 else part for i, part in enumerate(parts))


def command_rows(flight: FlightRecords) -> list[CommandRow]:
    """All commands by time."""
    rows = [CommandRow(vehicle.vehicle_id, one) for vehicle in flight.vehicles for one in vehicle.commands]
    return sorted(rows, key=lambda row: (row.command.time_s, row.vehicle_id))


def event_rows(flight: FlightRecords) -> list[EventRow]:
    """All events by time."""
    rows = [EventRow(vehicle.vehicle_id, one) for vehicle in flight.vehicles for one in vehicle.events]
    return sorted(rows, key=lambda row: (row.event.time_s, row.vehicle_id))
