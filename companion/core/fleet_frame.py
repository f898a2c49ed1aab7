"""Where the autopilot's local frame lies in the fleet's: by GPS_GLOBAL_ORIGIN, checked against GLOBAL_POSITION_INT.

Where the origin never comes, what global and local position differ by says the same, to centimetres.
"""

from __future__ import annotations

from collections import deque
from math import dist

from companion.frames import enu_from_geodetic
from companion.types import ZERO3, GlobalPositionSample, OriginSample, PositionSample, Vector3

MAX_OFFSET_M = 100_000.0
SAME_TIME_S = 0.1  # of the global and the local position that are compared
ENOUGH = 5  # of such comparisons in a row: a second, at 5 Hz
AGREE_M = 0.3
CONTRADICT_M = 2.0


class FleetFrame:
    """The fleet frame's offset from one autopilot's local frame.

    `fleet_origin` is (latitude deg, longitude deg, altitude AMSL m), or None where the local frame is the fleet's already
    (one motion-capture system for all).
    """

    def __init__(self, fleet_origin: Vector3 | None) -> None:
        self._fleet_origin = fleet_origin
        self._told = False
        self._compared: deque[Vector3] = deque(maxlen=ENOUGH)
        self.offset_enu_m: Vector3 | None = None  # of the local frame's zero in the fleet frame
        self.own_altitude_amsl_m: float | None = None  # of the local frame's zero
        self.contradicted = False
        self.forget()

    def forget(self) -> None:
        """The autopilot began anew, and its origin with it; in a shared frame only its altitude is lost."""
        self._told = False
        self._compared.clear()
        self.own_altitude_amsl_m = None
        self.offset_enu_m = ZERO3 if self._fleet_origin is None else None
        self.contradicted = False

    def hear_origin(self, sample: OriginSample) -> bool:
        """False where it cannot be true."""
        plausible = abs(sample.latitude_deg) <= 90.0 and abs(sample.longitude_deg) <= 180.0
        if not plausible or not -1000.0 < sample.altitude_amsl_m < 10_000.0:
            return False
        self.own_altitude_amsl_m = sample.altitude_amsl_m
        self._told = True
        if self._fleet_origin is not None:
            offset_m = enu_from_geodetic(
                sample.latitude_deg, sample.longitude_deg, sample.altitude_amsl_m, self._fleet_origin
            )
            if offset_m != self.offset_enu_m:
                self._compared.clear()
                self.contradicted = False
            self.offset_enu_m = offset_m
        return True

    def hear_global_position(self, sample: GlobalPositionSample, local: PositionSample) -> bool:
        """`local` is the newest local position. False where it cannot be true: without a fix some tell 0, 0."""
        if self._fleet_origin is None:
            return True
        later_s = sample.boot_time_s - local.boot_time_s
        if abs(later_s) > SAME_TIME_S:
            return True
        place = enu_from_geodetic(sample.latitude_deg, sample.longitude_deg, sample.altitude_amsl_m, self._fleet_origin)
        (x, y, z), (vx, vy, vz) = local.position_local_enu_m, local.velocity_enu_m_s
        offset_m = (place[0] - x - vx * later_s, place[1] - y - vy * later_s, place[2] - z - vz * later_s)
        if not all(abs(component) <= MAX_OFFSET_M for component in offset_m):
            return False
        self._compared.append(offset_m)
        self._judge()
        return True

    def _judge(self) -> None:
        """One comparison proves nothing; a row of them replaces an origin that was never told, or contradicts a told one."""
        compared, used = self._compared, self.offset_enu_m
        if len(compared) < ENOUGH:
            return
        if self._told and used is not None:
            self.contradicted = all(dist(offset_m, used) > CONTRADICT_M for offset_m in compared)
            return
        mean = (
            sum(o[0] for o in compared) / ENOUGH,
            sum(o[1] for o in compared) / ENOUGH,
            sum(o[2] for o in compared) / ENOUGH,
        )
        agree = all(dist(offset_m, mean) <= AGREE_M for offset_m in compared)
        if agree and (used is None or dist(mean, used) > AGREE_M) and self._fleet_origin is not None:
            self.offset_enu_m = mean
            self.own_altitude_amsl_m = self._fleet_origin[2] + mean[2]
