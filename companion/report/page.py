"""The page: one HTML file with everything in it, its figures by section, and what of the configuration a reader needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, tzinfo
from typing import TypeVar

import jinja2
from markupsafe import Markup, escape

from companion import __version__
from companion.config.fleet import EdgeNeighbours, FleetConfig
from companion.report.bar_figures import draw_flags, draw_histograms, draw_leaders, draw_phases
from companion.report.curve_figures import (
    draw_altitude,
    draw_autopilot_logs,
    draw_battery,
    draw_distances,
    draw_errors,
    draw_interventions,
    draw_lateness,
    draw_peer_ages,
    draw_position_errors,
    draw_prc,
    draw_weights,
    draw_wind,
)
from companion.report.findings import FindingRow, Severity, rows_of
from companion.report.flight import FlightEvent, FlightRecords, GivenCommand
from companion.report.plotting import DrawnFigure, TimeAxis
from companion.report.record_findings import LATE_P99_MS, TO_COMMAND_P99_MS
from companion.report.summary import FlightSummary, JudgedFlight
from companion.report.track_figures import draw_topology, draw_tracks

SIGNS = {Severity.CRITICAL: "✖", Severity.WARNING: "▲", Severity.INFO: "●"}  # distinct without colour
MOST_EVENTS, MOST_COMMANDS, MOST_EDGES, MOST_MARKS = 400, 1000, 40, 20
Section = tuple[str, list[DrawnFigure]]
Timed = TypeVar("Timed", FlightEvent, GivenCommand)


def page_of(one: JudgedFlight, zone: tzinfo) -> str:
    """Draws the figures and writes the page. `zone`: of the local times."""
    begin_unix_s = one.flight.begin_unix_s if one.flight.has_date else None
    axis = TimeAxis(one.flight.ends_s, begin_unix_s, zone, marks_of(rows_of(one.summary.findings)))
    return page(one.flight, one.summary, sections_of(one, axis), axis)


def page(flight: FlightRecords, summary: FlightSummary, sections: Sequence[Section], axis: TimeAxis) -> str:
    """The whole page. It requests nothing from a network and prints on A4."""
    environment = templates_of("companion.report")
    environment.filters |= {
        "sign": SIGNS.__getitem__,
        "number": number,
        "clock": axis.clock,
        "prose": prose,
        "anchor": anchor,
    }
    rows = rows_of(summary.findings)
    commands = _by_time({vehicle.vehicle_id: vehicle.commands for vehicle in flight.vehicles})
    events = _by_time({vehicle.vehicle_id: vehicle.events for vehicle in flight.vehicles})
    begins = _date_and_zone(axis)
    return environment.get_template("report.html.j2").render(
        flight=flight,
        summary=summary,
        rows=rows,
        verdict=verdict(rows),
        sections=sections,
        begins=begins,
        counts=[(severity, count(rows, severity)) for severity in Severity],
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


def _date_and_zone(axis: TimeAxis) -> tuple[str, str] | None:
    """Of the begin; None without a date."""
    if axis.begin_unix_s is None:
        return None
    begin = datetime.fromtimestamp(axis.begin_unix_s, axis.zone)
    return f"{begin:%A, %d %B %Y}", f"{begin:UTC%z}"[:6] + ":" + f"{begin:%z}"[3:5]


def marks_of(rows: Sequence[FindingRow]) -> tuple[tuple[float, str], ...]:
    """Times and numbers of the findings that have a moment, information left out."""
    numbered = enumerate((row.finding for row in rows), start=1)
    marked = [(one.time_s, str(n)) for n, one in numbered if one.severity is not Severity.INFO and one.time_s > 0.0]
    return tuple(marked[:MOST_MARKS])


def count(rows: Sequence[FindingRow], severity: Severity) -> int:
    """Rows of the page of one severity."""
    return sum(row.finding.severity is severity for row in rows)


def templates_of(package: str) -> jinja2.Environment:
    """The templates of a package, for pages that need no network. A value that is missing is an error."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader(package),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def verdict(rows: Sequence[FindingRow]) -> str:
    """ "2 critical findings and 1 warning", or that there are none."""
    critical, warnings = count(rows, Severity.CRITICAL), count(rows, Severity.WARNING)
    parts = []
    if critical:
        parts.append(f"{critical} critical finding{'s' if critical > 1 else ''}")
    if warnings:
        parts.append(f"{warnings} warning{'s' if warnings > 1 else ''}")
    if not parts:
        informative = count(rows, Severity.INFO)
        return f"No findings but {informative} for information" if informative else "No findings"
    return " and ".join(parts)


def number(value: float | None, digits: int = 1) -> str:
    """A number with so many digits, "-" for an unknown one."""
    return "-" if value is None else f"{value:.{digits}f}"


def anchor(title: str) -> str:
    """The id of a section."""
    return title.lower().replace(" ", "-")


def prose(text: str) -> Markup:
    """A text of the explanations: what is in backticks is code."""
    parts = [escape(part) for part in text.split("`")]
    return Markup("").join(Markup("<code>{}</code>").format(part) if i % 2 else part for i, part in enumerate(parts))


def _by_time(of: Mapping[int, Sequence[Timed]]) -> list[tuple[int, Timed]]:
    """(vehicle, event or command), in the order of time."""
    rows = [(vehicle_id, one) for vehicle_id, own in of.items() for one in own]
    return sorted(rows, key=lambda row: (row[1].time_s, row[0]))


def settings_rows(fleet: FleetConfig) -> list[tuple[str, str]]:
    """(name as in the fleet file, value)."""
    envelope, law = fleet.envelope, fleet.law
    neighbours = fleet.neighbours
    if isinstance(neighbours, EdgeNeighbours):
        edges = ", ".join(f"{a}-{b}" for a, b in neighbours.edges[:MOST_EDGES])
        topology = f"edges {edges}" + (" and more" if len(neighbours.edges) > MOST_EDGES else "")
    else:
        topology = f"within {neighbours.range_m:g} m, hysteresis {neighbours.hysteresis_m:g} m"
    low, high = envelope.fence_min_enu_m, envelope.fence_max_enu_m
    fence = ", ".join(f"{name} {a:g} to {b:g} m" for name, a, b in zip(("x", "y", "z"), low, high, strict=True))
    return [
        ("law", f"{law.name}, altitude {law.altitude}"),
        ("neighbours", topology),
        ("separation_m", f"{fleet.separation_m:g}"),
        ("fence", fence + (f"; polygon of {n} corners" if (n := len(envelope.fence_corners_enu_m)) else "")),
        ("obstacles", str(len(fleet.obstacles))),
        ("max_speed_m_s", f"{envelope.max_speed_m_s:g}"),
        ("max_tilt_deg", f"{envelope.max_tilt_deg:g}"),
        ("peers.max_age_s", f"{fleet.peers.max_age_s:g}"),
        ("peers.leader_beacon_max_age_s", f"{fleet.peers.leader_beacon_max_age_s:g}"),
        ("successors", ", ".join(map(str, fleet.successors)) or "none"),
        ("leave_below_percent", _percent(fleet.leave_below_percent) + f", then {fleet.low_battery_action}"),
        ("land_below_percent", _percent(fleet.land_below_percent)),
        ("formation_heading", fleet.formation_heading),
        ("when_one_leaves", fleet.when_one_leaves),
    ]


def member_rows(fleet: FleetConfig) -> list[tuple[int, str, str, bool]]:
    """(vehicle, role, slot, may lead)."""
    return [
        (member.id, str(member.role), ", ".join(f"{x:g}" for x in member.slot_enu_m), member.can_lead)
        for member in fleet.vehicles
    ]


def recording_rows(flight: FlightRecords) -> list[tuple[int, int, str, float, float, str]]:
    """(vehicle, number of the start, software, begin, end, files)."""
    return [
        (vehicle.vehicle_id, number, start.software, start.begins_s, start.ends_s, ", ".join(start.files))
        for vehicle in flight.vehicles
        for number, start in enumerate(vehicle.starts, start=1)
    ]


def _percent(value: float | None) -> str:
    return "not set" if value is None else f"{value:g}"


def sections_of(one: JudgedFlight, axis: TimeAxis) -> list[Section]:
    """(title, figures). A figure of something that never occurred is left out."""
    flight, pairs, errors_m = one.flight, one.pairs, one.errors_m
    drawn: list[tuple[str, list[DrawnFigure | None]]] = [
        (
            "Flight",
            [draw_tracks(flight, pairs), draw_altitude(flight, axis), draw_phases(flight, axis)],
        ),
        (
            "Formation",
            [
                draw_distances(flight, pairs, axis) if pairs else None,
                draw_errors(flight, errors_m, axis),
                draw_interventions(flight, axis),
            ],
        ),
        (
            "Law and leader",
            [
                draw_leaders(flight, axis),
                draw_prc(flight, axis),
                draw_topology(flight),
                draw_peer_ages(flight, axis),
                draw_weights(flight, axis),
            ],
        ),
        (
            "Health",
            [
                draw_flags(flight, axis),
                draw_battery(flight, axis),
                draw_position_errors(flight, axis),
                draw_wind(flight, axis),
            ],
        ),
        ("Autopilots", [*draw_autopilot_logs(flight, one.logs.matched, axis)]),
        ("Timing", [draw_histograms(flight), draw_lateness(flight, axis)]),
    ]
    return [(title, [one for one in pictures if one is not None]) for title, pictures in drawn]
