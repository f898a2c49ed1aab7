"""sd_notify(3): reports to systemd that the agent is ready, alive and stopping, and its status line."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping

from companion.types.status import Status

MIN_WATCHDOG_PERIOD_S = 0.2  # a few times per second are enough for any WatchdogSec


class Notifier:
    """Sends notifications to $NOTIFY_SOCKET; does nothing where systemd did not start this process.

    Only completed control cycles feed the watchdog. A process that hangs or a loop that stops ticking triggers it.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        if self._address.startswith("@"):
            self._address = "\0" + self._address[1:]  # abstract socket name of Linux
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if self._address else None
        if self._socket:
            self._socket.setblocking(False)  # the control loop never waits for the service manager
        self._watchdog_period_s = _watchdog_period_s(environment)
        self._fed_s = float("-inf")
        self._is_ready = False
        self._status = ""

    def cycle_completed(self, now_s: float, links_up: bool) -> None:
        """Report a completed control cycle. The first one with autopilot and fleet link makes the service ready."""
        if links_up and not self._is_ready:
            self._is_ready = self._send("READY=1")
        is_due = self._watchdog_period_s is not None and now_s - self._fed_s >= self._watchdog_period_s
        if is_due and self._send("WATCHDOG=1"):
            self._fed_s = now_s

    def status(self, text: str) -> None:
        """Set the status line of `systemctl status`; sent only when it changes."""
        if text != self._status and self._send(f"STATUS={text}"):
            self._status = text

    def stopping(self) -> None:
        """Report that the agent is stopping."""
        self._send("STOPPING=1")

    def close(self) -> None:
        if self._socket:
            self._socket.close()
            self._socket = None

    def _send(self, message: str) -> bool:
        """Whether the message was sent. A failure is ignored: the agent flies without its service manager."""
        if not self._socket:
            return False
        try:
            self._socket.sendto(message.encode(), self._address)
        except OSError:
            return False
        return True


def status_line(status: Status) -> str:
    """Phase and health flags of a vehicle: what `systemctl status` shows of it."""
    return f"{status.phase}; {', '.join(status.flags) or 'no flags'}"


def _watchdog_period_s(environment: Mapping[str, str]) -> float | None:
    """A quarter of WATCHDOG_USEC, or None where no watchdog supervises this process."""
    limit_us = environment.get("WATCHDOG_USEC", "")
    process = environment.get("WATCHDOG_PID", "")
    if not limit_us.isdigit() or int(limit_us) == 0 or (process and process != str(os.getpid())):
        return None
    return max(MIN_WATCHDOG_PERIOD_S, int(limit_us) / 1e6 / 4)
