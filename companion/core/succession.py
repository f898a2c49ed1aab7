"""Without a leader: how long formation goes on, whose turn it is to take the lead, and when a vehicle that held lands.

Words get lost and come late, so a leader whose word is too old need not be dead. What is only late for less than a turn changes
nothing; and what is done twice by vehicles that do not hear each other is put in order by the terms of `core/leadership.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from companion.types import FlightPhase, Term

TURN_S = 0.3  # longer than the claim of one needs to reach the next; where it is not, the better rank wins later

HELD = frozenset({FlightPhase.RELEASE, FlightPhase.HOLD})


class Succession:
    """One vehicle's count of the time without a leader's word.

    The successor of rank k takes the lead k turns after the word was lost. All waiting ends two turns after the last of them,
    which may have noticed later than others; where there is none, after one. So it does for who flies with nobody, before it
    could be its turn. Who hears of a new lead waits anew: its word is on the way.
    """

    def __init__(self, own_id: int, successors: Sequence[int]) -> None:
        """`successors` are the fleet file's, the first one first."""
        self._rank = successors.index(own_id) + 1 if own_id in successors else 0
        self._turns = len(successors) + 2 if successors else 1
        self._term: Term = (0, 0)
        self._led_s = -inf

    def awaits(self, now_s: float, term: Term, led: bool, in_company: bool) -> bool:
        """Led now, or so lately that a leader may still come. `in_company`: a neighbour flies in formation."""
        if led or term != self._term:
            self._led_s, self._term = now_s, term
        return now_s - self._led_s <= TURN_S * (self._turns if in_company else 1)

    def rank_in_turn(self, now_s: float) -> int:
        """This vehicle's rank among the successors from its turn on; before, and for all others, 0."""
        return self._rank if now_s - self._led_s > TURN_S * self._rank else 0


class HeldForWantOfALeader:
    """Who went into the autopilot's hold for want of a leader lands after a while. A command, or a pilot, ends the count."""

    def __init__(self, land_after_s: float | None) -> None:
        """None: it stays in hold."""
        self._land_after_s = land_after_s
        self._since_s: float | None = None

    def begin(self, now_s: float) -> None:
        self._since_s = now_s

    def end(self) -> None:
        self._since_s = None

    def must_land(self, now_s: float, phase: FlightPhase, led: bool) -> bool:
        """`led`: a living leader's word is heard; without it so long, and the vehicle lands."""
        if phase not in HELD:
            self._since_s = None
        if self._since_s is None or self._land_after_s is None:
            return False
        if led:
            self._since_s = now_s
        return now_s - self._since_s > self._land_after_s
