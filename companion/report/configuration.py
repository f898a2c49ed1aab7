"""What of the configuration a reader of the report needs."""

from __future__ import annotations

from companion.config.fleet import EdgeNeighbours, FleetConfig
from companion.report.flight import FlightRecords

MOST_EDGES = 40


def settings_rows(fleet: FleetConfig) -> list[tuple[str, str]]:
    """(name as in the fleet file, value)."""
    envelope, law = fleet.envelope, fleet.law
    neighbours = fleet.neighbours
    if isinstance(neighbours, EdgeNeighbours):
        edges = ", ".join(f"{a} - {b}" for a, b in neighbours.edges[:MOST_EDGES])
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
