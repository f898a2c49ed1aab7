"""Loss of the leader: how long formation continues, and which successor becomes leader when.

Beacons get lost or arrive late, so a leader with a stale beacon need not be dead. A delay of less than one turn changes
nothing. Claims of vehicles that do not receive each other are ordered by the terms of `leadership.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from companion.types.formation import Term

TURN_S = 0.3  # longer than a claim needs to reach the next successor; otherwise the better rank wins later
RETURN_S = 0.4  # the leader may leave a term without a leader later than this vehicle, and its beacon is on the way for as long


class Succession:
    """Time without a leader beacon.

    The successor of rank k becomes leader k turns after the beacon was lost. All vehicles stop waiting two turns after the last
    successor's, which may have noticed the loss later; without successors, or without a neighbour in formation, after one turn,
    before any successor's turn. After a new term is received, waiting starts again, as its beacon is on the way.
    After the return from a term without a leader to one in which a leader was alive it lasts RETURN_S longer.
    """

    def __init__(self, own_id: int, successors: Sequence[int]) -> None:
        """`successors` are the ids of the fleet file, best rank first."""
        self._rank = successors.index(own_id) + 1 if own_id in successors else 0
        self._turns = len(successors) + 2 if successors else 1
        self._term: Term = (0, 0)
        self._led_s = -inf
        self._led = False  # in the last tick
        self._returns_s = 0.0  # after the present term, where it has no leader

    def awaits(self, now_s: float, term: Term, led: bool, with_neighbours: bool) -> bool:
        """Whether a leader is known, or may still appear. `with_neighbours`: a neighbour flies in formation."""
        if term > self._term:
            self._returns_s = RETURN_S if self._led else 0.0
        if led or term != self._term:
            led_s = now_s + self._returns_s if term < self._term else now_s
            if led_s > self._led_s:
                self._led_s = led_s
        self._term, self._led = term, led
        return now_s - self._led_s <= TURN_S * (self._turns if with_neighbours else 1)

    def rank_in_turn(self, now_s: float) -> int:
        """This vehicle's rank among the successors from its turn on; before it, and for all others, 0."""
        return self._rank if now_s - self._led_s > TURN_S * self._rank else 0
