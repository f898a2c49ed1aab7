"""Expensive checks of content from outside, in steps over several ticks: no command and no packet delays a setpoint.

Each step of a check is a small amount of work, about half a millisecond for twelve vehicles. A caller asks for the result in
every tick until it is there.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from enum import Enum, auto
from math import inf
from typing import Any, Final

from companion.types.notices import Answer, Code, Notice
from companion.types.steps import Result, Steps

STEPS_PER_TICK = 4
BEING_CHECKED = Answer(False, Notice(Code.CHANGE_IN_PROGRESS, "is being checked"))  # the answer comes in a later tick
RESULTS_KEPT = 4  # leaders send a change in every tick until all have it


class Pending(Enum):
    """In place of a result: ask again in the next tick."""

    PENDING = auto()


PENDING: Final = Pending.PENDING


class PacedChecks:
    """One check at a time, by at most `steps_per_tick` steps in a tick; inf runs each check at once.

    `steps` counts the steps done since the start.
    """

    def __init__(self, steps_per_tick: float = inf) -> None:
        self._steps_per_tick = steps_per_tick
        self._left = steps_per_tick
        self._key: Hashable = None
        self._running: Steps[Any] | None = None
        self._asked = False
        self._results: dict[Hashable, Any] = {}
        self.steps = 0

    @property
    def is_idle(self) -> bool:
        """No check runs, and none was asked for in the last tick: a tick without one needs no `begin_tick`."""
        return self._running is None and not self._asked

    def begin_tick(self) -> None:
        """A new tick: the steps of a tick are available. A check that was not asked for in the last tick is dropped."""
        if not self._asked:
            self._running = None
        self._left, self._asked = self._steps_per_tick, False

    def ask(self, key: Hashable, start: Callable[[], Steps[Result]]) -> Result | Pending:
        """The result of the check with this key, which `start` begins; PENDING where it is not known in this tick.

        The first caller of a tick goes before the check of another one that began earlier.
        """
        if key in self._results:
            known: Result = self._results[key]
            return known
        if self._running is None or key != self._key:
            if self._running is not None and self._asked:
                return PENDING
            self._key, self._running = key, start()
        self._asked = True
        while self._left > 0:
            self._left -= 1
            self.steps += 1
            try:
                next(self._running)
            except StopIteration as end:
                self._running = None
                result: Result = end.value
                self._keep(key, result)
                return result
        return PENDING

    def _keep(self, key: Hashable, result: object) -> None:
        self._results[key] = result
        if len(self._results) > RESULTS_KEPT:
            del self._results[next(iter(self._results))]
