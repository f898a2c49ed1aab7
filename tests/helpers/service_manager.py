"""A receiver of sd_notify messages."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

from agent_process import until

WATCHDOG_S = 1.0


class ServiceManager:
    """Listens on the socket of NOTIFY_SOCKET."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self._socket.setblocking(False)
        self.messages: list[str] = []

    def listen(self) -> list[str]:
        """All messages received so far."""
        while True:
            try:
                self.messages.append(self._socket.recv(4096).decode())
            except BlockingIOError:
                return self.messages

    def forget(self) -> None:
        self.listen()
        self.messages.clear()

    def wait_for(self, message: str) -> None:
        until(lambda: message in self.listen())

    def environment(self) -> dict[str, str]:
        return {"NOTIFY_SOCKET": self.address, "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6)), "WATCHDOG_PID": ""}

    def close(self) -> None:
        self._socket.close()


@contextmanager
def service_manager(address: str) -> Iterator[ServiceManager]:
    manager = ServiceManager(address)
    try:
        yield manager
    finally:
        manager.close()
