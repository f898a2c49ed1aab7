"""Since when each flag has counted, and the action of the failsafe matrix in this tick."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from math import inf

from msgspec import Struct

from companion.core.safety.failsafe import FAILSAFES, FailsafeSettings, schedule
from companion.types.flight import HELD, STREAMING, FailsafeAction, FlightPhase, HealthFlag

NONE = FailsafeAction.NONE
TO_THE_GROUND = (FailsafeAction.RETURN, FailsafeAction.LAND)
WARN_PERIOD_S = 5.0  # a flag that comes and goes warns no more often
EVERY_FLAG = tuple(HealthFlag)  # in order; iterating over the enum itself looks each member up
LATCHED = frozenset({HealthFlag(row.condition) for row in FAILSAFES if row.latched})
IN_HOLD = frozenset({HealthFlag(row.condition) for row in FAILSAFES if row.in_hold})


class ActiveFailsafe(Struct, frozen=True, gc=False):
    """The highest action of this tick, the flags that lead to it, and the flags that begin to warn."""

    action: FailsafeAction = NONE
    flags: tuple[HealthFlag, ...] = ()
    warnings: tuple[HealthFlag, ...] = ()


NONE_ACTIVE = ActiveFailsafe()


class FailsafeWatch:
    """The steps of the failsafe matrix in time.

    In formation all flags count. In hold only those count that ended the formation, and those of IN_HOLD, until a command or a
    pilot takes over. While a flag is cleared its time does not count, except where a latched one has ended the formation.
    """

    def __init__(self, settings: FailsafeSettings) -> None:
        self._schedules = {HealthFlag(row.condition): schedule(row.steps, settings) for row in FAILSAFES}
        self._since_s: dict[HealthFlag, float] = {}
        self._begun: set[HealthFlag] = set()  # these ended the formation
        self._landed_for: set[HealthFlag] = set()  # these began a landing or return, and are still raised
        self._overridden: set[HealthFlag] = set()  # a command ended it
        self._warned_s: dict[HealthFlag, float] = {}

    def update(
        self, now_s: float, phase: FlightPhase, flags: Collection[HealthFlag], commanded: bool
    ) -> ActiveFailsafe:
        """`commanded`: the last tick executed a command."""
        self._forget(phase, flags, commanded)
        if not flags and not self._since_s:
            return NONE_ACTIVE
        begins = [flag for flag in flags if flag not in self._since_s and self._counts(flag, phase)]
        for flag in begins:
            self._since_s[flag] = now_s
        actions = {flag: self._action(flag, now_s) for flag in {*flags, *self._since_s}}
        action = max(actions.values())
        if phase in STREAMING and (action is FailsafeAction.HOLD or action in TO_THE_GROUND):
            self._begun |= {flag for flag in actions if actions[flag] > FailsafeAction.WARN}
        if phase in HELD:
            self._landed_for |= {flag for flag in self._since_s if actions[flag] in TO_THE_GROUND}
        return ActiveFailsafe(
            action,
            tuple([flag for flag in EVERY_FLAG if actions.get(flag) is action]),
            self._warn(now_s, actions, begins) if phase in STREAMING else (),
        )

    def _forget(self, phase: FlightPhase, flags: Collection[HealthFlag], commanded: bool) -> None:
        if self._landed_for or self._overridden:
            self._landed_for.intersection_update(flags)
            self._overridden.intersection_update(flags)
            if commanded:
                self._overridden |= self._landed_for
        if commanded or (phase not in STREAMING and phase not in HELD):
            self._since_s.clear()
            self._begun.clear()
            return
        for flag in [flag for flag in self._since_s if flag not in flags]:
            if flag not in LATCHED or flag not in self._begun:
                del self._since_s[flag]

    def _counts(self, flag: HealthFlag, phase: FlightPhase) -> bool:
        if phase in STREAMING:
            return True
        return phase in HELD and (flag in self._begun or (flag in IN_HOLD and flag not in self._overridden))

    def _action(self, flag: HealthFlag, now_s: float) -> FailsafeAction:
        """The last step that is due; of a flag that does not count, the first where it is due at once."""
        elapsed_s = now_s - self._since_s.get(flag, now_s)
        due = [action for due_s, action in self._schedules[flag] if due_s <= elapsed_s]
        return due[-1] if due else NONE

    def _warn(
        self, now_s: float, actions: Mapping[HealthFlag, FailsafeAction], begins: Collection[HealthFlag]
    ) -> tuple[HealthFlag, ...]:
        warnings = [flag for flag in begins if actions[flag] is FailsafeAction.WARN]
        warnings = [flag for flag in warnings if now_s - self._warned_s.get(flag, -inf) >= WARN_PERIOD_S]
        self._warned_s.update(dict.fromkeys(warnings, now_s))
        return tuple(sorted(warnings))
