"""Publishes something to be followed: a vehicle, a person, a joystick. An RFT of kind `target` goes after it."""

from __future__ import annotations

import secrets
import time
from collections.abc import Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Self

import zenoh

from companion.link.zenoh_session import open_session
from companion.types import TargetSample, Vector3
from companion.wire.keys import target_key
from companion.wire.target import encode_target


class TargetPublisher:
    """One target's voice; nobody else may use its name meanwhile. Use it in a `with`, or call `close()`."""

    def __init__(self, fleet: str, name: str, session: zenoh.Session) -> None:
        self._session = session
        self._key = target_key(fleet, name)
        self._number = secrets.randbits(32)
        self._told = 0

    @classmethod
    def open(cls, fleet: str, connect: Sequence[str], name: str = "main") -> TargetPublisher:
        """Connect to vehicles' endpoints, in the background and for ever. Raises link.zenoh_session.EndpointError."""
        with ExitStack() as undo:
            session = open_session(listen=(), connect=connect)
            undo.callback(session.close)
            opened = cls(fleet, name, session)
            undo.pop_all()
        return opened

    def tell(self, velocity_enu_m_s: Vector3, position_enu_m: Vector3 | None = None) -> None:
        """Where it is just now in the fleet's frame, and how it moves; without a position, as from a joystick, how it moves."""
        self._told += 1
        sample = TargetSample(self._number, self._told, time.monotonic(), velocity_enu_m_s, position_enu_m)
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
