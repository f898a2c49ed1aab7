"""The alarm list: conditions that need attention, until they have ended and are acknowledged."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from msgspec.structs import replace

from companion.ground.belief import Doubt
from companion.monitor.api import AlarmView, Severity, VehicleView
from companion.monitor.vehicle_view import advice_of
from companion.types.code_table import SEVERITIES
from companion.types.notices import Code

MOST_ALARMS = 500
WARNS_AFTER_S = 0.5
SILENT, NEVER_HEARD, UNSECURED, NOT_RECORDED = "SILENT", "NEVER_HEARD", "UNSECURED", "NOT_RECORDED"
_RANKS = {severity: rank for rank, severity in enumerate(SEVERITIES)}

Key = tuple[str, int | None, str]  # fleet, vehicle id, code


@dataclass(frozen=True, slots=True)
class AlarmCondition:
    """What is wrong at present."""

    severity: Severity
    text: str
    advice: str


OTHER_FILE = AlarmCondition(
    "warning",
    "its fleet file is not the one here: slots, fence and the figures of the law may be wrong",
    "copy one fleet file to all vehicles and to the ground",
)


MISSING = AlarmCondition(
    "warning",
    "no report yet; the fleet file here names it",
    "start its agent, and look at its endpoint and its network",
)


@dataclass(frozen=True, slots=True)
class AlarmChanges:
    """The alarms that have begun and those that have ended in one update."""

    begun: tuple[AlarmView, ...] = ()
    ended: tuple[AlarmView, ...] = ()


class Delay:
    """Keeps warnings back until they have lasted for WARNS_AFTER_S.

    At the start of an agent, and while vehicles take off one after the other, flags come and go within a few statuses. An
    operator who is called for nothing soon listens no more.
    """

    def __init__(self) -> None:
        self._since_s: dict[Key, float] = {}  # since when each present condition has lasted

    def lasting(self, now_s: float, conditions: Mapping[Key, AlarmCondition]) -> dict[Key, AlarmCondition]:
        """Those of the present conditions that are critical, or have lasted."""
        self._since_s = {key: self._since_s.get(key, now_s) for key in conditions}
        return {
            key: condition
            for key, condition in conditions.items()
            if condition.severity == "critical" or now_s - self._since_s[key] >= WARNS_AFTER_S
        }


class AlarmList:
    """At most MOST_ALARMS. A condition that returns before its alarm was acknowledged goes on under the same alarm."""

    def __init__(self) -> None:
        self._alarms: dict[Key, AlarmView] = {}
        self._last_id = 0

    def update(self, time_s: float, conditions: Mapping[Key, AlarmCondition]) -> AlarmChanges:
        """Begin and end alarms by the present conditions. One that was acknowledged begins again where it becomes worse."""
        self._leave_room(len(conditions.keys() - self._alarms.keys()))
        for key, condition in conditions.items():
            if self._is_worse(key, condition):
                del self._alarms[key]
        new = [key for key in sorted(conditions, key=lambda key: _RANKS[conditions[key].severity]) if self._is_new(key)]
        begun = [self._begin(time_s, key, conditions[key]) for key in new if self._has_room(key)]
        ended = [self._end(time_s, key) for key in list(self._alarms) if key not in conditions and self._lasts(key)]
        for key, condition in conditions.items():
            alarm = self._alarms.get(key)
            if alarm and (alarm.severity, alarm.text) != (condition.severity, condition.text):
                self._alarms[key] = replace(alarm, severity=condition.severity, text=condition.text)
        return AlarmChanges(tuple(begun), tuple(ended))

    def acknowledge(self, alarm_id: int) -> AlarmView | None:
        """The alarm, now acknowledged; None where there is none with this id. One that has ended leaves the list."""
        for key, alarm in self._alarms.items():
            if alarm.id == alarm_id:
                acknowledged = replace(alarm, acknowledged=True)
                if alarm.until_s is None:
                    self._alarms[key] = acknowledged
                else:
                    del self._alarms[key]
                return acknowledged
        return None

    def forget(self) -> None:
        """All alarms; the ids of later ones go on."""
        self._alarms.clear()

    def all(self) -> tuple[AlarmView, ...]:
        """Those that last first, the most severe first, the newest first."""
        order = sorted(self._alarms.values(), key=lambda a: (a.until_s is not None, _RANKS[a.severity], -a.since_s))
        return tuple(order)

    def _lasts(self, key: Key) -> bool:
        return self._alarms[key].until_s is None

    def _is_new(self, key: Key) -> bool:
        return key not in self._alarms or not self._lasts(key)

    def _is_worse(self, key: Key, condition: AlarmCondition) -> bool:
        alarm = self._alarms.get(key)
        return bool(alarm and alarm.acknowledged) and _RANKS[condition.severity] < _RANKS[self._alarms[key].severity]

    def _has_room(self, key: Key) -> bool:
        """Those that last stay: to take the place of one would begin it again at every update."""
        return key in self._alarms or len(self._alarms) < MOST_ALARMS

    def _begin(self, time_s: float, key: Key, condition: AlarmCondition) -> AlarmView:
        fleet, vehicle_id, code = key
        if (alarm := self._alarms.get(key)) is not None:
            self._alarms[key] = replace(alarm, since_s=time_s, until_s=None, times=alarm.times + 1)
            return self._alarms[key]
        self._last_id += 1
        self._alarms[key] = AlarmView(
            id=self._last_id,
            fleet=fleet,
            vehicle_id=vehicle_id,
            code=code,
            severity=condition.severity,
            text=condition.text,
            advice=condition.advice,
            since_s=time_s,
            until_s=None,
            acknowledged=False,
            first_s=time_s,
        )
        return self._alarms[key]

    def _end(self, time_s: float, key: Key) -> AlarmView:
        alarm = replace(self._alarms[key], until_s=time_s)
        if alarm.acknowledged:
            del self._alarms[key]
        else:
            self._alarms[key] = alarm
        return alarm

    def _leave_room(self, count: int) -> None:
        """For so many new ones: those that have ended leave, the least severe and oldest first."""
        too_many = len(self._alarms) + count - MOST_ALARMS
        if too_many <= 0:
            return
        ended = [alarm for alarm in self.all() if alarm.until_s is not None]
        for alarm in ended[max(0, len(ended) - too_many) :]:
            del self._alarms[alarm.fleet, alarm.vehicle_id, alarm.code]


def conditions_of(vehicle: VehicleView) -> dict[Key, AlarmCondition]:
    """What is wrong with a vehicle. The flags of a silent one last until it reports again."""
    fleet, vehicle_id = vehicle.fleet, vehicle.vehicle_id
    found: dict[Key, AlarmCondition] = {
        (fleet, vehicle_id, flag.code): AlarmCondition(flag.severity, flag.text, flag.advice) for flag in vehicle.flags
    }
    if vehicle.silent:
        severity: Severity = "critical" if vehicle.armed else "warning"
        state = f"{vehicle.phase}, {'armed' if vehicle.armed else 'disarmed'}"
        text = f"no report any more; when it last reported: {state}"
        found[fleet, vehicle_id, SILENT] = AlarmCondition(severity, text, advice_of(Code.NO_REPORT))
    if vehicle.recording.state == "dropping":
        text = f"{vehicle.recording.dropped} records lost: its disk is full or slow; the flight is not affected"
        found[fleet, vehicle_id, NOT_RECORDED] = AlarmCondition("info", text, "free space on the disk of the vehicle")
    if vehicle.network.security == "none":
        text = "strangers in its network can command it (security: none in the fleet file)"
        found[fleet, None, UNSECURED] = AlarmCondition("info", text, "make identities: companion provision new FOLDER")
    return found


def doubt_conditions(fleet: str, doubts: Iterable[Doubt]) -> dict[Key, AlarmCondition]:
    """What vehicles report that cannot be true, one alarm for each vehicle."""
    texts: dict[int, str] = {}
    for doubt in doubts:
        before = texts.get(doubt.vehicle_id)
        texts[doubt.vehicle_id] = f"{before}; {doubt.notice.text}" if before else doubt.notice.text
    code = Code.REPORT_IMPLAUSIBLE
    return {(fleet, i, code): AlarmCondition("warning", text, advice_of(code)) for i, text in texts.items()}
