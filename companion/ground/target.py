"""Publishes the motion of a target: a vehicle, a person, a joystick. A reference of kind `target` follows it."""

from __future__ import annotations

import secrets
import time
from collections.abc import Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Self

import zenoh

from companion.link.zenoh_session import open_session
from companion.types.peers import TargetSample
from companion.types.vectors import Vector3
from companion.wire.keys import target_key
from companion.wire.target import encode_target


class TargetPublisher:
    """The publisher of one target, the only one of its name. Use it in a `with`, or call `close()`."""

    def __init__(self, fleet: str, name: str, session: zenoh.Session) -> None:
        self._session = session
        self._key = target_key(fleet, name)
        self._number = secrets.randbits(32)
        self._published = 0

    @classmethod
    def open(cls, fleet: str, connect: Sequence[str], name: str = "main") -> TargetPublisher:
        """Connects to vehicles' endpoints, in the background, without end. Raises link.zenoh_session.EndpointError."""
        with ExitStack() as undo:
            session = open_session(listen=(), connect=connect)
            undo.callback(session.close)
            opened = cls(fleet, name, session)
            undo.pop_all()
        return opened

    def publish(self, velocity_enu_m_s: Vector3, position_enu_m: Vector3 | None = None) -> None:
        """The present velocity and position in the fleet frame; without a position, as of a joystick, the velocity alone."""
        self._published += 1
        sample = TargetSample(self._number, self._published, time.monotonic(), velocity_enu_m_s, position_enu_m)
        self._session.put(
            self._key, encode_target(sample), congestion_control=zenoh.CongestionControl.DROP, express=True
        )

    def close(self) -> None:
        """End the session; without this a process may hang at its exit."""
        self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
