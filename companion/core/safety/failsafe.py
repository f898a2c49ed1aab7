"""The failsafe matrix: what follows from each health flag, after what time, and what ends it.

One table, after the model of PX4's commander/failsafe. A step counts from the time of the step before it, the first from when
the flag is raised. STOP_STREAM is not an emergency brake: the autopilot itself acts (`decide_in_silence` of its profile).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from math import inf

from msgspec import Struct

from companion.core.autopilot import AutopilotProfile
from companion.core.estimation.corrections import ORIGIN_WITHIN_S
from companion.types.flight import FLAG_TEXTS, HELD, STREAMING, FailsafeAction, FlightPhase, HealthFlag
from companion.types.notices import Code, Notice


@dataclass(frozen=True, slots=True)
class FailsafeSettings:
    """What the fleet file chooses. None as a time: this step is never taken."""

    low_battery_action: FailsafeAction = FailsafeAction.LAND
    land_after_s: float | None = None
    leader_holds_after_s: float = 5.0


@dataclass(frozen=True, slots=True)
class Step:
    """An action and the seconds before it. A text names the field of FailsafeSettings that holds the value."""

    action: FailsafeAction | str
    after_s: float | str = 0.0


@dataclass(frozen=True, slots=True)
class Failsafe:
    """One row: the steps while `condition` lasts, when it is raised, and what clears it.

    A hold, a return or a landing that has begun is finished after the flag has cleared. `latched`: so is the next step.
    `in_hold`: the steps are also taken in a commanded hold. `flies_on`: the steps with an autopilot that flies on in silence,
    where they differ.
    """

    condition: Code
    raised: str
    steps: tuple[Step, ...]
    clears: str
    latched: bool = False
    in_hold: bool = False
    flies_on: tuple[Step, ...] = ()

    def steps_of(self, profile: AutopilotProfile) -> tuple[Step, ...]:
        """The steps with an autopilot of this profile."""
        return self.flies_on if profile.flies_on_in_silence and self.flies_on else self.steps


SILENT_TOO_LONG_S = 0.5  # less than COM_OF_LOSS_T: PX4 re-enters OFFBOARD by itself when a stream returns
LATE_TICK_S = 0.1

F, A, C = HealthFlag, FailsafeAction, Code
WARN, HOLD, LAND, STOP = Step(A.WARN), Step(A.HOLD), Step(A.LAND), Step(A.STOP_STREAM)
LAND_IN_TIME = Step(A.LAND, "land_after_s")

FAILSAFES: tuple[Failsafe, ...] = (
    Failsafe(C.POSITION_STALE, "position 0.04 s old", (STOP,), "a fresh LOCAL_POSITION_NED"),
    Failsafe(C.ATTITUDE_STALE, "attitude 0.1 s old", (STOP,), "a fresh ATTITUDE_QUATERNION"),
    Failsafe(C.MODE_STALE, "mode 0.8 s old", (STOP,), "a fresh flight mode"),
    Failsafe(C.FRAME_UNKNOWN, "at once", (STOP,), "GPS_GLOBAL_ORIGIN, or the ground altitude"),
    Failsafe(C.ARMED_STALE, "HEARTBEAT 3 s old", (HOLD,), "a fresh HEARTBEAT"),
    Failsafe(C.LANDED_STALE, "landed state 3 s old", (HOLD,), "a fresh EXTENDED_SYS_STATE"),
    Failsafe(C.LEADER_AWAITED, "`leader_beacon_max_age_s`", (WARN,), "a fresh leader beacon, or LEADER_LOST"),
    Failsafe(
        C.LEADER_LOST,
        "`leader_beacon_max_age_s` and the turns of all successors",
        (HOLD, LAND_IN_TIME),
        "a fresh leader beacon",
    ),
    Failsafe(
        C.FLEET_LINK_LOST,
        "last packet of any vehicle `peers.max_age_s` old",
        (WARN, Step(A.HOLD, "leader_holds_after_s"), LAND_IN_TIME),
        "a packet of any vehicle",
    ),
    Failsafe(C.DUPLICATE_ID, "at once", (WARN,), "3 s without such a packet"),
    Failsafe(C.SEPARATION_VIOLATED, "at once", (WARN,), "a distance of `separation_m`"),
    Failsafe(C.OUTSIDE_FENCE, "at once", (HOLD,), "a position inside the fence"),
    Failsafe(C.FRAME_CONTRADICTED, "at once", (HOLD,), "an origin and a global position that agree"),
    Failsafe(
        C.POSITION_JUMPED, f"{ORIGIN_WITHIN_S:g} s after a jump", (HOLD,), "a new origin, or the jump is followed"
    ),
    Failsafe(C.ESTIMATOR_BAD, "next estimator status", (WARN, Step(A.HOLD, 1.0)), "a good estimator status"),
    Failsafe(C.TILT_EXCEEDED, "`max_tilt_deg` and 10 deg", (WARN, Step(A.HOLD, 0.3)), "less tilt"),
    Failsafe(C.TICK_LATE, f"a tick {LATE_TICK_S:g} s late", (WARN, Step(A.HOLD, 5.0)), "1 s without a late tick"),
    Failsafe(
        C.BATTERY_LOW,
        "below `leave_below_percent`",
        (WARN, Step("low_battery_action", 3.0)),
        "a higher charge",
        latched=True,
    ),
    Failsafe(
        C.BATTERY_CRITICAL,
        "below `land_below_percent`",
        (WARN, Step(A.LAND, 3.0)),
        "a higher charge",
        latched=True,
        in_hold=True,
    ),
)

NO_SETPOINT_FAILSAFE = Failsafe(
    C.NO_SETPOINT, f"{SILENT_TOO_LONG_S:g} s without a setpoint", (Step(A.LEAVE),), "a command", flies_on=(HOLD,)
)
# Conditions that the phase machine and the end of the process judge, not health flags.
OTHER_FAILSAFES: tuple[Failsafe, ...] = (
    NO_SETPOINT_FAILSAFE,
    Failsafe(C.MODE_CHANGED_BY_OTHERS, "next flight mode", (Step(A.LEAVE),), "a command"),
    Failsafe(C.AUTOPILOT_DISARMED, "next HEARTBEAT", (Step(A.LEAVE),), "a command"),
    Failsafe(C.AGENT_STOPPING, "at once", (HOLD, Step(A.LEAVE, 2.0)), "a restart, which observes"),
    Failsafe(C.AGENT_FAILED, "an exception in a tick", (HOLD, Step(A.LEAVE, 0.5)), "a restart, which observes"),
)


def schedule(steps: Sequence[Step], settings: FailsafeSettings) -> tuple[tuple[float, FailsafeAction], ...]:
    """(seconds since the flag was raised, action) of each step, up to the first that is never taken."""
    due_s, timed = 0.0, []
    for step in steps:
        after_s = getattr(settings, step.after_s) if isinstance(step.after_s, str) else step.after_s
        if after_s is None:
            break
        due_s += after_s
        timed.append((due_s, getattr(settings, step.action) if isinstance(step.action, str) else step.action))
    return tuple(timed)


def flags_notice(flags: Collection[HealthFlag]) -> Notice:
    """The code of the first flag in the order of HealthFlag, with the texts of all, of at least one."""
    ordered = [flag for flag in HealthFlag if flag in flags]
    return Notice(Code(ordered[0]), ", ".join([FLAG_TEXTS[flag] for flag in ordered]))


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
        self.is_idle = True  # no flag is remembered: without a raised one no update is needed

    def update(
        self, now_s: float, phase: FlightPhase, flags: Collection[HealthFlag], commanded: bool
    ) -> ActiveFailsafe:
        """`commanded`: the last tick executed a command."""
        self._forget(phase, flags, commanded)
        self.is_idle = not (flags or self._since_s or self._begun or self._landed_for or self._overridden)
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
