"""MAVLink's log protocol, the part common to all makes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

from companion.mavlink.codec import MavlinkMessage, mavlink

CHUNK_BYTES = 90  # of LOG_DATA


class LogTransfer(ABC):
    """Log transfer on one link. A request yields its immediate answers and changes what `due` sends."""

    def __init__(self) -> None:
        self.requests: dict[str, Callable[[MavlinkMessage], Iterator[MavlinkMessage]]] = {
            "LOG_REQUEST_LIST": self._list,
            "LOG_REQUEST_DATA": self._data,
            "LOG_REQUEST_END": self._end,
            "LOG_ERASE": self._erase,
        }

    @abstractmethod
    def due(self) -> Iterator[MavlinkMessage]:
        """LOG_ENTRY and LOG_DATA of one step."""

    @abstractmethod
    def _list(self, request: MavlinkMessage) -> Iterator[MavlinkMessage]: ...

    @abstractmethod
    def _data(self, request: MavlinkMessage) -> Iterator[MavlinkMessage]: ...

    @abstractmethod
    def _end(self, request: MavlinkMessage) -> Iterator[MavlinkMessage]: ...

    @abstractmethod
    def _erase(self, request: MavlinkMessage) -> Iterator[MavlinkMessage]: ...


def log_data(number: int, offset: int, content: bytes) -> MavlinkMessage:
    """LOG_DATA; the last packet of a file is padded with zeros."""
    return mavlink.MAVLink_log_data_message(number, offset, len(content), list(content.ljust(CHUNK_BYTES, b"\0")))
