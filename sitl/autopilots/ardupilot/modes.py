"""ArduCopter's flight modes by number, their tasks and conditions. Modes without use here are left out."""

from __future__ import annotations

from enum import IntEnum

from sitl.vehicle.automatic_flight import Task


class CopterMode(IntEnum):
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
_TASKS = {
    CopterMode.ALT_HOLD: Task.SINK,
    CopterMode.LOITER: Task.SINK,
    CopterMode.LAND: Task.LAND,
    CopterMode.RTL: Task.RETURN,
}
ARMABLE = frozenset({CopterMode.STABILIZE, CopterMode.ALT_HOLD, CopterMode.GUIDED, CopterMode.LOITER})
NEED_A_POSITION = frozenset({CopterMode.AUTO, CopterMode.GUIDED, CopterMode.LOITER, CopterMode.RTL, CopterMode.BRAKE})
REPORTED_AS_GUIDED = NEED_A_POSITION | {CopterMode.LAND}  # in HEARTBEAT: the modes that control the position

# FS_GCS_ENABLE: the mode after the loss of the ground station, none for 0. SMART_RTL has no path here and becomes RTL.
GROUND_STATION_LOSS = {
    1: CopterMode.RTL,
    2: CopterMode.RTL,
    3: CopterMode.RTL,
    4: CopterMode.LAND,
    5: CopterMode.LAND,
    6: CopterMode.RTL,
    7: CopterMode.BRAKE,
}
