"""`companion fleet`: one command to a fleet, and what each vehicle answers."""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from typing import Any

import msgspec

from companion import GROUND_INSTALL
from companion.arguments import COMMAND_LINE
from companion.config.fleet import FleetConfig, load_fleet
from companion.config.reference import check_reference
from companion.fleet_options import FleetOptions
from companion.fleet_where_options import FormationWish, ReferenceWish
from companion.ground.answers import (
    answer_lines,
    answers_as_data,
    readiness_as_data,
    readiness_lines,
    status_as_data,
    status_lines,
)
from companion.ground.monitor import DEFAULT_ENDPOINTS
from companion.ground.readiness import checks_of
from companion.ground.references import reference_change, wished
from companion.ground.session import POLL_S, Answer, FleetSession
from companion.types import ZERO3, CommandName, FlightPhase, FormationChange, Lead, ReferenceChange, Status

EXIT_ALL, EXIT_SOME = 0, 1
PREPARED_WITHIN_S = 8.0  # what an autopilot may take for a change of its mode, with some to spare
UNDER_WAY = (FlightPhase.OBSERVE, FlightPhase.PREPARE)


class OperateError(Exception):
    """Nothing was asked. str() is one line with what to do."""


def run_fleet(options: FleetOptions) -> int:
    """The exit code. Raises ConfigError, OperateError and link.zenoh_session.EndpointError."""
    fleet = load_fleet(options.fleet)
    ids = _vehicles(options, fleet)
    _check_wishes(options, fleet)
    with FleetSession.open(fleet.name, options.connect or DEFAULT_ENDPOINTS, options.operator) as session:
        if options.action in ("status", "ready"):
            return _show(session, options, fleet, ids)
        answers = _give(session, options, fleet, ids)
        operator = session.operator
    if options.as_json:
        _print_json(options, answers_as_data(answers, options.wait_s), operator=operator)
    else:
        print("\n".join(answer_lines(answers, options.wait_s)))
    return EXIT_ALL if all(answer and answer.reply.accepted for answer in answers.values()) else EXIT_SOME


def _vehicles(options: FleetOptions, fleet: FleetConfig) -> list[int]:
    """Who is asked. Raises OperateError for one that is not in the fleet file."""
    known = [member.id for member in fleet.vehicles]
    for vehicle_id in (*options.only, *options.leaders):
        if vehicle_id not in known:
            expected = ", ".join(map(str, known))
            raise OperateError(f"vehicle {vehicle_id} is not in {options.fleet}; expected some of {expected}")
    return sorted(set(options.only)) or known


def _show(session: FleetSession, options: FleetOptions, fleet: FleetConfig, ids: Sequence[int]) -> int:
    """Nothing is asked of the vehicles."""
    statuses = session.hear(ids, options.wait_s)
    silent = [vehicle_id for vehicle_id in ids if vehicle_id not in statuses]
    if options.action == "status":
        lines, data = status_lines(statuses, silent, options.wait_s), status_as_data(statuses, silent)
        fit = not silent
    else:
        every, own_hash = [member.id for member in fleet.vehicles], fleet.formation_hash()
        checks = {i: checks_of(status, every, own_hash) for i, status in statuses.items()}
        lines, data = readiness_lines(checks, silent, options.wait_s), readiness_as_data(checks, silent)
        fit = not silent and all(check.fit for of_one in checks.values() for check in of_one)
    if options.as_json:
        _print_json(options, data)
    else:
        print("\n".join(lines))
    return EXIT_ALL if fit else EXIT_SOME


def _give(
    session: FleetSession, options: FleetOptions, fleet: FleetConfig, ids: Sequence[int]
) -> dict[int, Answer | None]:
    if options.action == "arm":
        return _prepare_and_arm(session, ids, options.wait_s)
    if options.action == "leader":
        heard = session.hear(ids, options.wait_s)
        lead = Lead(options.leaders, max((status.epoch for status in heard.values()), default=0) + 1)
        return _hand_lead_over(session, ids, lead, options.wait_s)
    if options.formation:
        formation = _new_formation(session, options.formation, options.wait_s, fleet)
        return session.ask(ids, CommandName.FORMATION, options.wait_s, formation)
    if options.reference:
        may_lead = [member.id for member in fleet.vehicles if member.can_lead]
        reference = _new_reference(session, options.reference, options.wait_s, fleet)
        return session.ask(may_lead, CommandName.REFERENCE, options.wait_s, reference)
    return session.ask(ids, CommandName(options.action), options.wait_s)


def _hand_lead_over(session: FleetSession, ids: Sequence[int], lead: Lead, wait_s: float) -> dict[int, Answer | None]:
    """Who is to lead is asked first; the others, who leads now among them, only where all of those took the lead.

    So nobody gives the lead up that nobody takes. Whoever is not asked hears of it from those that took it.
    """
    answers = session.ask(lead.leaders, CommandName.LEAD, wait_s, lead)
    if not all(answer and answer.reply.accepted for answer in answers.values()):
        return answers
    return answers | session.ask([i for i in ids if i not in lead.leaders], CommandName.LEAD, wait_s, lead)


def _prepare_and_arm(session: FleetSession, ids: Sequence[int], wait_s: float) -> dict[int, Answer | None]:
    """Those that only observe are prepared first; who refuses that is not asked to arm."""
    observing = [i for i, s in session.hear(ids, wait_s).items() if s.phase is FlightPhase.OBSERVE]
    answers = session.ask(observing, CommandName.PREPARE, wait_s)
    prepared = [i for i, answer in answers.items() if answer and answer.reply.accepted]
    _wait_for_end_of(session, prepared)
    return answers | session.ask([i for i in ids if i not in answers or i in prepared], CommandName.ARM, wait_s)


def _wait_for_end_of(session: FleetSession, preparing: Collection[int]) -> None:
    """Until all are prepared, one way or the other; what is still under way refuses to arm in its own words."""
    deadline_s = time.monotonic() + PREPARED_WITHIN_S
    while time.monotonic() < deadline_s:
        heard = session.newest()
        if not any(i in heard and heard[i].phase in UNDER_WAY for i in preparing):
            return
        time.sleep(POLL_S)


def _check_wishes(options: FleetOptions, fleet: FleetConfig) -> None:
    """A mistake is told before any vehicle is waited for. Raises ConfigError and OperateError."""
    if options.formation:
        _need_scipy()
        from companion.ground.formations import check_wish

        check_wish(options.formation, fleet)
    if options.reference:
        wished(options.reference, here_enu_m=ZERO3)


def _new_formation(session: FleetSession, wish: FormationWish, wait_s: float, fleet: FleetConfig) -> FormationChange:
    """From where the vehicles are. Raises OperateError where some are not heard: it would be for them, too."""
    from companion.ground.formations import change_to, places_enu_m, refusal_of, wished_slots

    heard = _hear_all(session, wait_s, fleet)
    if silent := [str(member.id) for member in fleet.vehicles if member.id not in heard]:
        raise OperateError(f"nothing heard of vehicle {', '.join(silent)} for {wait_s:g} s; all get new slots")
    statuses = list(heard.values())
    slots_enu_m = wished_slots(wish, statuses, fleet)
    if refusal := refusal_of(slots_enu_m, places_enu_m(statuses), fleet.separation_m):
        raise OperateError(refusal)
    return change_to(slots_enu_m, statuses, fleet.slot_speed_m_s)


def _new_reference(session: FleetSession, wish: ReferenceWish, wait_s: float, fleet: FleetConfig) -> ReferenceChange:
    """Checked with the slots that the vehicles fly, as each that may lead does. Raises ConfigError and OperateError."""
    heard = _hear_all(session, wait_s, fleet)
    if not heard:
        raise OperateError(f"nothing heard of any vehicle for {wait_s:g} s")
    led = [status.reference_enu_m for status in heard.values() if status.reference_enu_m]
    reference = wished(wish, here_enu_m=led[0] if led else None)
    slots_enu_m = {i: status.slot.position_enu_m for i, status in heard.items()}
    check_reference(wish.file or COMMAND_LINE, fleet, reference, slots_enu_m=slots_enu_m)
    return reference_change(msgspec.to_builtins(reference), list(heard.values()))


def _hear_all(session: FleetSession, wait_s: float, fleet: FleetConfig) -> dict[int, Status]:
    return session.hear([member.id for member in fleet.vehicles], wait_s)


def _need_scipy() -> None:
    """Slots are assigned with it. Raises OperateError."""
    try:
        import scipy.optimize  # noqa: F401
    except ImportError as error:
        raise OperateError(f"formations need the package scipy: {GROUND_INSTALL}") from error


def _print_json(options: FleetOptions, vehicles: list[dict[str, Any]], **more: str) -> None:
    print(msgspec.json.encode({"action": options.action, **more, "vehicles": vehicles}).decode())
