"""Commands from the ground and their replies."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import Annotated

from msgspec import Meta, Struct

from companion.types.formation import FormationChange
from companion.types.notices import Accepts, Code
from companion.types.values import MAX_NUMBER, Finite, Line, MissionTime, Number, VehicleId, VehicleIds, Word


class CommandName(StrEnum):
    """Commands of an operator or a scenario to a vehicle."""

    PREPARE = "prepare"
    ARM = "arm"
    TAKEOFF = "takeoff"
    FORM = "form"
    HOLD = "hold"
    LAND = "land"
    RETURN = "return"
    DISARM = "disarm"
    LEAD = "lead"
    FORMATION = "formation"
    REFERENCE = "reference"
    TAKE = "take"  # take over command from the operator who holds it
    ABORT = "abort"  # disarm on the ground, the autopilot's hold mode in the air


NOT_CHECKED = frozenset({CommandName.TAKE, CommandName.ABORT})  # they are accepted whenever they are given

MAX_EPOCH = 2**31 - 1
NUMBERS_AHEAD = 1000  # numbers and epochs further ahead of the own one are refused: a wrong one cannot use up all
EPOCHS_AHEAD = 8  # so many changes of leader may be missed at once: a peer's epoch is at most this far ahead


class Lead(Struct, frozen=True, gc=False, tag=True):
    """The leaders from now on; all other vehicles follow. Every vehicle gets the command.

    A vehicle returns to an older epoch only from one that is more than EPOCHS_AHEAD newer, and so was wrong.
    """

    leaders: VehicleIds
    epoch: Annotated[int, Meta(ge=0, le=MAX_EPOCH)]


_Numbers = Annotated[list[Finite], Meta(max_length=4)]
# A text without a pattern: msgspec 0.22 frees memory twice where a union has both a pattern and a list.
_Text = Annotated[str, Meta(max_length=80)]
Described = dict[Word, bool | int | Finite | _Text | Annotated[list[Finite | _Numbers], Meta(max_length=200)]]
"""A section of a file as plain values."""


class ReferenceChange(Struct, frozen=True, gc=False, tag=True):
    """Another reference for the vehicles that may lead, from the mission time `begins_s` on.

    Its own time begins then. `reference` is the content of a section `reference` of a vehicle file.
    """

    number: Number
    reference: Annotated[Described, Meta(max_length=20)]
    begins_s: MissionTime


Content = Lead | FormationChange | ReferenceChange


OPERATOR = r"[A-Za-z0-9][A-Za-z0-9_.@+-]{0,62}"  # it is shown on terminals and in logs
OPERATOR_WORDS = "1 to 63 letters, digits, _ . @ + -, a letter or digit first, like anna@ground"
Operator = Annotated[str, Meta(pattern=rf"^{OPERATOR}\Z")]


class Command(Struct, frozen=True, gc=False):
    """A command; executed once. Its sender repeats it until it is answered.

    `core/command/arbitration.py` refuses old ones and other operators.
    """

    name: CommandName
    number: Annotated[int, Meta(ge=1, le=MAX_NUMBER)]  # larger than that of the last command; repeated in the reply
    operator: Operator  # sender of the command, the same in all programs of one operator
    session: Number  # session of the agent that is commanded, as its status reports it
    content: Content | None = None  # its type is the one that CONTENT has for this command name


def next_number(last: int, reported: int) -> int:
    """Number of the next command to a vehicle, above the last one given to it and the last one that it reports.

    A last number above all that the vehicle accepts came from a wrong report: it is forgotten.
    """
    return last + 1 if reported < last < reported + NUMBERS_AHEAD else reported + 1


def is_newer(number: int, given: int) -> bool:
    """Whether a number, or an epoch, came after the given one. One that is too far above it was wrong."""
    return given < number <= given + NUMBERS_AHEAD


def next_epoch(reported: Iterable[int]) -> int:
    """Epoch of the next command `lead`, which all vehicles in these epochs accept."""
    return next_for_all(reported, wrong_from=EPOCHS_AHEAD + 1)


def next_for_all(reported: Iterable[int], wrong_from: int = 1) -> int:
    """Number of the next formation or reference, or the next epoch, that all vehicles with these numbers accept.

    It is above all of them, but for those that are too far above the smallest: they were wrong. A vehicle with such a number
    accepts any number that is smaller by `wrong_from` or more.
    """
    known = set(reported) or {0}
    least = min(known)
    last = max(number for number in known if number < least + NUMBERS_AHEAD)
    free = (n for n in range(last + 1, least, -1) if not any(n <= number < n + wrong_from for number in known))
    return next(free, last + 1)


CONTENT: dict[CommandName, type] = {
    CommandName.LEAD: Lead,
    CommandName.FORMATION: FormationChange,
    CommandName.REFERENCE: ReferenceChange,
}


class CommandReply(Struct, frozen=True, gc=False, omit_defaults=True):
    """Reply to one command, or to the check of one. `code` and `reason`: why it is refused, or what happens now.

    `operator` and `number` are those of the command: all programs on the ground receive all replies. `accepts`: keys of its
    content with values that would be accepted, where the vehicle knows them; `scale` is a factor on the slots of a formation.
    """

    vehicle_id: VehicleId
    number: Number
    accepted: bool
    code: Code
    reason: Line
    operator: Operator
    accepts: Accepts = ()
