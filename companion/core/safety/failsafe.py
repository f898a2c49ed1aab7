"""The failsafe matrix: what follows from each health flag, after what time, and what ends it.

One table, after the model of PX4's commander/failsafe. A step counts from the time of the step before it, the first from when
the flag is raised. STOP_STREAM is not an emergency brake: the autopilot itself acts (`decide_in_silence` of its profile).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from math import acos, cos, inf, radians

from msgspec import Struct

from companion.core.autopilot import AutopilotProfile
from companion.core.consensus.stage import Consensus
from companion.core.estimation.accuracy import POSE_GAP_S
from companion.core.estimation.corrections import LARGEST_JUMP_M, ORIGIN_WITHIN_S
from companion.core.estimation.vehicle import FAILSAFE_STAYS_S
from companion.core.safety.limits import OutputLimits
from companion.types.autopilot import VehicleState
from companion.types.flight import COOPERATING, FLAG_TEXTS, HELD, STREAMING, FailsafeAction, FlightPhase, HealthFlag
from companion.types.notices import Code, Notice
from companion.types.status import SeparationReport


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

    The row holds the values that the code uses. `limit` is the age, angle or time from which on the condition is raised, in
    the unit that `raises` names; `stays_s` is how long it stays after its last cause; `{}` in a text stands for the value.
    A hold, a return or a landing that has begun is finished after the flag has cleared. `latched`: so is the next step.
    `in_hold`: the steps are also taken in a commanded hold. `flies_on`: the steps with an autopilot that flies on in silence,
    where they differ.
    """

    condition: Code
    raises: str
    steps: tuple[Step, ...]
    clears_by: str
    limit: float = 0.0
    stays_s: float = 0.0
    latched: bool = False
    in_hold: bool = False
    flies_on: tuple[Step, ...] = ()

    @property
    def raised(self) -> str:
        """When it is raised, for people."""
        return self.raises.format(f"{self.limit:g}")

    @property
    def clears(self) -> str:
        """What clears it, for people."""
        return self.clears_by.format(f"{self.stays_s:g}")

    def steps_of(self, profile: AutopilotProfile) -> tuple[Step, ...]:
        """The steps with an autopilot of this profile."""
        return self.flies_on if profile.flies_on_in_silence and self.flies_on else self.steps


F, A, C = HealthFlag, FailsafeAction, Code
WARN, HOLD, LAND, STOP = Step(A.WARN), Step(A.HOLD), Step(A.LAND), Step(A.STOP_STREAM)
LAND_IN_TIME = Step(A.LAND, "land_after_s")

FAILSAFES: tuple[Failsafe, ...] = (
    # Two periods of 50 Hz: with an older position there is no fresh decision, and no setpoint.
    Failsafe(C.POSITION_STALE, "position {} s old", (STOP,), "a fresh LOCAL_POSITION_NED", limit=0.04),
    Failsafe(C.ATTITUDE_STALE, "attitude {} s old", (STOP,), "a fresh ATTITUDE_QUATERNION", limit=0.1),
    # PX4 sends a new mode at once and an unchanged one twice a second, measured up to 0.53 s apart: one may be lost.
    Failsafe(C.MODE_STALE, "mode {} s old", (STOP,), "a fresh flight mode", limit=1.2),
    Failsafe(C.FRAME_UNKNOWN, "at once", (STOP,), "GPS_GLOBAL_ORIGIN, or the ground altitude"),
    Failsafe(C.GROUND_UNKNOWN, "at once, in the air", (STOP,), "a landing, and disarmed"),
    # PX4 sends HEARTBEAT once a second, whatever is asked: three in a row are lost.
    Failsafe(C.ARMED_STALE, "HEARTBEAT {} s old", (HOLD,), "a fresh HEARTBEAT", limit=3.0),
    Failsafe(C.LANDED_STALE, "landed state {} s old", (HOLD,), "a fresh EXTENDED_SYS_STATE", limit=3.0),
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
    Failsafe(C.DUPLICATE_ID, "at once", (WARN,), "{} s without such a packet", stays_s=3.0),
    Failsafe(C.SEPARATION_VIOLATED, "at once", (WARN,), "a distance of `separation_m`"),
    Failsafe(C.NOT_SHAKEN_OFF, "pressed for 2 s, or for 5 m", (WARN,), "some seconds without pressure"),
    Failsafe(C.PEER_IN_DOUBT, "off or refused for 0.45 s in all", (WARN,), "states that agree for about 2 s"),
    Failsafe(C.OUTSIDE_FENCE, "at once", (HOLD,), "a position inside the fence"),
    Failsafe(C.FRAME_CONTRADICTED, "at once", (HOLD,), "an origin and a global position that agree"),
    # A new origin explains a jump; it comes within ORIGIN_WITHIN_S.
    Failsafe(
        C.POSITION_JUMPED, "{} s after a jump", (HOLD,), "a new origin, or the jump is followed", limit=ORIGIN_WITHIN_S
    ),
    Failsafe(C.ESTIMATOR_BAD, "next estimator status", (WARN, Step(A.HOLD, 1.0)), "a good estimator status"),
    # Autopilots dead-reckon for 5 to 10 s and then land blind: until then the position is still good enough to land by.
    Failsafe(
        C.POSITION_UNAIDED,
        "next report of GPS or the estimator",
        (WARN, Step(A.LAND, 1.0)),
        "GPS or vision in use again, with a known accuracy",
        in_hold=True,
    ),
    # PX4 dead-reckons for 4.7 s and ArduCopter for 7 s before they act. Until the hold the vehicle brakes by a velocity that
    # is still good.
    Failsafe(
        C.POSE_LOST,
        "{} s without a good motion-capture pose",
        (WARN, Step(A.HOLD, 0.3), Step(A.LAND, 1.5)),
        "a good pose",
        limit=POSE_GAP_S,
        in_hold=True,
    ),
    Failsafe(C.POSE_REFUSED, "at once", (WARN,), "{} s without a refused pose", stays_s=1.0),
    # Most often the autopilot changes its mode at once, and flies itself.
    Failsafe(
        C.FAILSAFE_ACTIVE,
        "next HEARTBEAT or text",
        (WARN, Step("low_battery_action", 3.0)),
        "{} s without either",
        stays_s=FAILSAFE_STAYS_S,
        latched=True,
    ),
    # Autopilots overshoot the commanded limit, and gusts add to it. PX4 waits 0.3 s as well (FD_FAIL_R_TTRI).
    Failsafe(C.TILT_EXCEEDED, "`max_tilt_deg` and {} deg", (WARN, Step(A.HOLD, 0.3)), "less tilt", limit=10.0),
    # Five periods of 50 Hz; in the air at most a few milliseconds are usual (docs/performance.md).
    Failsafe(
        C.TICK_LATE, "a tick {} s late", (WARN, Step(A.HOLD, 5.0)), "{} s without a late tick", limit=0.1, stays_s=1.0
    ),
    # A tenth of a tick. A single call may be interrupted by another process; a law that is slow by itself is so in every tick.
    Failsafe(
        C.LAW_SLOW,
        "a law from outside takes {} s in a tick",
        (WARN, Step(A.HOLD, 1.0)),
        "{} s without such a tick",
        limit=0.002,
        stays_s=0.2,
    ),
    # Against a dip of the voltage under load, as ArduPilot's BATT_LOW_TIMER.
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

# Conditions that the phase machine and the end of the process judge, not health flags.
OTHER_FAILSAFES: tuple[Failsafe, ...] = (
    # Less than PX4's COM_OF_LOSS_T, 1 s: PX4 re-enters OFFBOARD by itself when a stream returns.
    Failsafe(C.NO_SETPOINT, "{} s without a setpoint", (Step(A.LEAVE),), "a command", limit=0.5, flies_on=(HOLD,)),
    Failsafe(C.MODE_CHANGED_BY_OTHERS, "next flight mode", (Step(A.LEAVE),), "a command"),
    Failsafe(C.AUTOPILOT_DISARMED, "next HEARTBEAT", (Step(A.LEAVE),), "a command"),
    # A moving vehicle brakes for 4 s at most. Both autopilots take over within 50 ms of the request (measured: docs/safety.md);
    # the rest is for lost requests.
    Failsafe(C.AGENT_STOPPING, "at once", (HOLD, Step(A.LEAVE, 6.0)), "a restart, which observes"),
    Failsafe(C.AGENT_FAILED, "an exception in a tick", (HOLD, Step(A.LEAVE, 0.5)), "a restart, which observes"),
)
BY_CONDITION = {row.condition: row for row in (*FAILSAFES, *OTHER_FAILSAFES)}


def limit_of(condition: Code) -> float:
    """The value from which on a condition is raised, in the unit of its row."""
    return BY_CONDITION[condition].limit


def leaves_after_s(condition: Code) -> float:
    """Seconds from the first step of a condition to its last one, LEAVE."""
    after_s = BY_CONDITION[condition].steps[-1].after_s
    assert isinstance(after_s, float)
    return after_s


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


def doubted(consensus: Consensus) -> tuple[int, ...]:
    """The peers that say what cannot be true: in themselves, or by what is known of them."""
    peers = consensus.peers
    return tuple(sorted({*peers.in_doubt, *peers.refused})) if peers.refused else peers.in_doubt


def named_notice(flag: HealthFlag, vehicle: VehicleState, consensus: Consensus, separation: SeparationReport) -> Notice:
    """The notice of one flag that begins, with what it is about: names of vehicles, or what is wrong with a pose."""
    notice, names = flags_notice([flag]), ""
    if flag is HealthFlag.NOT_SHAKEN_OFF:
        names = ", ".join(separation.unshaken)
    elif flag is HealthFlag.PEER_IN_DOUBT:
        names = ", ".join(map(str, doubted(consensus)))
    elif flag is HealthFlag.POSE_REFUSED:
        names = vehicle.pose_fault
    return Notice(notice.code, f"{notice.text}: {names}") if names else notice


# Positions that peers must not use; positions that the vehicle itself does not know.
POSITION_WRONG = frozenset({HealthFlag.FRAME_CONTRADICTED, HealthFlag.POSITION_JUMPED})
POSITION_IN_DOUBT = POSITION_WRONG | {
    HealthFlag.POSITION_STALE,
    HealthFlag.FRAME_UNKNOWN,
    HealthFlag.GROUND_UNKNOWN,
    HealthFlag.POSITION_UNAIDED,
}
# A vehicle does not brake by a velocity that may be wrong.
MOTION_IN_DOUBT = POSITION_IN_DOUBT | {HealthFlag.ESTIMATOR_BAD, HealthFlag.TILT_EXCEEDED}


@dataclass(frozen=True, slots=True)
class HealthLimits:
    """What raises the flags of the vehicle. A battery limit of None raises none."""

    envelope: OutputLimits
    low_battery_percent: float | None = None
    critical_battery_percent: float | None = None
    max_position_error_m: float = 5.0  # PX4: COM_POS_FS_EPH


POSITION_S, ATTITUDE_S, MODE_S = limit_of(C.POSITION_STALE), limit_of(C.ATTITUDE_STALE), limit_of(C.MODE_STALE)
ARMED_S, LANDED_S, JUMPED_S = limit_of(C.ARMED_STALE), limit_of(C.LANDED_STALE), limit_of(C.POSITION_JUMPED)
TILT_MARGIN_RAD = radians(limit_of(C.TILT_EXCEEDED))
REFUSED_FOR_S = BY_CONDITION[C.POSE_REFUSED].stays_s
DUPLICATE_FOR_S = BY_CONDITION[C.DUPLICATE_ID].stays_s


def health_flags(now_s: float, vehicle: VehicleState, limits: HealthLimits) -> set[HealthFlag]:
    """The flags that the state of the own vehicle raises at `now_s`."""
    flags = set()
    if now_s - vehicle.position_time_s > POSITION_S:
        flags.add(F.POSITION_STALE)
    if now_s - vehicle.attitude_time_s > ATTITUDE_S:
        flags.add(F.ATTITUDE_STALE)
    if now_s - vehicle.mode_time_s > MODE_S:
        flags.add(F.MODE_STALE)
    if now_s - vehicle.heartbeat_time_s > ARMED_S:
        flags.add(F.ARMED_STALE)
    if now_s - vehicle.landed_time_s > LANDED_S:
        flags.add(F.LANDED_STALE)
    if vehicle.ground_unknown:
        flags.add(F.GROUND_UNKNOWN)
    elif not vehicle.frame_known:
        flags.add(F.FRAME_UNKNOWN)
    if vehicle.frame_contradicted:
        flags.add(F.FRAME_CONTRADICTED)
    if vehicle.held_back_m > LARGEST_JUMP_M and now_s - vehicle.jump_time_s > JUMPED_S:
        flags.add(F.POSITION_JUMPED)
    if vehicle.position_time_s > -inf and not limits.envelope.fence.contains(vehicle.position_enu_m):
        flags.add(F.OUTSIDE_FENCE)
    error = vehicle.position_error
    if not vehicle.estimator_healthy or (error and error.horizontal_m > limits.max_position_error_m):
        flags.add(F.ESTIMATOR_BAD)
    if vehicle.position_unaided:
        flags.add(F.POSITION_UNAIDED)
    if now_s - vehicle.pose_time_s > POSE_GAP_S:
        flags.add(F.POSE_LOST)
    if now_s - vehicle.pose_refused_s < REFUSED_FOR_S:
        flags.add(F.POSE_REFUSED)
    if now_s - vehicle.failsafe_s < FAILSAFE_STAYS_S:
        flags.add(F.FAILSAFE_ACTIVE)
    if acos(cos(vehicle.roll_rad) * cos(vehicle.pitch_rad)) > limits.envelope.max_tilt_rad + TILT_MARGIN_RAD:
        flags.add(F.TILT_EXCEEDED)
    percent, low, critical = vehicle.battery_percent, limits.low_battery_percent, limits.critical_battery_percent
    if percent >= 0.0:  # an unknown charge (-1) is not low
        if low is not None and percent < low:
            flags.add(F.BATTERY_LOW)
        if critical is not None and percent < critical:
            flags.add(F.BATTERY_CRITICAL)
    return flags


def fleet_flags(
    now_s: float, phase: FlightPhase, consensus: Consensus, separation: SeparationReport
) -> set[HealthFlag]:
    """What is wrong between the vehicles. The link counts as lost only where it was there before."""
    flags = set()
    if consensus.lead.leaderless is not None:
        flags.add(consensus.lead.leaderless)
    if phase in COOPERATING and consensus.peers.known and not consensus.peers.present:
        flags.add(F.FLEET_LINK_LOST)
    if now_s - consensus.peers.duplicate_id_s < DUPLICATE_FOR_S:
        flags.add(F.DUPLICATE_ID)
    if separation.violated:
        flags.add(F.SEPARATION_VIOLATED)
    if consensus.peers.in_doubt or consensus.peers.refused:
        flags.add(F.PEER_IN_DOUBT)
    if separation.unshaken:
        flags.add(F.NOT_SHAKEN_OFF)
    return flags


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
        self.is_idle = not (flags or self._since_s or self._begun)  # the other sets are of raised flags
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
