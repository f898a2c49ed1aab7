"""What a formation or a reference would do, from the present reports: paths, distances, time. Nothing is sent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil, inf

from companion.config.file import ConfigError
from companion.config.fleet import FleetConfig
from companion.config.new_formation import flight_time_s
from companion.config.reference import Reference, TargetReference, moves
from companion.config.reference_check import reference_problems
from companion.geometry.separation import counted
from companion.geometry.transition import closest_approach
from companion.geometry.turning import turned_slot
from companion.ground.formations import change_to, refusal_of, requested_slots
from companion.ground.references import requested_reference
from companion.ground.requests import FleetRequest, FormationRequest
from companion.ground.usable_reports import check_reports
from companion.monitor.api import PathView, Preview
from companion.types.formation import FlownSlot
from companion.types.status import Status
from companion.types.values import Vector3

TRACK_POINTS = 400


def preview_of(wanted: FleetRequest, fleet: FleetConfig, statuses: Mapping[int, Status]) -> Preview:
    """Of a request with a formation or a reference. Raises ConfigError."""
    silent = [str(member.id) for member in fleet.vehicles if member.id not in statuses]
    if wanted.formation:
        if silent:
            return Preview(refused=f"no report of vehicle {', '.join(silent)}; all vehicles get new slots")
        return _formation(wanted.formation, fleet, [statuses[member.id] for member in fleet.vehicles])
    assert wanted.reference is not None
    check_reports("reference", statuses.values())
    flown = [status.reference_enu_m for status in statuses.values() if status.reference_enu_m]
    reference = requested_reference(wanted.reference, flown[0] if flown else None)
    return _reference(reference, fleet, list(statuses.values()))


def _formation(request: FormationRequest, fleet: FleetConfig, statuses: Sequence[Status]) -> Preview:
    has_height = fleet.law.altitude == "formation"
    slots_enu_m = requested_slots(request, statuses, fleet)
    flown_enu_m = {status.vehicle_id: status.slot.position_enu_m for status in statuses}
    closest_m, _, _ = closest_approach(
        {i: counted(slot, has_height) for i, slot in flown_enu_m.items()},
        {i: counted(slot, has_height) for i, slot in slots_enu_m.items()},
    )
    change = change_to(slots_enu_m, statuses, fleet.slot_speed_m_s)
    reference_enu_m = _reference_enu_m(statuses)
    return Preview(
        paths=tuple(
            PathView(
                status.vehicle_id,
                _in_fleet_frame(flown_enu_m[status.vehicle_id], status, reference_enu_m),
                _in_fleet_frame(slots_enu_m[status.vehicle_id], status, reference_enu_m),
            )
            for status in statuses
        ),
        smallest_separation_m=round(closest_m, 3) if closest_m < inf else None,
        lasts_s=round(change.lasts_s, 2),
        refused=refusal_of(slots_enu_m, fleet.separation_m, has_height) or "",
    )


def _reference_enu_m(statuses: Sequence[Status]) -> Vector3:
    """That of a leader; before there is one, the mean position of the vehicles less their slots."""
    for status in statuses:
        if status.reference_enu_m:
            return status.reference_enu_m
    origins = [_less(s.position_enu_m, turned_slot(s.slot, s.heading).position_enu_m) for s in statuses]
    x, y, z = (sum(axis) / len(origins) for axis in zip(*origins, strict=True))
    return (x, y, z)


def _less(a: Vector3, b: Vector3) -> Vector3:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _in_fleet_frame(slot_enu_m: Vector3, status: Status, reference_enu_m: Vector3) -> Vector3:
    (x, y, z), (dx, dy, dz) = reference_enu_m, turned_slot(FlownSlot(slot_enu_m), status.heading).position_enu_m
    return (round(x + dx, 3), round(y + dy, 3), round(z + dz, 3))


def _reference(reference: Reference, fleet: FleetConfig, statuses: Sequence[Status]) -> Preview:
    """The track of the reference; None as time where it has no end."""
    slots_enu_m = {status.vehicle_id: status.slot.position_enu_m for status in statuses}
    problems = [
        ConfigError("reference", *problem) for problem in reference_problems(fleet, reference, "reference", slots_enu_m)
    ]
    lasts_s = flight_time_s(reference) if moves(reference) and not isinstance(reference, TargetReference) else None
    curve, points = reference.curve(), TRACK_POINTS if lasts_s else 1
    track = [curve((lasts_s or 0.0) * index / max(1, points - 1))[0] for index in range(points)]
    return Preview(
        track_enu_m=tuple((round(x, 3), round(y, 3), round(z, 3)) for x, y, z in track),
        lasts_s=None if lasts_s is None else float(ceil(lasts_s)),
        refused="; ".join(problem.lines[0].removeprefix("reference: ") for problem in problems),
    )
