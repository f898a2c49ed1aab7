"""Publishers for the vehicles: the target of a reference, traffic outside the fleet, and motion-capture poses."""

from __future__ import annotations

import secrets
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import zenoh

from companion.geometry.frames import enu_from_geodetic
from companion.ground.session import GroundConnection
from companion.types.peers import BodyPose, TargetSample, TrafficSample
from companion.types.values import Vector3
from companion.wire.keys import pose_key, target_key, traffic_key
from companion.wire.messages import encode

if TYPE_CHECKING:
    from companion.security.identity import Identity


class TargetPublisher(GroundConnection):
    """Motion of a target: a vehicle, a person, a joystick. A reference of kind `target` follows it.

    The only publisher of its name in the fleet. With an identity the name is the id of its certificate.
    """

    def __init__(
        self, fleet: str, connect: Sequence[str], name: str = "main", identity: Identity | None = None
    ) -> None:
        self._key = target_key(fleet, identity.id if identity else name)
        super().__init__(connect, identity)
        self._number = secrets.randbits(32)
        self._published = 0

    def publish(self, velocity_enu_m_s: Vector3, position_enu_m: Vector3 | None = None) -> None:
        """The present velocity and position in the fleet frame; without a position, as of a joystick, the velocity alone."""
        self._published += 1
        sample = TargetSample(self._number, self._published, time.monotonic(), velocity_enu_m_s, position_enu_m)
        self.session.put(self._key, encode(sample), congestion_control=zenoh.CongestionControl.DROP, express=True)


@dataclass(frozen=True, slots=True)
class HeightReference:
    """What a reported altitude refers to: altitude above mean sea level = altitude + `add_m`; None if it is unknown."""

    add_m: float | None


AMSL = HeightReference(0.0)
UNKNOWN_HEIGHT = HeightReference(None)
GEOID_M, PRESSURE_HPA = (-120.0, 100.0), (850.0, 1100.0)  # all there are on Earth at sea level
STANDARD_HPA, STANDARD_M, EXPONENT = 1013.25, 44_330.8, 0.190263  # of the international standard atmosphere, ISO 2533


def above_ellipsoid(geoid_m: float) -> HeightReference:
    """Of a GNSS height above the WGS84 ellipsoid. `geoid_m`: the geoid above it there, 47 m in Zurich. Raises ValueError.

    An autopilot reports both (GPS_RAW_INT: alt_ellipsoid - alt).
    """
    return HeightReference(-_within("geoid_m", geoid_m, *GEOID_M, "m"))


def pressure_altitude(qnh_hpa: float) -> HeightReference:
    """Of a barometric altitude by the standard pressure, as of transponders. `qnh_hpa`: the QNH there. Raises ValueError.

    A warm or cold day adds some 4 % of the height above the ground for each 10 K: put it into `error_m`.
    """
    ratio = _within("qnh_hpa", qnh_hpa, *PRESSURE_HPA, "hPa") / STANDARD_HPA
    return HeightReference(-STANDARD_M * (1.0 - ratio**EXPONENT))


def _within(name: str, value: float, least: float, most: float, unit: str) -> float:
    if not least <= value <= most:
        raise ValueError(f"{name}: {value:g} {unit}, expected {least:g} to {most:g}")
    return value


class TrafficPublisher(GroundConnection):
    """Positions of vehicles outside the fleet, such as those that a receiver of ADS-B reports.

    `source` names the receiver; with an identity it is the id of its certificate.
    """

    def __init__(
        self, fleet: str, connect: Sequence[str], source: str = "main", identity: Identity | None = None
    ) -> None:
        super().__init__(connect, identity)
        self._fleet, self._source = fleet, identity.id if identity else source

    def publish(
        self, name: str, position_enu_m: Vector3, velocity_enu_m_s: Vector3, age_s: float = 0.0, error_m: float = 0.0
    ) -> None:
        """A position in the fleet frame, `age_s` old. `name`: letters, digits, _ and -, such as an ICAO address."""
        self._put(name, TrafficSample(position_enu_m, velocity_enu_m_s, age_s, error_m))

    def _put(self, name: str, sample: TrafficSample) -> None:
        self.session.put(
            traffic_key(self._fleet, self._source, name),
            encode(sample),
            congestion_control=zenoh.CongestionControl.DROP,
            express=True,
        )

    def publish_geodetic(
        self,
        name: str,
        position_deg_deg_m: Vector3,
        velocity_enu_m_s: Vector3,
        origin_deg_deg_m: Vector3,
        age_s: float = 0.0,
        error_m: float = 0.0,
        height: HeightReference = UNKNOWN_HEIGHT,
    ) -> None:
        """WGS84 latitude, longitude and an altitude; the origin is that of the fleet file, with its altitude AMSL.

        ADS-B reports a pressure altitude or a height above the ellipsoid, each up to some 200 m off AMSL. `height` says which:
        `AMSL`, `above_ellipsoid` or `pressure_altitude`. Without it the aircraft is avoided horizontally, at any height.
        """
        latitude_deg, longitude_deg, altitude_m = position_deg_deg_m
        if height.add_m is None:
            east_m, north_m, _ = enu_from_geodetic(latitude_deg, longitude_deg, origin_deg_deg_m[2], origin_deg_deg_m)
            sample = TrafficSample((east_m, north_m, 0.0), velocity_enu_m_s, age_s, error_m, "unknown")
        else:
            position_enu_m = enu_from_geodetic(latitude_deg, longitude_deg, altitude_m + height.add_m, origin_deg_deg_m)
            sample = TrafficSample(position_enu_m, velocity_enu_m_s, age_s, error_m)
        self._put(name, sample)


class PosePublisher(GroundConnection):
    """Poses of the vehicles in the fleet frame, as a motion-capture system measures them.

    `source` names the system; with an identity it is the id of its certificate. Vehicles use one source at a time.
    """

    def __init__(
        self, fleet: str, connect: Sequence[str], source: str = "main", identity: Identity | None = None
    ) -> None:
        super().__init__(connect, identity)
        self._fleet, self._source = fleet, identity.id if identity else source
        self._number = secrets.randbits(32)
        self._published: Counter[int] = Counter()

    def publish(
        self,
        vehicle_id: int,
        position_enu_m: Vector3,
        quaternion: tuple[float, float, float, float],
        age_s: float = 0.0,
    ) -> None:
        """The pose of a vehicle, measured `age_s` ago. `quaternion` (w, x, y, z) turns its FLU body into ENU."""
        self._published[vehicle_id] += 1
        sequence, sent_s = self._published[vehicle_id], time.monotonic()
        self.session.put(
            pose_key(self._fleet, self._source, vehicle_id),
            encode(BodyPose(self._number, sequence, sent_s, position_enu_m, quaternion, age_s)),
            congestion_control=zenoh.CongestionControl.DROP,
            express=True,
        )
