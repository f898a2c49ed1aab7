"""ArduCopter's flight modes with their tasks and conditions, and its start with its texts. Modes without use are left out.

The start was measured: armable in GUIDED after 42 s; the stages keep their share of `armable_after_s`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from math import inf
from typing import ClassVar

from companion.mavlink.codec import mavlink
from sitl.autopilots.external_vision import ExternalVision
from sitl.vehicle.automatic_flight import Task

PREARM_EVERY_S = 30.0
VISION_SILENT_S = 0.3  # older samples are of a system that is not healthy
INITIALISED, ACCELS, GYROS, ORIGIN, USING_GPS = 0.06, 0.28, 0.56, 0.48, 0.88  # shares of `armable_after_s`


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
    def flags(self) -> int:
        guided = mavlink.MAV_MODE_FLAG_GUIDED_ENABLED if self in REPORTED_AS_GUIDED else 0
        return mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | guided

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


@dataclass(slots=True)
class StartUp:
    """The start of one vehicle. `announcements` is to be called repeatedly."""

    STAGES: ClassVar[tuple[tuple[float, str], ...]] = (
        (INITIALISED, "ArduPilot Ready"),
        (ORIGIN, "EKF3 IMU0 origin set"),
        (USING_GPS, "EKF3 IMU0 is using GPS"),
    )
    armable_after_s: float
    _announced_s: float = -1.0
    _prearm_s: float = 0.0

    def initialised(self, time_s: float) -> bool:
        return time_s >= INITIALISED * self.armable_after_s

    def has_origin(self, time_s: float) -> bool:
        """Whether it has an origin and a home."""
        return time_s >= ORIGIN * self.armable_after_s

    def has_position(self, time_s: float) -> bool:
        return time_s >= USING_GPS * self.armable_after_s

    def obstacles(self, time_s: float, needs_position: bool, checks_sensors: bool) -> list[str]:
        """Reasons why it cannot be armed, as ArduCopter words them."""
        if not self.initialised(time_s):
            return ["System not initialised"]
        reasons = []
        if checks_sensors and time_s < GYROS * self.armable_after_s:
            reasons.append("Gyros inconsistent" if time_s >= ACCELS * self.armable_after_s else "Accels inconsistent")
        if needs_position and not self.has_origin(time_s):
            reasons.append("AHRS: waiting for home")
        elif needs_position and not self._has_estimate(time_s):
            reasons.append("Need Position Estimate")
        return reasons

    def _has_estimate(self, time_s: float) -> bool:
        return time_s >= self.armable_after_s

    def announcements(self, time_s: float) -> list[str]:
        """Texts of the stages reached since the last call."""
        before, self._announced_s = self._announced_s, time_s
        return [text for share, text in self.STAGES if before < share * self.armable_after_s <= time_s]

    def prearm_is_due(self, time_s: float) -> bool:
        """Whether the reasons why it cannot be armed are to be sent again."""
        if time_s - self._prearm_s < PREARM_EVERY_S:
            return False
        self._prearm_s = time_s
        return True


@dataclass(slots=True)
class VisionStartUp(StartUp):
    """The start of one vehicle without GPS: position, origin and home come from outside, whenever they come."""

    STAGES = ((INITIALISED, "ArduPilot Ready"),)
    vision: ExternalVision = field(kw_only=True)

    def has_origin(self, _time_s: float) -> bool:
        return self.vision.origin_s < inf

    def has_position(self, _time_s: float) -> bool:
        return self.vision.fixed

    def _has_estimate(self, time_s: float) -> bool:
        return self.has_position(time_s)

    def obstacles(self, time_s: float, needs_position: bool, checks_sensors: bool) -> list[str]:
        reasons = StartUp.obstacles(self, time_s, needs_position, checks_sensors)
        if checks_sensors and self.initialised(time_s) and self.vision.silent_s(time_s) > VISION_SILENT_S:
            reasons.append("VisOdom: not healthy")
        return reasons
