"""ArduCopter's flight modes by number, their tasks and conditions. Modes without use here are left out."""

from __future__ import annotations

from enum import IntEnum

from sitl.vehicle.automatic_flight import Task


class Mode(IntEnum):
    """A flight mode as custom_mode."""

    STABILIZE = 0
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    BRAKE = 17

    @property
    def custom_mode(self) -> int:
        return int(self)

    @property
    def task(self) -> Task:
        return _TASKS.get(self, Task.HOLD)


# Its simulator has a remote control whose throttle stick is at the bottom: LOITER and ALT_HOLD sink with it.
_TASKS = {Mode.ALT_HOLD: Task.SINK, Mode.LOITER: Task.SINK, Mode.LAND: Task.LAND, Mode.RTL: Task.RETURN}
ARMABLE = frozenset({Mode.STABILIZE, Mode.ALT_HOLD, Mode.GUIDED, Mode.LOITER})
NEED_A_POSITION = frozenset({Mode.AUTO, Mode.GUIDED, Mode.LOITER, Mode.RTL, Mode.BRAKE})
REPORTED_AS_GUIDED = NEED_A_POSITION | {Mode.LAND}  # in HEARTBEAT: the modes that control the position

# FS_GCS_ENABLE: the mode after the loss of the ground station, none for 0. SMART_RTL has no path here and becomes RTL.
GROUND_STATION_LOSS = {
    1: Mode.RTL,
    2: Mode.RTL,
    3: Mode.RTL,
    4: Mode.LAND,
    5: Mode.LAND,
    6: Mode.RTL,
    7: Mode.BRAKE,
}
