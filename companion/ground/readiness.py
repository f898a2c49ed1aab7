"""The checks of a vehicle before flight, sorted by subject. The vehicle decides; here its findings are collected. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from companion.types.flight import BATTERY_FLAGS, FLAG_TEXTS, HealthFlag, Role
from companion.types.notices import Code, Notice
from companion.types.status import Status

F = HealthFlag

ESTIMATOR = frozenset({F.POSITION_JUMPED, F.ESTIMATOR_BAD})
ORIGIN = frozenset({F.FRAME_UNKNOWN, F.FRAME_CONTRADICTED, F.OUTSIDE_FENCE})
OTHER_CHECKS = ESTIMATOR | ORIGIN | BATTERY_FLAGS
LATER = frozenset({F.LEADER_LOST, F.LEADER_AWAITED})  # a leader publishes no beacon before the fleet is in the air
BATTERY = frozenset({Code.BATTERY_LOW})
BATTERY_WARNINGS = frozenset({Code.BATTERY_LOW, Code.BATTERY_UNKNOWN})
SEPARATION = frozenset({Code.VEHICLE_TOO_CLOSE, Code.ALTITUDES_DIFFER})
NOT_CHECKED = "not checked while armed"


@dataclass(frozen=True, slots=True)
class Check:
    """One check before flight; `codes` is empty where it passed, `found` describes the state or the findings.

    A check that passed may have `warnings`.
    """

    name: str
    codes: tuple[Code, ...]
    found: str
    warnings: tuple[Code, ...] = ()

    @property
    def passed(self) -> bool:
        return not self.codes


def checks_of(status: Status, fleet_ids: Collection[int], formation_hash: int) -> tuple[Check, ...]:
    """All checks of one vehicle, in a fixed order. Ids and hash are those of the fleet file on the ground."""
    flags, lacks = set(status.flags) - LATER, status.lacks
    missing = sorted(set(fleet_ids) - {status.vehicle_id} - set(status.peers))
    no_peers = [Notice(Code.PEER_STALE, f"no fresh report of {_ids(missing)}")] if missing else []
    same_file = status.formation_hash == formation_hash
    other_file = [Notice(Code.FLEET_FILE_DIFFERS, "differs from the fleet file here (formation hash)")]
    others = [notice for notice in lacks if notice.code not in BATTERY | SEPARATION]
    return (
        _check("autopilot", _notices(flags - OTHER_CHECKS), f"position {status.state_age_s * 1000.0:.0f} ms old"),
        _check("estimator", _notices(flags & ESTIMATOR), _error(status)),
        _check(
            "battery",
            _notices(flags & BATTERY_FLAGS) + [notice for notice in lacks if notice.code in BATTERY],
            _battery(status.battery_percent),
            [notice for notice in status.warnings if notice.code in BATTERY_WARNINGS],
        ),
        _check("origin", _notices(flags & ORIGIN), "in the fleet frame, inside the fence"),
        _check("peers", no_peers, f"fresh: {_ids(status.peers)}"),
        _check("fleet file", [] if same_file else other_file, "the same"),
        _check(
            "separation",
            [notice for notice in lacks if notice.code in SEPARATION],
            NOT_CHECKED if status.armed else "kept",
        ),
        _check(
            "parameters",
            others,
            NOT_CHECKED if status.armed else "as the audit requires; arming checks pass",
            [notice for notice in status.warnings if notice.code not in BATTERY_WARNINGS],
        ),
    )


def leader_check(statuses: Mapping[int, Status], fleet_ids: Collection[int]) -> Check:
    """Whether a vehicle leads. An agent that starts again is no leader where a command had made it one."""
    leaders = sorted(i for i, status in statuses.items() if status.role is Role.LEADER)
    if leaders or not set(fleet_ids) <= statuses.keys():
        return _check("leader", [], f"vehicle {_ids(leaders)}" if leaders else "not checked without all vehicles")
    return _check("leader", [Notice(Code.LEADER_LOST, "no vehicle leads; companion fleet leader ID names one")], "")


def _notices(flags: Iterable[HealthFlag]) -> list[Notice]:
    return [Notice(Code(flag), FLAG_TEXTS[flag]) for flag in sorted(flags)]


def _check(name: str, notices: Collection[Notice], found: str, warnings: Collection[Notice] = ()) -> Check:
    """The findings, or `found` where there are none; then the warnings."""
    texts = ["; ".join(map(str, notices)) or found, *(f"warning: {notice}" for notice in warnings)]
    return Check(
        name, tuple(notice.code for notice in notices), "; ".join(texts), tuple(notice.code for notice in warnings)
    )


def _error(status: Status) -> str:
    error = status.position_error
    if error is None:
        return "reports no position error"
    return f"error {error.horizontal_m:.2f} m horizontal, {error.vertical_m:.2f} m vertical"


def _battery(percent: float | None) -> str:
    return "unknown to the autopilot" if percent is None else f"{percent:.0f} %"


def _ids(ids: Collection[int]) -> str:
    return ", ".join(map(str, ids)) or "none"
