"""A thread with UDP sockets that runs beside the process under test, for the time of a `with`."""

from __future__ import annotations

import socket
import threading
from types import TracebackType
from typing import Self


class Background:
    """`run` must return when `ended` is set. Sockets from `udp_socket` are closed after it."""

    def __init__(self) -> None:
        self.ended = threading.Event()
        self._thread = threading.Thread(target=self.run)
        self._sockets: list[socket.socket] = []

    def udp_socket(self) -> socket.socket:
        self._sockets.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        return self._sockets[-1]

    def run(self) -> None:
        raise NotImplementedError

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.ended.set()
        self._thread.join()
        for opened in self._sockets:
            opened.close()
