"""Publishers of what flies or moves outside the fleet: the target of a reference, and vehicles to keep away from."""

from __future__ import annotations

import secrets
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import zenoh

from companion.geometry.frames import enu_from_geodetic
from companion.ground.session import GroundConnection
from companion.types.peers import TargetSample, TrafficSample
from companion.types.values import Vector3
from companion.wire.keys import target_key, traffic_key
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
        sample = TrafficSample(position_enu_m, velocity_enu_m_s, age_s, error_m)
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
    ) -> None:
        """WGS84 latitude, longitude and altitude AMSL, as ADS-B reports them; the origin is that of the fleet file."""
        position_enu_m = enu_from_geodetic(*position_deg_deg_m, origin_deg_deg_m)
        self.publish(name, position_enu_m, velocity_enu_m_s, age_s, error_m)
