"""The table of docs/metrics.md, from companion/monitor/metrics.py."""

from __future__ import annotations

from companion.monitor.metrics import FLEET_MEASURES, OF_FLEET, OF_VEHICLE, SERVER_MEASURES, VEHICLE_MEASURES, Measure


def table() -> str:
    rows = [_row(measure, OF_VEHICLE) for measure in VEHICLE_MEASURES]
    rows += [_row(measure, OF_FLEET) for measure in FLEET_MEASURES]
    rows += [f"| `{name}` | gauge | - | {text} |" for name, text in SERVER_MEASURES.items()]
    return "\n".join(["| metric | type | labels | value |", "|---|---|---|---|", *rows])


def _row(measure: Measure, labels: tuple[str, ...]) -> str:
    names = ", ".join((*labels, measure.by) if measure.by else labels)
    return f"| `{measure.name}` | {'counter' if measure.is_counter else 'gauge'} | {names} | {measure.help} |"
