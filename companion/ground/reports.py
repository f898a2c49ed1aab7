"""Status and readiness of the vehicles, as lines and as data: the vehicle checks itself, here its findings are sorted. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from companion.config.degrees import degree_notices
from companion.config.fleet import FleetConfig
from companion.ground.answers import AnswerKind, wrap_text
from companion.ground.belief import Doubt, doubts_as_data
from companion.ground.fleet_state import formation_text, reference_text
from companion.types.flight import BATTERY_FLAGS, FLAG_TEXTS, HealthFlag, Role
from companion.types.notices import Code, Notice
from companion.types.status import Status
from companion.wire.messages import STATUS_FORM

INDENT = " " * 12
WARNING = "warning: "
READY, WITH_WARNINGS, NOT_READY = "ready", "ready, with warnings", "not ready"


def readiness_lines(checks: Mapping[int, Sequence[Check]], silent: Sequence[int], wait_s: float) -> list[str]:
    """Per vehicle whether it is ready, and below it each check; then each warning once, and the verdict on all of them."""
    lines = []
    warnings: dict[tuple[str, str], list[int]] = {}
    for vehicle_id in sorted({*checks, *silent}):
        if vehicle_id in silent:
            lines += wrap_text(f"vehicle {vehicle_id}  {AnswerKind.MISSING}  ", str(no_report(wait_s)))
            continue
        lines.append(f"vehicle {vehicle_id}  {verdict_of(checks[vehicle_id])}")
        for check in checks[vehicle_id]:
            state, *warned = check.texts
            lines += wrap_text(f"  {check.name:<11} {'ok' if check.passed else '--'}  ", state)
            for text in warned:
                warnings.setdefault((check.name, text), []).append(vehicle_id)
    if warnings:
        lines.append("warnings")
    for (name, text), ids in warnings.items():
        lines += wrap_text(f"  {name:<11} ", f"{_ids(ids)}: {text.removeprefix(WARNING)}")
    return [*lines, *wrap_text("verdict  ", _verdict_on_all(checks, silent))]


def verdict_of(checks: Sequence[Check]) -> str:
    """READY, WITH_WARNINGS or NOT_READY, of one vehicle."""
    if not all(check.passed for check in checks):
        return NOT_READY
    return WITH_WARNINGS if any(check.warnings for check in checks) else READY


def _verdict_on_all(checks: Mapping[int, Sequence[Check]], silent: Sequence[int]) -> str:
    refused = [i for i, of_one in sorted(checks.items()) if verdict_of(of_one) == NOT_READY]
    if refused or silent:
        parts = ((NOT_READY, refused), ("no report", silent))
        return "; ".join(f"{what}: {_ids(ids)}" for what, ids in parts if ids)
    warned = any(verdict_of(of_one) == WITH_WARNINGS for of_one in checks.values())
    return f"all {len(checks)} {WITH_WARNINGS if warned else READY}"


def readiness_as_data(checks: Mapping[int, Sequence[Check]], silent: Sequence[int]) -> list[dict[str, Any]]:
    """`checks` is empty for a vehicle without a report; `codes` of a check is empty where it passed."""
    return [
        {
            "vehicle_id": i,
            "ready": i in checks and all(check.passed for check in checks[i]),
            "checks": [check.as_data() for check in checks.get(i, ())],
        }
        for i in sorted({*checks, *silent})
    ]


def status_lines(
    statuses: Mapping[int, Status], silent: Sequence[int], wait_s: float, doubts: Sequence[Doubt] = ()
) -> list[str]:
    """Two lines or more for each vehicle."""
    lines = []
    for vehicle_id in sorted({*statuses, *silent}):
        if vehicle_id in silent:
            lines += wrap_text(f"vehicle {vehicle_id:<3} {AnswerKind.MISSING}  ", str(no_report(wait_s)))
        else:
            lines += _status_lines(statuses[vehicle_id])
            own = [doubt.notice for doubt in doubts if doubt.vehicle_id == vehicle_id]
            lines += [line for notice in own for line in wrap_text(INDENT, str(notice))]
    return lines


UNSECURED = "UNSECURED: strangers in its network can command it (security: none in the fleet file)"


def _status_lines(status: Status) -> list[str]:
    autopilot, (x, y, z) = status.autopilot, status.motion.position_enu_m
    place = f"at {x:z.1f}, {y:z.1f}, {z:z.1f} m" if status.motion.is_known else "position unknown"
    battery = "unknown" if autopilot.battery_percent is None else f"{status.autopilot.battery_percent:.0f} %"
    state = (
        f"{status.phase:<9} {status.leadership.role:<8} {'armed' if autopilot.armed else 'disarmed':<8}"
        f" {autopilot.mode_name:<12} {place}"
    )
    flown = (
        f"formation {formation_text(status)},"
        f" reference {reference_text(status)},"
        f" operator {status.command.holder or '-'}, battery {battery}"
    )
    event = [UNSECURED] if status.network.security == "none" else []
    event += [str(status.last_event)] if status.last_event else []
    return [
        *wrap_text(f"vehicle {status.agent.vehicle_id:<3} ", state),
        *wrap_text(INDENT, flown),
        *(line for text in event for line in wrap_text(INDENT, text)),
    ]


def status_as_data(
    statuses: Mapping[int, Status], silent: Sequence[int], doubts: Sequence[Doubt] = ()
) -> list[dict[str, Any]]:
    """The whole report of each vehicle, with `reported`. A position that is unknown is None, and so is the velocity.

    `doubts` has what of it cannot be true.
    """
    data = {
        i: msgspec.to_builtins(STATUS_FORM.flat(status))
        | ({} if status.motion.is_known else {"position_enu_m": None, "velocity_enu_m_s": None})
        | {"reported": True}
        for i, status in statuses.items()
    }
    for doubted in doubts_as_data(doubts):
        data[doubted["vehicle_id"]].setdefault("doubts", []).append(doubted)
    return [data.get(i, {"vehicle_id": i, "reported": False}) for i in sorted({*statuses, *silent})]


def no_report(wait_s: float) -> Notice:
    return Notice(Code.NO_REPORT, f"no report for {wait_s:g} s")


F = HealthFlag

ESTIMATOR = frozenset({F.POSITION_JUMPED, F.ESTIMATOR_BAD, F.POSITION_UNAIDED})
ORIGIN = frozenset({F.FRAME_UNKNOWN, F.GROUND_UNKNOWN, F.FRAME_CONTRADICTED, F.OUTSIDE_FENCE})
OTHER_CHECKS = ESTIMATOR | ORIGIN | BATTERY_FLAGS
LATER = frozenset({F.LEADER_LOST, F.LEADER_AWAITED})  # a leader publishes no beacon before the fleet is in the air
BATTERY = frozenset({Code.BATTERY_LOW})
BATTERY_WARNINGS = frozenset({Code.BATTERY_LOW, Code.BATTERY_UNKNOWN})
SEPARATION = frozenset({Code.VEHICLE_TOO_CLOSE, Code.ALTITUDES_DIFFER})
SEPARATION_WARNINGS = frozenset({Code.BRAKES_SLOWLY})
NOT_CHECKED = "not checked while armed"


@dataclass(frozen=True, slots=True)
class Check:
    """One check before flight; `codes` is empty where it passed. `texts`: the state or the findings, then each warning.

    A check that passed may have `warnings`.
    """

    name: str
    codes: tuple[Code, ...]
    texts: tuple[str, ...]
    warnings: tuple[Code, ...] = ()

    @property
    def found(self) -> str:
        """All texts in one line."""
        return "; ".join(self.texts)

    @property
    def passed(self) -> bool:
        return not self.codes

    def as_data(self) -> dict[str, Any]:
        named = {"check": self.name, "passed": self.passed, "codes": list(self.codes)}
        return named | {"warnings": list(self.warnings), "found": self.found}


def readiness_of(statuses: Mapping[int, Status], fleet: FleetConfig) -> dict[int, tuple[Check, ...]]:
    """All checks of each vehicle that reports; `fleet` is that of the file on the ground."""
    ids, own_hash = [member.id for member in fleet.vehicles], fleet.formation_hash()
    leader, in_degrees = leader_check(statuses, ids), list(degree_notices(fleet.origin, fleet))
    return {i: (*checks_of(status, ids, own_hash, in_degrees), leader) for i, status in statuses.items()}


def checks_of(
    status: Status, fleet_ids: Collection[int], formation_hash: int, of_file: Collection[Notice] = ()
) -> tuple[Check, ...]:
    """All checks of one vehicle, in a fixed order. Ids, hash and warnings are those of the fleet file on the ground."""
    flags, lacks = set(status.safety.flags) - LATER, status.safety.lacks
    missing = sorted(set(fleet_ids) - {status.agent.vehicle_id} - set(status.neighbourhood.peers))
    no_peers = [Notice(Code.PEER_STALE, f"no fresh report of {_ids(missing)}")] if missing else []
    same_file = status.agent.formation_hash == formation_hash
    other_file = [Notice(Code.FLEET_FILE_DIFFERS, "differs from the fleet file here (formation hash)")]
    others = [notice for notice in lacks if notice.code not in BATTERY | SEPARATION]
    return (
        _check(
            "autopilot", _notices(flags - OTHER_CHECKS), f"position {status.motion.state_age_s * 1000.0:.0f} ms old"
        ),
        _check("estimator", _notices(flags & ESTIMATOR), _error(status)),
        _check(
            "battery",
            _notices(flags & BATTERY_FLAGS) + [notice for notice in lacks if notice.code in BATTERY],
            _battery(status.autopilot.battery_percent),
            [notice for notice in status.safety.warnings if notice.code in BATTERY_WARNINGS],
        ),
        _check("origin", _notices(flags & ORIGIN), "in the fleet frame, inside the fence"),
        _check("peers", no_peers, f"fresh: {_ids(status.neighbourhood.peers)}"),
        _check("fleet file", [] if same_file else other_file, "the same", of_file),
        _check(
            "separation",
            [notice for notice in lacks if notice.code in SEPARATION],
            NOT_CHECKED if status.autopilot.armed else "kept",
            [notice for notice in status.safety.warnings if notice.code in SEPARATION_WARNINGS],
        ),
        _check(
            "parameters",
            others,
            NOT_CHECKED if status.autopilot.armed else "as the audit requires; arming checks pass",
            [w for w in status.safety.warnings if w.code not in BATTERY_WARNINGS | SEPARATION_WARNINGS],
        ),
    )


def leader_check(statuses: Mapping[int, Status], fleet_ids: Collection[int]) -> Check:
    """Whether a vehicle leads. An agent that starts again is no leader where a command had made it one."""
    leaders = sorted(i for i, status in statuses.items() if status.leadership.role is Role.LEADER)
    if leaders or not set(fleet_ids) <= statuses.keys():
        return _check("leader", [], f"vehicle {_ids(leaders)}" if leaders else "not checked without all vehicles")
    return _check("leader", [Notice(Code.LEADER_LOST, "no vehicle leads; companion fleet leader ID names one")], "")


def _notices(flags: Iterable[HealthFlag]) -> list[Notice]:
    return [Notice(Code(flag), FLAG_TEXTS[flag]) for flag in sorted(flags)]


def _check(name: str, notices: Collection[Notice], found: str, warnings: Collection[Notice] = ()) -> Check:
    """The findings, or `found` where there are none; then the warnings."""
    texts = ("; ".join(map(str, notices)) or found, *(f"{WARNING}{notice}" for notice in warnings))
    return Check(name, tuple(notice.code for notice in notices), texts, tuple(notice.code for notice in warnings))


def _error(status: Status) -> str:
    error = status.motion.position_error
    if error is None:
        return "reports no position error"
    return f"error {error.horizontal_m:.2f} m horizontal, {error.vertical_m:.2f} m vertical"


def _battery(percent: float | None) -> str:
    return "unknown to the autopilot" if percent is None else f"{percent:.0f} %"


def _ids(ids: Collection[int]) -> str:
    return ", ".join(map(str, ids)) or "none"
