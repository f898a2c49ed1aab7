"""sd_notify(3): tells systemd that the agent is ready, alive and stopping."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping

MIN_WATCHDOG_PERIOD_S = 0.2  # a few times a second are plenty for any WatchdogSec


class Notifier:
    """Speaks to $NOTIFY_SOCKET; says nothing where systemd did not start this process.

    The watchdog is fed by completed control cycles alone: a process that hangs, or a loop that no longer ticks, starves it.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        if self._address.startswith("@"):
            self._address = "\0" + self._address[1:]  # Linux's abstract names
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if self._address else None
        if self._socket:
            self._socket.setblocking(False)  # a flight does not wait for its service manager
        self._watchdog_period_s = _watchdog_period_s(environment)
        self._fed_s = float("-inf")
        self._is_ready = False

    def cycle_completed(self, now_s: float, autopilot_heard: bool) -> None:
        """One control cycle is done. The first with an autopilot makes the service ready."""
        if autopilot_heard and not self._is_ready:
            self._is_ready = self._send("READY=1")
        is_due = self._watchdog_period_s is not None and now_s - self._fed_s >= self._watchdog_period_s
        if is_due and self._send("WATCHDOG=1"):
            self._fed_s = now_s

    def status(self, text: str) -> None:
        """One line for `systemctl status`."""
        self._send(f"STATUS={text}")

    def stopping(self) -> None:
        self._send("STOPPING=1")

    def close(self) -> None:
        if self._socket:
            self._socket.close()
            self._socket = None

    def _send(self, message: str) -> bool:
        """Was it sent? Without its service manager the agent flies on."""
        if not self._socket:
            return False
        try:
            self._socket.sendto(message.encode(), self._address)
        except OSError:
            return False
        return True


def _watchdog_period_s(environment: Mapping[str, str]) -> float | None:
    """A quarter of WATCHDOG_USEC, None where no watchdog waits for this process."""
    limit_us = environment.get("WATCHDOG_USEC", "")
    process = environment.get("WATCHDOG_PID", "")
    if not limit_us.isdigit() or int(limit_us) == 0 or (process and process != str(os.getpid())):
        return None
    return max(MIN_WATCHDOG_PERIOD_S, int(limit_us) / 1e6 / 4)
