"""Numbered changes that begin at a mission time in all vehicles, or in none.

Theory of operation. A change of the formation or of the reference is a message with a number and a mission time. It reaches
the vehicles by command, or passed on by a leader, at different times and perhaps not all of them. A vehicle that flies the new
slots among vehicles in the old ones is in their path, so what counts is not that a vehicle has the change but that all have it.
There is no vote and no coordinator. Each vehicle

  1. checks the change itself (its number, its time, its slots or RFT) and then lets it wait: `waiting`;
  2. publishes two numbers in every packet, that of what it flies and that of what waits, the same one if nothing does;
  3. in the first tick at or after `begins_s` looks at the newest packet of every fresh peer concerned. If each has the number,
     flown or waiting, it begins; else it cancels.

All clocks are mission time (`election/beacon.py`), so all vehicles decide within a tick or two of each other. They decide by
the same facts where those have been true for longer than a packet needs. This is why a change must be known for a while
before it begins (`known_for_s`), and why near its beginning nothing may replace it.

                 accepted                    begins_s, all have it
    (nothing) --------------> waiting ---------------------------------> flown
        ^                      |  |  ^
        |  withdrawn, or       |  |  | a newer one is accepted
        |  mission time        |  +--+
        |  restarts            |
        +----------------------+---- begins_s, a peer lacks it, or its conditions have changed: cancelled, with an event

Two vehicles may still decide differently: packets of one peer may be lost for one of them in the last moment. Then one flies
the new slots and the others the old ones. Nothing in this module resolves that; the separation filter keeps them apart, the
number in their packets shows it, and the next change or a leader that passes on the formation flown mends it.

Numbers rise from change to change. A number that is not newer is a late message of before, one that is far ahead is wrong: a
single packet with the largest number would keep out every later change.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Generic, Protocol, TypeVar

from companion.core.election.beacon import FALLS_BACK_S
from companion.types.commands import NUMBERS_AHEAD
from companion.types.notices import Code, Notice

LATEST_S = 60.0  # ahead of mission time; a change that is farther away was made for another flight


class NumberedChange(Protocol):
    """A change that begins at a mission time."""

    @property
    def number(self) -> int: ...

    @property
    def begins_s(self) -> float: ...


Change = TypeVar("Change", bound=NumberedChange)


class Agreement(Generic[Change]):
    """The change that waits, and mission time as this vehicle last knew it. `subject` names it in notices."""

    def __init__(self, subject: str, cancelled: Code, known_for_s: float = 0.0) -> None:
        """Before it begins a change must be known for `known_for_s`. `cancelled` is the code of that event."""
        self._subject = subject
        self._cancelled = cancelled
        self._known_for_s = known_for_s
        self.waiting: Change | None = None
        self.reference_s = 0.0

    def refusal_if_too_new(self, number: int, flown: int) -> Notice | None:
        """The refusal of a number that no vehicle can have counted to."""
        if number <= flown + NUMBERS_AHEAD:
            return None
        return Notice(Code.CHANGE_TOO_NEW, f"number {number} is too far ahead of {flown}")

    def refusal_if_too_old(self, number: int, flown: int, is_command: bool) -> Notice | None:
        """The refusal of a number that is not newer. A command may also have a smaller one: the one flown was wrong then."""
        if number > flown or (number < flown and is_command):
            return None
        return Notice(Code.CHANGE_TOO_OLD, f"number {number} is not newer than {flown}")

    def refusal_of_time(self, change: Change, reference_s: float) -> Notice | None:
        """The refusal of a change that begins too soon or too late."""
        earliest_s, begins_s = reference_s + self._known_for_s, change.begins_s
        is_early = begins_s < earliest_s if self._known_for_s > 0.0 else begins_s <= earliest_s
        if not is_early and begins_s <= reference_s + LATEST_S:
            return None
        text = f"begins at mission time {begins_s:.1f} s, which is {reference_s:.1f} s now"
        if self._known_for_s > 0.0:
            text += f"; expected {self._known_for_s:g} to {LATEST_S:g} s ahead"
        return Notice(Code.CHANGE_NOT_IN_TIME, text)

    def falls_back(self, reference_s: float) -> bool:
        """Whether mission time restarted since the last tick: the leader has landed or restarted."""
        return reference_s < self.reference_s - FALLS_BACK_S

    def take_due(self, reference_s: float) -> Change | None:
        """The change that waits, where its time has come. It waits no longer then."""
        waiting = self.waiting
        if waiting is None or reference_s < waiting.begins_s:
            return None
        self.waiting = None
        return waiting

    def lacked_by(self, change: Change, held: Iterable[tuple[int, int, int]]) -> str:
        """Which peer lacks the change; "" where all have it. `held`: id, number flown and number that waits of each."""
        lacking = [vehicle_id for vehicle_id, flown, waiting in held if change.number not in (flown, waiting)]
        return f"vehicle {min(lacking)} does not have it" if lacking else ""

    def cancel(self, change: Change, reason: str) -> tuple[Notice, ...]:
        """The event of a change that does not begin."""
        return (Notice(self._cancelled, f"{self._subject} {change.number} does not begin: {reason}"),)

    def restart(self) -> tuple[Notice, ...]:
        """Mission time restarts: nothing waits any more. The event where something did."""
        waiting, self.waiting = self.waiting, None
        return self.cancel(waiting, "the mission time restarts") if waiting else ()
