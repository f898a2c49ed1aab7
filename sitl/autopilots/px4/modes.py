"""PX4's flight modes, their tasks and their conditions."""

from __future__ import annotations

from enum import Enum

from sitl.vehicle.automatic_flight import Task


class Px4Mode(Enum):
    """A flight mode as (main, sub) of custom_mode."""

    MANUAL = (1, 0)
    ALTCTL = (2, 0)
    POSCTL = (3, 0)
    TAKEOFF = (4, 2)
    LOITER = (4, 3)
    MISSION = (4, 4)
    RTL = (4, 5)
    LAND = (4, 6)
    ACRO = (5, 0)
    OFFBOARD = (6, 0)
    STABILIZED = (7, 0)

    @property
    def custom_mode(self) -> int:
        """The main mode in its third byte, the sub mode in its fourth."""
        main, sub = self.value
        return int(main << 16 | sub << 24)

    @property
    def is_auto(self) -> bool:
        main: int = self.value[0]
        return main == 4

    @property
    def task(self) -> Task:
        return Task.SINK if self in NEED_A_PILOT else _TASKS.get(self, Task.HOLD)


# There is no remote control, so these cannot fly the vehicle.
NEED_A_PILOT = frozenset({Px4Mode.MANUAL, Px4Mode.ALTCTL, Px4Mode.POSCTL, Px4Mode.ACRO, Px4Mode.STABILIZED})
_TASKS = {Px4Mode.TAKEOFF: Task.TAKE_OFF, Px4Mode.LAND: Task.LAND, Px4Mode.RTL: Task.RETURN}
PREVENT_ARMING = frozenset({Px4Mode.LAND, Px4Mode.RTL})

# COM_OBL_RC_ACT: where the vehicle goes when the setpoint stream is lost; None stops the motors. What is not listed is as 0.
OFFBOARD_LOSS: dict[int, Px4Mode | None] = {
    0: Px4Mode.POSCTL,
    1: Px4Mode.ALTCTL,
    2: Px4Mode.STABILIZED,
    3: Px4Mode.RTL,
    4: Px4Mode.LAND,
    5: Px4Mode.LOITER,
    6: None,
    7: None,
}
# NAV_DLL_ACT: where it goes when the ground station is lost. 0 is nowhere.
GROUND_STATION_LOSS: dict[int, Px4Mode | None] = {1: Px4Mode.LOITER, 2: Px4Mode.RTL, 3: Px4Mode.LAND, 5: None, 6: None}
