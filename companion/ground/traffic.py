"""Publishes the positions of vehicles outside the fleet, such as those that a receiver of ADS-B reports."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Self

import zenoh

from companion.geometry.frames import enu_from_geodetic
from companion.link.zenoh_session import open_session
from companion.types.traffic import TrafficSample
from companion.types.vectors import Vector3
from companion.wire.keys import traffic_key
from companion.wire.traffic import encode_traffic


class TrafficPublisher:
    """Publishes for one fleet. Use it in a `with`, or call `close()`."""

    def __init__(self, fleet: str, session: zenoh.Session) -> None:
        self._fleet = fleet
        self._session = session

    @classmethod
    def open(cls, fleet: str, connect: Sequence[str]) -> TrafficPublisher:
        """Connects to vehicles' endpoints, in the background, without end. Raises link.zenoh_session.EndpointError."""
        with ExitStack() as undo:
            session = open_session(listen=(), connect=connect)
            undo.callback(session.close)
            opened = cls(fleet, session)
            undo.pop_all()
        return opened

    def publish(
        self,
        name: str,
        position_enu_m: Vector3,
        velocity_enu_m_s: Vector3,
        age_s: float = 0.0,
        error_m: float = 0.0,
    ) -> None:
        """A position in the fleet frame, `age_s` old. `name`: letters, digits, _ and -, such as an ICAO address."""
        sample = TrafficSample(position_enu_m, velocity_enu_m_s, age_s, error_m)
        self._session.put(
            traffic_key(self._fleet, name),
            encode_traffic(sample),
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

    def close(self) -> None:
        """End the session; without this a process may hang at its exit."""
        self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
