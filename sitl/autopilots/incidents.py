"""What happens to one stand-in at given times: estimator resets, battery charges, and a pilot who takes over."""

from __future__ import annotations

from math import inf, nan

from companion.types.values import Vector3
from sitl.vehicle.automatic_flight import Course
from sitl.vehicle.config import AutopilotFile

FULL_BATTERY_PERCENT = 98


class Incidents:
    """The incidents of one vehicle. `course` is that of the pilot, None until the pilot takes over."""

    def __init__(self, file: AutopilotFile) -> None:
        stand_in = file.stand_in
        self._resets = sorted((r for r in stand_in.estimator_resets if r.vehicle == file.id), key=lambda r: r.at_s)
        self._batteries = sorted((b for b in stand_in.batteries if b.vehicle == file.id), key=lambda b: b.at_s)
        self._flights = sorted((p for p in stand_in.pilots if p.vehicle == file.id), key=lambda p: p.at_s)
        self.course: Course | None = None
        self.next_s = self._next_s()  # when the next reset or pilot is due

    def _next_s(self) -> float:
        return min([r.at_s for r in self._resets[:1]] + [p.at_s for p in self._flights[:1]], default=inf)

    def reset(self, now_s: float) -> Vector3 | None:
        """The shift of an estimator reset that is due, ENU in metres. To be called until it returns None."""
        if self._resets and self._resets[0].at_s <= now_s:
            shift_enu_m = self._resets.pop(0).shift_enu_m
            self.next_s = self._next_s()
            return shift_enu_m
        return None

    def pilot_takes_over(self, now_s: float) -> bool:
        """Whether a pilot takes over now, to fly `course`."""
        if not self._flights or self._flights[0].at_s > now_s:
            return False
        self.course = Course((nan, nan, nan), self._flights.pop(0).velocity_enu_m_s, nan, 0.0)
        self.next_s = self._next_s()
        return True

    def battery_percent(self, now_s: float) -> int:
        """The reported charge, -1 if it is unknown."""
        reported = [level.percent for level in self._batteries if level.at_s <= now_s]
        return reported[-1] if reported else FULL_BATTERY_PERCENT
