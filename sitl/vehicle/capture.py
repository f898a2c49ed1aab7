"""A motion-capture system: what it measures of true poses, with its noise, its latency and its faults. Pure and seeded.

Its faults are those of a scenario's `stand_in.capture_faults`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from math import cos, radians, sin
from random import Random

from companion.geometry.frames import Quaternion
from companion.geometry.vectors import plus, scaled
from companion.types.values import Vector3
from sitl.vehicle.config import CaptureFault
from sitl.vehicle.disturbances import Normals

POSITION_SD_M, YAW_SD_RAD = 0.002, 0.003
LATENCY_S = 0.005  # from the exposure to the frame, at least
LATE_S = 0.3  # of a fault, in addition
KEPT_S = 1.0
EPSILON_S = 1e-6  # times of frames are sums of periods

BodyPlace = tuple[Vector3, Quaternion]  # position in ENU, and FLU body to ENU
MeasuredBody = tuple[int, Vector3, Quaternion, float]
"""Vehicle id, position in ENU, quaternion (w, x, y, z) from the FLU body to ENU, age in s."""


class CaptureSystem:
    """Cameras that see all vehicles. `frame` is called once for each frame, in the order of time."""

    def __init__(self, seed: int, faults: Sequence[CaptureFault] = ()) -> None:
        self._normals, self._faults = Normals(Random(seed)), faults
        self._exposures: deque[tuple[float, dict[int, BodyPlace]]] = deque()  # oldest first
        self._seen: dict[int, tuple[BodyPlace, float]] = {}  # in the frame before, with their ages

    def frame(self, now_s: float, truths: Mapping[int, BodyPlace]) -> list[MeasuredBody]:
        """Exposes the cameras, and returns the bodies of the frame that leaves the system now, by vehicle id.

        A body that is not tracked is not in it. The ages are true: those of the exposures that show the bodies.
        """
        exposed = {vehicle_id: self._measured(truths[vehicle_id]) for vehicle_id in sorted(truths)}
        self._exposures.append((now_s, exposed))
        while now_s - self._exposures[0][0] > KEPT_S:
            self._exposures.popleft()
        return faulty(self._bodies(now_s, exposed), self._faults, now_s)

    def _bodies(self, now_s: float, vehicle_ids: Collection[int]) -> list[MeasuredBody]:
        """Those that have been exposed long enough ago; frozen ones as in the frame before."""
        frozen, late = (_concerned(self._faults, kind, now_s) for kind in ("frozen", "late"))
        seen: dict[int, tuple[BodyPlace, float]] = {}
        for vehicle_id in vehicle_ids:
            found = self._exposed(vehicle_id, now_s - LATENCY_S - (LATE_S if vehicle_id in late else 0.0))
            if found is not None:
                place, exposed_s = found
                if vehicle_id in frozen and vehicle_id in self._seen:
                    place = self._seen[vehicle_id][0]
                seen[vehicle_id] = (place, now_s - exposed_s)
        self._seen = seen
        return [(vehicle_id, *place, age_s) for vehicle_id, (place, age_s) in seen.items()]

    def _exposed(self, vehicle_id: int, before_s: float) -> tuple[BodyPlace, float] | None:
        for exposed_s, places in reversed(self._exposures):
            if exposed_s <= before_s + EPSILON_S and vehicle_id in places:
                return places[vehicle_id], exposed_s
        return None

    def _measured(self, true: BodyPlace) -> BodyPlace:
        position_m, quaternion = true
        x, y, z, yaw = self._normals.take(4)
        return plus(position_m, scaled((x, y, z), POSITION_SD_M)), yawed(quaternion, yaw * YAW_SD_RAD)


def faulty(bodies: Sequence[MeasuredBody], faults: Sequence[CaptureFault], now_s: float) -> list[MeasuredBody]:
    """The bodies of a frame with what is lost, swapped and flipped at this time."""
    places = {vehicle_id: (position_m, quaternion, age_s) for vehicle_id, position_m, quaternion, age_s in bodies}
    for fault in faults:
        if not _lasts(fault, now_s) or fault.vehicle not in places:
            continue
        if fault.kind == "lost":
            del places[fault.vehicle]
        elif fault.kind == "swapped" and fault.other in places:
            places[fault.vehicle], places[fault.other] = places[fault.other], places[fault.vehicle]
        elif fault.kind == "flipped":
            position_m, quaternion, age_s = places[fault.vehicle]
            places[fault.vehicle] = (position_m, yawed(quaternion, radians(fault.turn_deg)), age_s)
    return [(vehicle_id, *body) for vehicle_id, body in places.items()]


def yawed(quaternion: Quaternion, angle_rad: float) -> Quaternion:
    """An attitude after a turn about the body's z axis."""
    w, x, y, z = quaternion
    c, s = cos(0.5 * angle_rad), sin(0.5 * angle_rad)
    return (w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s)


def _lasts(fault: CaptureFault, now_s: float) -> bool:
    return fault.at_s - EPSILON_S <= now_s < fault.at_s + fault.for_s - EPSILON_S


def _concerned(faults: Sequence[CaptureFault], kind: str, now_s: float) -> set[int]:
    return {fault.vehicle for fault in faults if fault.kind == kind and _lasts(fault, now_s)}
