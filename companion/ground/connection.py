"""The Zenoh session that every program of the ground opens to the vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Self

from companion.link.fleet.zenoh_session import open_session

if TYPE_CHECKING:
    from companion.security.identity import Identity


class GroundConnection:
    """Connects to vehicles' endpoints, in the background, without end. Use it in a `with`, or call `close()`.

    Raises link.fleet.zenoh_session.EndpointError.
    """

    def __init__(self, connect: Sequence[str], identity: Identity | None = None) -> None:
        self._session = open_session(listen=(), connect=connect, identity=identity)

    def close(self) -> None:
        """End the session; without this a process may hang at its exit."""
        self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
