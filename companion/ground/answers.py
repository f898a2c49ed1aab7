"""The outcome of a command for each vehicle, as lines and as data, and how lines are wrapped. Pure."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import floor
from typing import Any

from companion.config.reference import ASKED
from companion.ground.changes import FleetAction
from companion.types.commands import CommandReply, Content, ReferenceChange
from companion.types.notices import Code, Notice
from companion.types.values import printable

SCALE = "scale"  # a factor on the slots of a formation
ROUNDED = 1e-9  # of a product that is a round number


class AnswerKind(StrEnum):
    ACCEPTED = "accepted"
    REFUSED = "refused"
    MISSING = "missing"  # no reply came
    NOT_SENT = "not sent"  # a check before the command failed, of this vehicle or of another


@dataclass(frozen=True, slots=True)
class TimedReply:
    """A vehicle's reply to a command, and the time from the command to it."""

    reply: CommandReply
    after_s: float


@dataclass(frozen=True, slots=True)
class End:
    """The end of an accepted action: whether the vehicle has finished it, and the time since the command."""

    finished: bool
    after_s: float
    notice: Notice


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of one command for one vehicle: `number` of the command, `after_s` to its reply, `end` None without --wait.

    The notice of a refusal has what would be accepted instead, where the vehicle knows it.
    """

    kind: AnswerKind
    notice: Notice
    after_s: float | None = None
    number: int = 0
    end: End | None = None

    @property
    def good(self) -> bool:
        """Accepted, and finished where that was waited for."""
        return self.kind is AnswerKind.ACCEPTED and (self.end is None or self.end.finished)


def outcome_of(answer: TimedReply | None, wait_s: float) -> Outcome:
    if answer is None:
        return Outcome(AnswerKind.MISSING, Notice(Code.NO_REPLY, f"no reply within {wait_s:g} s"))
    reply = answer.reply
    kind = AnswerKind.ACCEPTED if reply.accepted else AnswerKind.REFUSED
    return Outcome(kind, Notice(reply.code, reply.reason, reply.accepts), answer.after_s, reply.number)


def answer_lines(outcomes: Mapping[int, Outcome]) -> list[str]:
    """ "vehicle 2   refused    21 ms  CODE: reason", wrapped; by vehicle."""
    lines = []
    for vehicle_id, outcome in sorted(outcomes.items()):
        took = "" if outcome.after_s is None else f"{outcome.after_s * 1000.0:.0f} ms"
        lines += wrap_text(f"vehicle {vehicle_id:<3} {outcome.kind:<8} {took:>7}  ", str(outcome.notice))
    return lines


def accepted_instead(action: FleetAction, content: Content | None, outcomes: Mapping[int, Outcome]) -> dict[str, float]:
    """Keys of this request, each with a value that all vehicles would accept; empty where one that refuses knows none."""
    refused = [dict(one.notice.accepts) for one in outcomes.values() if one.kind is AnswerKind.REFUSED]
    if not refused or not all(refused):
        return {}
    if isinstance(content, ReferenceChange):
        asked = {key: value for key, value in content.reference.items() if isinstance(value, int | float)}
        known = {key: [of[key] for of in refused if key in of] for key in refused[0] if key in asked}
        return {key: max(values, key=lambda value: abs(value - asked[key])) for key, values in known.items()}
    if action.formation is None:
        return {}
    scale, request = min(of[SCALE] for of in refused), action.formation
    if request.shape and request.spacing_m is not None:
        return {"spacing_m": floor(request.spacing_m * scale * 100.0 + ROUNDED) / 100.0}
    return {SCALE: floor(request.scale * scale * 1000.0 + ROUNDED) / 1000.0}


def instead_lines(accepted: Mapping[str, float]) -> list[str]:
    """ "accepted would be --spacing 61.5"."""
    options = {"spacing_m": "--spacing", SCALE: "--scale"} | {key: asked.option for key, asked in ASKED.items()}
    given = " ".join(f"{options.get(key, key)} {value:g}" for key, value in accepted.items())
    return wrap_text("", f"accepted would be {given}") if given else []


def end_lines(outcomes: Mapping[int, Outcome], goal: str) -> list[str]:
    """Whether all vehicles have finished, and a line for each that has not."""
    ends = {vehicle_id: outcome.end for vehicle_id, outcome in sorted(outcomes.items()) if outcome.end}
    missed = {vehicle_id: end for vehicle_id, end in ends.items() if not end.finished}
    lines = [
        line
        for vehicle_id, end in missed.items()
        for line in wrap_text(f"vehicle {vehicle_id:<3} not finished  ", str(end.notice))
    ]
    finished = len(ends) - len(missed)
    after_s = max((end.after_s for end in ends.values()), default=0.0)
    return [*lines, f"{finished} of {count(len(outcomes))} {goal} ({after_s:.1f} s)"]


def answers_as_data(outcomes: Mapping[int, Outcome]) -> list[dict[str, Any]]:
    """`after_s` is null where no reply came; `finished` is null where it was not waited for."""
    return [
        {
            "vehicle_id": vehicle_id,
            "answer": outcome.kind,
            "code": outcome.notice.code,
            "reason": outcome.notice.text,
            "after_s": None if outcome.after_s is None else round(outcome.after_s, 4),
            **({"accepts": dict(outcome.notice.accepts)} if outcome.notice.accepts else {}),
            **_end_as_data(outcome.end),
        }
        for vehicle_id, outcome in sorted(outcomes.items())
    ]


def _end_as_data(end: End | None) -> dict[str, Any]:
    if end is None:
        return {"finished": None}
    return {
        "finished": end.finished,
        "finished_after_s": round(end.after_s, 2) if end.finished else None,
        "end_code": end.notice.code,
        "end_reason": end.notice.text,
    }


WIDEST, NARROWEST = 100, 60  # columns of an answer


def wrap_text(head: str, text: str) -> list[str]:
    """`head` and the text in lines of at most WIDEST columns, fewer on a narrow terminal; the text is indented below itself."""
    columns = shutil.get_terminal_size((WIDEST, 24)).columns
    width = min(WIDEST, max(NARROWEST, columns))
    return textwrap.wrap(
        printable(text),
        width,
        initial_indent=head,
        subsequent_indent=" " * min(len(head), width // 2),
        break_on_hyphens=False,
    ) or [head.rstrip()]


def count(vehicles: int) -> str:
    return f"{vehicles} vehicle{'' if vehicles == 1 else 's'}"


def id_list(vehicle_ids: Collection[int]) -> str:
    """ "vehicle 3" or "vehicles 1, 2"."""
    plural = "" if len(vehicle_ids) == 1 else "s"
    return f"vehicle{plural} {', '.join(map(str, sorted(vehicle_ids)))}"
