"""Words for what the vehicles said: a line each, or one JSON object. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from companion.ground.readiness import Check
from companion.ground.session import Answer
from companion.ground.words import formation_in_words, reference_in_words
from companion.types import Status

MISSING = "missing"


def outcome_of(answer: Answer | None) -> str:
    if answer is None:
        return MISSING
    return "accepted" if answer.reply.accepted else "refused"


def answer_lines(answers: Mapping[int, Answer | None], wait_s: float) -> list[str]:
    """ "vehicle 2  refused    21 ms  why"; by vehicle."""
    lines = []
    for vehicle_id, answer in sorted(answers.items()):
        took = f"{answer.after_s * 1000.0:.0f} ms" if answer else ""
        reason = answer.reply.reason if answer else no_answer(wait_s)
        lines.append(_plain(f"vehicle {vehicle_id:<3} {outcome_of(answer):<8} {took:>7}  {reason}"))
    return lines


def answers_as_data(answers: Mapping[int, Answer | None], wait_s: float) -> list[dict[str, Any]]:
    """`after_s` is null where no answer came."""
    return [
        {
            "vehicle_id": vehicle_id,
            "answer": outcome_of(answer),
            "reason": answer.reply.reason if answer else no_answer(wait_s),
            "after_s": round(answer.after_s, 4) if answer else None,
        }
        for vehicle_id, answer in sorted(answers.items())
    ]


def no_answer(wait_s: float) -> str:
    return f"no answer within {wait_s:g} s"


def readiness_lines(checks: Mapping[int, Sequence[Check]], silent: Sequence[int], wait_s: float) -> list[str]:
    """Per vehicle whether it is ready, and below it each check."""
    lines = []
    for vehicle_id in sorted({*checks, *silent}):
        if vehicle_id in silent:
            lines.append(f"vehicle {vehicle_id}  {MISSING}: {nothing_heard(wait_s)}")
            continue
        ready = all(check.fit for check in checks[vehicle_id])
        lines.append(f"vehicle {vehicle_id}  {'ready' if ready else 'not ready'}")
        lines += [
            _plain(f"  {check.name:<11} {'ok' if check.fit else '--'}  {check.found}") for check in checks[vehicle_id]
        ]
    return lines


def readiness_as_data(checks: Mapping[int, Sequence[Check]], silent: Sequence[int]) -> list[dict[str, Any]]:
    """`checks` is empty of a vehicle that is not heard."""
    told = {
        vehicle_id: [{"check": c.name, "fit": c.fit, "found": c.found} for c in list_]
        for vehicle_id, list_ in checks.items()
    }
    return [
        {"vehicle_id": i, "ready": i in checks and all(c.fit for c in checks[i]), "checks": told.get(i, [])}
        for i in sorted({*checks, *silent})
    ]


def status_lines(statuses: Mapping[int, Status], silent: Sequence[int], wait_s: float) -> list[str]:
    lines = []
    for vehicle_id in sorted({*statuses, *silent}):
        if vehicle_id in silent:
            lines.append(f"vehicle {vehicle_id:<3} {MISSING}: {nothing_heard(wait_s)}")
            continue
        status = statuses[vehicle_id]
        x, y, z = status.position_enu_m
        words = (
            f"vehicle {vehicle_id:<3} {status.phase:<9} {status.role:<8} {'armed' if status.armed else 'disarmed':<8}"
            f" {status.mode_name:<12} at {x:z.1f}, {y:z.1f}, {z:z.1f} m,"
            f" formation {formation_in_words(status.slot, status.heading)},"
            f" reference {reference_in_words(status.reference, status.target_age_s)},"
            f" commanded by {status.holder or 'nobody'}; {status.last_event or 'nothing has happened'}"
        )
        lines.append(_plain(words))
    return lines


def status_as_data(statuses: Mapping[int, Status], silent: Sequence[int]) -> list[dict[str, Any]]:
    """All that a vehicle says, with `heard`."""
    heard = {i: msgspec.to_builtins(status) | {"heard": True} for i, status in statuses.items()}
    return [heard.get(i, {"vehicle_id": i, "heard": False}) for i in sorted({*statuses, *silent})]


def nothing_heard(wait_s: float) -> str:
    return f"nothing heard of it for {wait_s:g} s"


def _plain(text: str) -> str:
    """Reasons and events quote the autopilot's own words: nothing of them may steer the terminal."""
    return "".join(c if c.isprintable() else "?" for c in text)
