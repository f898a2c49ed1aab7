"""What a vehicle checks before it flies, as a list to read on the ground. The vehicle judges; here its words are sorted."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from companion.types import HealthFlag, Status

F = HealthFlag

ESTIMATOR = frozenset({F.POSITION_JUMPED})
ORIGIN = frozenset({F.FRAME_UNKNOWN, F.FRAME_CONTRADICTED, F.FENCE})
LATER = frozenset({F.LEADER_LOST})  # a leader has no word to give before the fleet is in the air
BATTERY = ("battery: ",)
SEPARATION = ("separation: ", "altitude: ")


@dataclass(frozen=True, slots=True)
class Check:
    """One thing to be in order before a flight; `found` is what was found, in words."""

    name: str
    fit: bool
    found: str


def checks_of(status: Status, fleet_ids: Collection[int], formation_hash: int) -> tuple[Check, ...]:
    """All of one vehicle's, in a fixed order. Ids and hash are those of the ground's own fleet file."""
    flags, lacks = set(status.flags) - LATER, status.lacks
    unheard = sorted(set(fleet_ids) - {status.vehicle_id} - set(status.peers))
    same_file = status.formation_hash == formation_hash
    return (
        _check("autopilot", sorted(flags - ESTIMATOR - ORIGIN), f"position {status.state_age_s * 1000.0:.0f} ms old"),
        _check("estimator", sorted(flags & ESTIMATOR), _error(status)),
        _check("battery", _of(lacks, BATTERY), _battery(status.battery_percent)),
        _check("origin", sorted(flags & ORIGIN), "in the fleet's frame, inside its fence"),
        _check("peers", [f"does not hear {_ids(unheard)}"] if unheard else [], f"hears {_ids(status.peers)}"),
        _check("fleet file", [] if same_file else ["another one than this (formation hash differs)"], "the same"),
        _check("separation", _of(lacks, SEPARATION), "not looked at while armed" if status.armed else "kept"),
        _check(
            "parameters",
            [words for words in lacks if not words.startswith(BATTERY + SEPARATION)],
            "not looked at while armed" if status.armed else "as the audit wants them; its own checks pass",
        ),
    )


def _check(name: str, wrong: Collection[str], found: str) -> Check:
    return Check(name, not wrong, "; ".join(wrong) or found)


def _of(lacks: Collection[str], subjects: tuple[str, ...]) -> list[str]:
    """Those that begin so; the name of the check need not stand twice."""
    return [words.removeprefix(subjects[0]) for words in lacks if words.startswith(subjects)]


def _error(status: Status) -> str:
    error = status.position_error
    if error is None:
        return "tells no error of its own"
    return f"error {error.horizontal_m:.2f} m in the plane, {error.vertical_m:.2f} m in height"


def _battery(percent: float | None) -> str:
    return "the autopilot does not know" if percent is None else f"{percent:.0f} %"


def _ids(ids: Collection[int]) -> str:
    return ", ".join(map(str, ids)) or "nobody"
