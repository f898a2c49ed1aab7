"""Failsafes in a log of PX4: when they began, their cause and their action.

Since 1.14 the text of a failsafe is "Failsafe activated" alone. Cause and action are arguments of an event that its commander
sends with it (`src/modules/commander/failsafe/framework.cpp`, `src/lib/events/enums.json`); the mode that it changed to is in
`vehicle_status`, and what was wrong in `failsafe_flags`.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.report.flight import Floats

STATUS, EVENT, FLAGS = "vehicle_status", "event", "failsafe_flags"
BEFORE_S, AFTER_S = 2.0, 1.0  # the event of a failsafe is so near the status that shows it
RISEN_WITHIN_S = 30.0  # a failsafe may wait so long, COM_FAIL_ACT_T included
MOST_FLAGS = 4
CRITICAL = 2  # external log level, as of syslog
GENERIC_TEXT = "failsafe activated"
ACTIONS = (
    "none", "warning", "fallback to position control", "fallback to altitude control", "fallback to stabilized", "hold",
    "return", "land", "descend", "disarm", "terminate",
)  # fmt: skip
CAUSES = (
    "", "manual control loss", "GCS connection loss", "low battery level", "critical battery level",
    "emergency battery level", "low remaining flight time",
)  # fmt: skip
# Modes that a failsafe changes to, by nav_state.
MODES = {
    1: "fallback to altitude control",
    2: "fallback to position control",
    4: "hold",
    5: "return",
    12: "descend",
    13: "terminate",
    15: "fallback to stabilized",
    18: "land",
    20: "precision land",
}
BATTERY = ("", "low battery level", "critical battery level", "emergency battery level", "battery failed")
# Set in every flight that does not use them: no cause, unless they have just been raised
OFTEN_SET = frozenset(
    {"auto_mission_missing", "home_position_invalid", "offboard_control_signal_lost", "manual_control_signal_lost"}
)
# Arguments of the events, by their numbers: which of them are action and cause. The numbers are FNV-1a hashes of their names.
COMPONENT, NAME_BITS = 1 << 24, 0xFFFFFF
LAYOUTS = {
    "commander_failsafe_enter": ("<IBB", 1, 2),
    "commander_failsafe_enter_hold": ("<IBHB", 1, 3),
    "commander_failsafe_enter_generic": ("<IB", 1, None),
    "commander_failsafe_enter_generic_hold": ("<IBH", 1, None),
}
Layout = tuple[str, int, int | None]


def event_id(name: str) -> int:
    """The number of an event of the autopilot, as PX4 makes it of its name."""
    value = 0x811C9DC5
    for byte in name.encode():
        value = (value ^ byte) * 0x01000193 & 0xFFFFFFFF
    return COMPONENT | value & NAME_BITS


BY_ID = {event_id(name): layout for name, layout in LAYOUTS.items()}
PLAIN = LAYOUTS["commander_failsafe_enter"]


@dataclass(frozen=True, slots=True)
class TopicRows:
    """Rows of a topic in order of time: columns (n,) by name."""

    time_s: Floats
    columns: dict[str, NDArray[Any]] = field(default_factory=dict)

    def has(self, *names: str) -> bool:
        return all(name in self.columns for name in names)


@dataclass(frozen=True, slots=True)
class LoggedFailsafe:
    """`cause` and `action` are empty where the log does not say them."""

    time_s: float
    cause: str
    action: str

    def __str__(self) -> str:
        if not self.cause and not self.action:
            return "failsafe (vehicle_status.failsafe); the log says neither cause nor action"
        return f"failsafe: {self.cause or 'no cause logged'}; action: {self.action or 'not logged'}"


def failsafes_of(status: TopicRows | None, events: TopicRows | None, flags: TopicRows | None) -> list[LoggedFailsafe]:
    """In order of time. Tables are None where the log has none."""
    told = list(_told(events)) if events else []
    begins = _begins(status) if status else []
    found = []
    for time_s, mode in begins:
        near = [one for one in told if time_s - BEFORE_S <= one.time_s <= time_s + AFTER_S]
        by_id = [one for one in near if one.is_known]
        event = min(by_id or near, key=lambda one: abs(one.time_s - time_s), default=None)
        cause = (event.cause if event else "") or (_flagged(flags, time_s) if flags else "")
        found.append(LoggedFailsafe(time_s, cause, MODES.get(mode) or (event.action if event else "")))
    for event in told:  # of a log without the status
        if event.is_known and not any(-BEFORE_S <= event.time_s - time_s <= AFTER_S for time_s, _ in begins):
            cause = event.cause or (_flagged(flags, event.time_s) if flags else "")
            found.append(LoggedFailsafe(event.time_s, cause, event.action))
    return sorted(found, key=lambda one: one.time_s)


def is_told_by(time_s: float, text: str, failsafes_s: Sequence[float]) -> bool:
    """Whether a text of the log says no more than one of the failsafes at these times."""
    return GENERIC_TEXT in text.lower() and any(abs(time_s - one) <= BEFORE_S for one in failsafes_s)


@dataclass(frozen=True, slots=True)
class _Told:
    """What an event says. `is_known`: by its number; else it only looks like one of a failsafe."""

    time_s: float
    cause: str
    action: str
    is_known: bool


def _begins(status: TopicRows) -> list[tuple[float, int]]:
    """When the failsafe began, and the mode then; -1 where it is not logged."""
    if not status.has("failsafe"):
        return []
    active = status.columns["failsafe"] > 0
    rows = np.flatnonzero(active & ~np.concatenate(([False], active[:-1])))
    modes = status.columns.get("nav_state")
    return [(float(status.time_s[row]), -1 if modes is None else int(modes[row])) for row in rows]


def _told(events: TopicRows) -> Iterator[_Told]:
    if not events.has("id", "log_levels", "arguments[0]"):
        return
    names = [name for i in range(25) if (name := f"arguments[{i}]") in events.columns]
    for row, time_s in enumerate(events.time_s):
        layout = BY_ID.get(int(events.columns["id"][row]))
        # An event of another PX4 version: `failsafes_of` uses it only beside a failsafe in `vehicle_status`.
        if layout is None and int(events.columns["log_levels"][row]) & 0x0F > CRITICAL:
            continue
        arguments = bytes(int(events.columns[name][row]) & 0xFF for name in names)
        if said := _said(arguments, layout or PLAIN):
            yield _Told(float(time_s), *said, is_known=layout is not None)


def _said(arguments: bytes, layout: Layout) -> tuple[str, str] | None:
    """(cause, action); None where the arguments are none of a failsafe."""
    form, action_at, cause_at = layout
    if len(arguments) < struct.calcsize(form):
        return None
    values = struct.unpack_from(form, arguments)
    action, cause = values[action_at], 0 if cause_at is None else values[cause_at]
    if not 0 < action < len(ACTIONS) or cause >= len(CAUSES):
        return None
    return CAUSES[cause], ACTIONS[action]


def _flagged(flags: TopicRows, time_s: float) -> str:
    """What was wrong when the failsafe began: what had just come, else what was set."""
    until = flags.time_s <= time_s + AFTER_S
    if not until.any():
        return ""
    last = int(np.flatnonzero(until)[-1])
    recent = until & (flags.time_s >= time_s - RISEN_WITHIN_S)
    set_, risen = [], []
    for name, values in flags.columns.items():
        if name.startswith("mode_req_") or not values[last]:
            continue
        text = (
            BATTERY[min(int(values[last]), len(BATTERY) - 1)] if name == "battery_warning" else name.replace("_", " ")
        )
        if (values[recent] < values[last]).any():
            risen.append(text)
        elif name not in OFTEN_SET:
            set_.append(text)
    return ", ".join((risen or set_)[:MOST_FLAGS])
