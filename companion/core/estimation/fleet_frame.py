"""Where the local frame of the own autopilot lies in the fleet frame.

The offset comes from GPS_GLOBAL_ORIGIN. GLOBAL_POSITION_INT minus LOCAL_POSITION_NED gives the same offset to within
centimetres: it checks a reported origin, and replaces one that was never reported.
"""

from __future__ import annotations

from collections import deque
from math import dist

from companion.geometry.frames import enu_from_geodetic
from companion.geometry.vectors import mean
from companion.types.autopilot import GlobalPositionSample, OriginSample, PositionSample
from companion.types.values import MAX_COORDINATE_M, ZERO3, Place, Vector3

MAX_OFFSET_M = 100_000.0
SAME_TIME_S = 0.1  # most time between the global and the local position that are compared
COMPARISONS = 5  # consecutive comparisons that decide: one second at 5 Hz
AGREE_M = 0.3
CONTRADICT_M = 2.0


class FleetFrame:
    """Position of one autopilot's local origin in the fleet frame.

    `fleet_origin` is (latitude deg, longitude deg, altitude AMSL m). It is None where all vehicles already share one local
    frame, as with one motion-capture system.
    """

    def __init__(self, fleet_origin: Vector3 | None) -> None:
        self._fleet_origin = fleet_origin
        self._origin_reported = False
        self._own_origin: Vector3 | None = None
        self._offsets_enu_m: deque[Vector3] = deque(maxlen=COMPARISONS)
        self.offset_enu_m: Vector3 | None = None  # position of the autopilot's local origin in the fleet frame
        self.own_altitude_amsl_m: float | None = None  # altitude of the autopilot's local origin
        self.contradicted = False
        self.forget()

    def forget(self) -> None:
        """Discard the origin after a reboot of the autopilot. In a shared frame only the altitude is lost."""
        self._origin_reported, self._own_origin = False, None
        self._offsets_enu_m.clear()
        self.own_altitude_amsl_m = None
        self.offset_enu_m = ZERO3 if self._fleet_origin is None else None
        self.contradicted = False

    def use_origin(self, sample: OriginSample) -> bool:
        """Take GPS_GLOBAL_ORIGIN. Returns False, and changes nothing, where the origin is implausible."""
        plausible = abs(sample.latitude_deg) <= 90.0 and abs(sample.longitude_deg) <= 180.0
        if not plausible or not -1000.0 < sample.altitude_amsl_m < 10_000.0:
            return False
        self.own_altitude_amsl_m = sample.altitude_amsl_m
        self._own_origin = (sample.latitude_deg, sample.longitude_deg, sample.altitude_amsl_m)
        self._origin_reported = True
        if self._fleet_origin is not None:
            offset_m = enu_from_geodetic(
                sample.latitude_deg, sample.longitude_deg, sample.altitude_amsl_m, self._fleet_origin
            )
            if offset_m != self.offset_enu_m:
                self._offsets_enu_m.clear()
                self.contradicted = False
            self.offset_enu_m = offset_m
        return True

    @property
    def geodetic_origin(self) -> Vector3 | None:
        """Where the fleet frame has its origin. In a shared frame it is the autopilot's own origin, as far as it is known."""
        return self._own_origin if self._fleet_origin is None else self._fleet_origin

    def place(self, latitude_deg: float, longitude_deg: float) -> Place | None:
        """Metres east and north in the fleet frame; None where its origin is unknown, or the place is implausible."""
        origin = self.geodetic_origin
        if origin is None or not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0):
            return None
        east_m, north_m, _ = enu_from_geodetic(latitude_deg, longitude_deg, origin[2], origin)
        near = abs(east_m) <= MAX_COORDINATE_M and abs(north_m) <= MAX_COORDINATE_M
        return (east_m, north_m) if near else None

    def use_global_position(self, sample: GlobalPositionSample, local: PositionSample) -> bool:
        """Compare GLOBAL_POSITION_INT with `local`, the newest local position.

        Returns False where the offset is implausible: without a fix some autopilots report 0, 0.
        """
        if self._fleet_origin is None:
            return True
        later_s = sample.boot_time_s - local.boot_time_s
        if abs(later_s) > SAME_TIME_S:
            return True
        east, north, up = enu_from_geodetic(
            sample.latitude_deg, sample.longitude_deg, sample.altitude_amsl_m, self._fleet_origin
        )
        (x, y, z), (vx, vy, vz) = local.position_local_enu_m, local.velocity_enu_m_s
        offset_m = (east - x - vx * later_s, north - y - vy * later_s, up - z - vz * later_s)
        if not all(abs(component) <= MAX_OFFSET_M for component in offset_m):
            return False
        self._offsets_enu_m.append(offset_m)
        self._evaluate_offsets()
        return True

    def _evaluate_offsets(self) -> None:
        """Let COMPARISONS consecutive offsets contradict a reported origin, or replace one that was never reported."""
        compared, used = self._offsets_enu_m, self.offset_enu_m
        if len(compared) < COMPARISONS:
            return
        if self._origin_reported and used is not None:
            self.contradicted = all(dist(offset_m, used) > CONTRADICT_M for offset_m in compared)
            return
        mean_m = mean(compared)
        agree = all(dist(offset_m, mean_m) <= AGREE_M for offset_m in compared)
        if agree and (used is None or dist(mean_m, used) > AGREE_M) and self._fleet_origin is not None:
            self.offset_enu_m = mean_m
            self.own_altitude_amsl_m = self._fleet_origin[2] + mean_m[2]
