"""All figures of the page, by section."""

from __future__ import annotations

from companion.report.figures import autopilots, bars, curves, timing, tracks
from companion.report.figures.picture import Picture
from companion.report.figures.style import Axis
from companion.report.judge import Judged

Section = tuple[str, list[Picture]]


def sections_of(one: Judged, axis: Axis) -> list[Section]:
    """(title, figures). A figure of something that never occurred is left out."""
    flight, pairs, errors_m = one.flight, one.pairs, one.errors_m
    drawn: list[tuple[str, list[Picture | None]]] = [
        ("Flight", [tracks.tracks(flight, pairs), curves.altitude(flight, axis), bars.phases(flight, axis)]),
        (
            "Formation",
            [
                curves.distances(flight, pairs, axis) if pairs else None,
                curves.errors(flight, errors_m, axis),
                curves.interventions(flight, axis),
            ],
        ),
        (
            "Law and leader",
            [
                bars.leaders(flight, axis),
                curves.prc(flight, axis),
                tracks.topology(flight),
                curves.peer_ages(flight, axis),
                curves.weights(flight, axis),
            ],
        ),
        (
            "Health",
            [
                bars.flags(flight, axis),
                curves.battery(flight, axis),
                curves.position_errors(flight, axis),
                curves.wind(flight, axis),
            ],
        ),
        ("Autopilots", [*autopilots.autopilot_logs(flight, one.logs.matched, axis)]),
        ("Timing", [timing.histograms(flight), timing.lateness(flight, axis)]),
    ]
    return [(title, [one for one in pictures if one is not None]) for title, pictures in drawn]
