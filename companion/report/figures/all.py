"""All figures of the page, by section."""

from __future__ import annotations

from companion.report.figures.autopilots import draw_autopilot_logs
from companion.report.figures.bars import draw_flags, draw_leaders, draw_phases
from companion.report.figures.curves import (
    draw_altitude,
    draw_battery,
    draw_distances,
    draw_errors,
    draw_interventions,
    draw_peer_ages,
    draw_position_errors,
    draw_prc,
    draw_weights,
    draw_wind,
)
from companion.report.figures.picture import DrawnFigure
from companion.report.figures.style import TimeAxis
from companion.report.figures.timing import draw_histograms, draw_lateness
from companion.report.figures.tracks import draw_topology, draw_tracks
from companion.report.judge import Judged

Section = tuple[str, list[DrawnFigure]]


def sections_of(one: Judged, axis: TimeAxis) -> list[Section]:
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
