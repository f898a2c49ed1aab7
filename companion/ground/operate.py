"""`companion fleet`: one request, from the fleet file to the printed result."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from companion.config.file import read_regular
from companion.config.fleet import FleetConfig
from companion.config.fleet_check import load_fleet
from companion.config.vehicle import ground_endpoints
from companion.ground.answers import (
    AnswerKind,
    accepted_instead,
    answer_lines,
    answers_as_data,
    end_lines,
    id_list,
    instead_lines,
    wrap_text,
)
from companion.ground.belief import Doubt, doubts_as_data, doubts_of
from companion.ground.changes import FleetAction
from companion.ground.commands import OperateError, OperatorCommands, Sent, check_content, statuses_of, wait_for
from companion.ground.current_fleet import simulation_endpoints, unreachable
from companion.ground.goals import Goal, advise_divided_fleet, goal_of
from companion.ground.reports import readiness_as_data, readiness_lines, readiness_of, status_as_data, status_lines
from companion.ground.session import FleetSession
from companion.security.names import ParticipantRole
from companion.types.notices import Notice
from companion.types.status import Status

if TYPE_CHECKING:
    from companion.security.identity import Identity

EXIT_ALL, EXIT_SOME = 0, 1
REPORTS = ("status", "doctor")
ADMIT_EVERY_S = 1.0
ADMITTED_WITHIN_S = 10.0  # agents look for a list every 2 s


@dataclass(frozen=True, slots=True)
class FleetRequest:
    """One action for the fleet in the file `fleet`, with the options of `companion fleet`."""

    action: FleetAction
    fleet: Path
    connect: tuple[str, ...]
    operator: str  # "" for user@host; not used with an identity
    wait_s: float  # for reports and replies
    as_json: bool
    check: bool = False  # only ask what the vehicles would answer
    wait: bool = True  # until the action is finished, after all vehicles have accepted it
    identity: Path | None = None
    timeout_s: float | None = None  # longest wait until the action is finished; None for the default of the action
    admission_list: Path | None = None  # used by the action `admit` only


def run_fleet(request: FleetRequest) -> int:
    """The exit code. Raises ConfigError, OperateError and link.fleet.zenoh_session.EndpointError."""
    fleet = load_fleet(request.fleet)
    ids = _vehicles(request, fleet)
    check_content(request.action, fleet)
    identity = _identity(request, fleet)
    endpoints = request.connect or ground_endpoints(fleet, identity is not None)
    endpoints = endpoints or simulation_endpoints([member.id for member in fleet.vehicles])
    with FleetSession(fleet.name, endpoints, request.operator, identity) as session:
        if request.admission_list:
            return _admit(session, request.admission_list, identity, ids)
        if request.action.name in REPORTS:
            return _report(session, request, fleet, ids, endpoints)
        return _command(session, request, OperatorCommands(session, fleet, request.wait_s), endpoints)


def _identity(request: FleetRequest, fleet: FleetConfig) -> Identity | None:
    """The identity of this ground. Raises ConfigError, and OperateError for one that the vehicles would not obey."""
    if request.identity is None:
        return None
    from companion.link.fleet.identity import load  # without an identity its library is not loaded

    identity = load(request.identity)
    if identity.fleet != fleet.name:
        raise OperateError(f'{request.identity} is of fleet "{identity.fleet}", the fleet file of "{fleet.name}"')
    if request.operator:
        raise OperateError(f"--as is for fleets without identities; the operator is {identity.common_name}")
    readers = (ParticipantRole.GROUND, ParticipantRole.MONITOR)
    wanted = readers if request.action.name in REPORTS else readers[:1]
    if identity.role not in wanted:
        expected = " or a ".join(wanted)
        raise OperateError(f"{identity.common_name} may not do this; expected the identity of a {expected}")
    return identity


def _vehicles(request: FleetRequest, fleet: FleetConfig) -> list[int]:
    """The vehicles of the request. Raises OperateError for one that is not in the fleet file."""
    known = [member.id for member in fleet.vehicles]
    for vehicle_id in (*request.action.only, *request.action.leaders):
        if vehicle_id not in known:
            expected = ", ".join(map(str, known))
            raise OperateError(f"vehicle {vehicle_id} is not in {request.fleet}; expected some of {expected}")
    return sorted(set(request.action.only)) or known


def _report(
    session: FleetSession, request: FleetRequest, fleet: FleetConfig, ids: Sequence[int], endpoints: Sequence[str]
) -> int:
    """Status or readiness; no command is sent."""
    statuses = statuses_of(session.newest, ids, request.wait_s)
    silent = [vehicle_id for vehicle_id in ids if vehicle_id not in statuses]
    if request.action.name == "status":
        doubts = doubts_of(statuses.values(), fleet)
        lines, data = status_lines(statuses, silent, request.wait_s, doubts), status_as_data(statuses, silent, doubts)
        good = not silent
    else:
        checks = readiness_of(statuses, fleet)
        lines, data = readiness_lines(checks, silent, request.wait_s), readiness_as_data(checks, silent)
        good = not silent and all(check.passed for of_one in checks.values() for check in of_one)
    failed_endpoints = unreachable(endpoints, session.linked()) if silent else {}
    if request.as_json:
        _print_json(request, data, unreachable=failed_endpoints)
    else:
        _print([*lines, *_endpoint_lines(failed_endpoints)])
    return EXIT_ALL if good else EXIT_SOME


def _admit(session: FleetSession, file: Path, identity: Identity | None, ids: Sequence[int]) -> int:
    """Sends an admission list, until each vehicle reports its number. Raises OperateError for a file that is none."""
    if identity is None:
        raise OperateError("needs the identity of a ground: --identity DIR")
    from companion.security.admission import MAX_LIST_BYTES, AdmissionError, verify

    try:
        data, _ = read_regular(file, MAX_LIST_BYTES)
        number = verify(data, identity.authority).number
    except OSError as error:
        raise OperateError(f"{file}: cannot be read: {error.strerror}") from error
    except AdmissionError as error:
        raise OperateError(f"{file}: {error}") from error
    end_s = time.monotonic() + ADMITTED_WITHIN_S
    while True:
        session.send_admission_list(data)
        time.sleep(ADMIT_EVERY_S)
        statuses = session.newest()
        good = all(_holds(statuses.get(i), number) for i in ids)
        if good or time.monotonic() > end_s:
            break
    _print([_admission_line(i, statuses.get(i), number) for i in ids])
    return EXIT_ALL if good else EXIT_SOME


def _holds(status: Status | None, number: int) -> bool:
    return status is not None and status.network.admission is not None and status.network.admission >= number


def _admission_line(vehicle_id: int, status: Status | None, number: int) -> str:
    if status is None:
        return f"vehicle {vehicle_id:<3} {AnswerKind.MISSING}  no report"
    held = status.network.admission
    kind = AnswerKind.ACCEPTED if _holds(status, number) else AnswerKind.MISSING
    return f"vehicle {vehicle_id:<3} {kind}  holds list {'none' if held is None else held}, sent was {number}"


def _command(session: FleetSession, request: FleetRequest, commands: OperatorCommands, endpoints: Sequence[str]) -> int:
    sent = commands.check(request.action) if request.check else commands.send(request.action)
    instead = accepted_instead(request.action, sent.content, sent.outcomes)
    missing = any(outcome.kind is AnswerKind.MISSING for outcome in sent.outcomes.values())
    failed_endpoints = unreachable(endpoints, session.linked()) if missing else {}
    if not request.as_json:
        more_lines = [*_absent_lines(sent.absent), *_lines(sent.doubts), *_endpoint_lines(failed_endpoints)]
        _print([*_lines(sent.warnings), *answer_lines(sent.outcomes), *instead_lines(instead), *more_lines])
    goal = goal_of(sent.name, sent.content, sent.running) if request.wait and not request.check else None
    if goal and any(outcome.kind is AnswerKind.ACCEPTED for outcome in sent.outcomes.values()):
        sent = _waited(session, request, sent, goal)
    advice = None if request.check else advise_divided_fleet(sent.name, sent.outcomes)
    if request.as_json:
        more: dict[str, Any] = {"advice": str(advice)} if advice else {}
        more |= {"check": True} if request.check else {}
        more |= {"instead": instead} if instead else {}
        more |= {"absent": list(sent.absent)} if sent.absent else {}
        more |= {"doubts": doubts_as_data(sent.doubts)} if sent.doubts else {}
        more |= {"warnings": sent.warnings} if sent.warnings else {}
        data = answers_as_data(sent.outcomes)
        _print_json(request, data, operator=session.operator, unreachable=failed_endpoints, **more)
    elif advice:
        _print(wrap_text("", str(advice)))
    return EXIT_ALL if all(outcome.good for outcome in sent.outcomes.values()) else EXIT_SOME


def _waited(session: FleetSession, request: FleetRequest, sent: Sent, goal: Goal) -> Sent:
    """Progress goes to standard error, the result to standard output."""
    timeout_s = request.timeout_s or goal.timeout_s
    outcomes = wait_for(goal, sent.outcomes, session.newest, timeout_s, _show_progress)
    if not request.as_json:
        _print(end_lines(outcomes, goal.text))
    return replace(sent, outcomes=outcomes)


def _show_progress(line: str) -> None:
    print("\n".join(wrap_text("", line)), file=sys.stderr, flush=True)


def _absent_lines(absent: Sequence[int]) -> list[str]:
    if not absent:
        return []
    text = f"{id_list(absent)} without a report: counted as absent, no command sent; slots are kept free for them"
    return wrap_text("", text)


def _lines(found: Sequence[Doubt | Notice]) -> list[str]:
    return [line for one in found for line in wrap_text("", str(one))]


def _endpoint_lines(failed: dict[str, str]) -> list[str]:
    return [line for endpoint, reason in failed.items() for line in wrap_text(f"unreachable: {endpoint}: ", reason)]


def _print(lines: Sequence[str]) -> None:
    print("\n".join(lines), flush=True)


def _print_json(request: FleetRequest, vehicles: list[dict[str, Any]], **more: Any) -> None:
    print(msgspec.json.encode({"action": request.action.name, **more, "vehicles": vehicles}).decode())
