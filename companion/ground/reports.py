"""Status and readiness of the vehicles, as lines and as data. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from companion.ground.answers import AnswerKind
from companion.ground.fleet_status import formation_text, reference_text
from companion.ground.readiness import Check
from companion.ground.text import wrapped
from companion.types.notices import Code, Notice
from companion.types.status import Status

INDENT = " " * 12


def readiness_lines(checks: Mapping[int, Sequence[Check]], silent: Sequence[int], wait_s: float) -> list[str]:
    """Per vehicle whether it is ready, and below it each check."""
    lines = []
    for vehicle_id in sorted({*checks, *silent}):
        if vehicle_id in silent:
            lines += wrapped(f"vehicle {vehicle_id}  {AnswerKind.MISSING}  ", str(no_report(wait_s)))
            continue
        ready = all(check.passed for check in checks[vehicle_id])
        warned = ready and any(check.warnings for check in checks[vehicle_id])
        lines.append(f"vehicle {vehicle_id}  {'ready' if ready else 'not ready'}{', with warnings' if warned else ''}")
        for check in checks[vehicle_id]:
            lines += wrapped(f"  {check.name:<11} {'ok' if check.passed else '--'}  ", check.found)
    return lines


def readiness_as_data(checks: Mapping[int, Sequence[Check]], silent: Sequence[int]) -> list[dict[str, Any]]:
    """`checks` is empty for a vehicle without a report; `codes` of a check is empty where it passed."""
    data = {
        vehicle_id: [
            {
                "check": c.name,
                "passed": c.passed,
                "codes": list(c.codes),
                "warnings": list(c.warnings),
                "found": c.found,
            }
            for c in of_one
        ]
        for vehicle_id, of_one in checks.items()
    }
    return [
        {"vehicle_id": i, "ready": i in checks and all(c.passed for c in checks[i]), "checks": data.get(i, [])}
        for i in sorted({*checks, *silent})
    ]


def status_lines(statuses: Mapping[int, Status], silent: Sequence[int], wait_s: float) -> list[str]:
    """Two lines or more for each vehicle."""
    lines = []
    for vehicle_id in sorted({*statuses, *silent}):
        if vehicle_id in silent:
            lines += wrapped(f"vehicle {vehicle_id:<3} {AnswerKind.MISSING}  ", str(no_report(wait_s)))
        else:
            lines += _status_lines(statuses[vehicle_id])
    return lines


UNSECURED = "UNSECURED: strangers in its network can command it (security: none in the fleet file)"


def _status_lines(status: Status) -> list[str]:
    x, y, z = status.position_enu_m
    battery = "unknown" if status.battery_percent is None else f"{status.battery_percent:.0f} %"
    state = (
        f"{status.phase:<9} {status.role:<8} {'armed' if status.armed else 'disarmed':<8} {status.mode_name:<12}"
        f" at {x:z.1f}, {y:z.1f}, {z:z.1f} m"
    )
    flown = (
        f"formation {formation_text(status.slot, status.heading)},"
        f" reference {reference_text(status.reference, status.target_age_s)},"
        f" operator {status.holder or '-'}, battery {battery}"
    )
    event = [UNSECURED] if status.network.security == "none" else []
    event += [str(status.last_event)] if status.last_event else []
    return [
        *wrapped(f"vehicle {status.vehicle_id:<3} ", state),
        *wrapped(INDENT, flown),
        *(line for text in event for line in wrapped(INDENT, text)),
    ]


def status_as_data(statuses: Mapping[int, Status], silent: Sequence[int]) -> list[dict[str, Any]]:
    """The whole report of each vehicle, with `reported`."""
    data = {i: msgspec.to_builtins(status) | {"reported": True} for i, status in statuses.items()}
    return [data.get(i, {"vehicle_id": i, "reported": False}) for i in sorted({*statuses, *silent})]


def no_report(wait_s: float) -> Notice:
    return Notice(Code.NO_REPORT, f"no report for {wait_s:g} s")
