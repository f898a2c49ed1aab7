"""The agent's service in the container, as systemd sees it."""

from __future__ import annotations

import time

from deploy.boot.machine import BootError, Machine, until

UNIT = "companion@1.service"
READY_WITHIN_S = 40.0


class Service:
    """One unit: its state, its main process, and times of CLOCK_MONOTONIC."""

    def __init__(self, machine: Machine, unit: str = UNIT) -> None:
        self._machine = machine
        self.unit = unit

    def value(self, name: str) -> str:
        """A property of `systemctl show`."""
        return self._machine.must("systemctl", "show", "--value", f"--property={name}", self.unit).strip()

    @property
    def pid(self) -> int:
        """The main process, as the container numbers it; 0 without one."""
        return int(self.value("MainPID"))

    @property
    def status(self) -> str:
        """What the agent reported with STATUS=."""
        return self.value("StatusText")

    @property
    def phase(self) -> str:
        """The flight phase in the status line."""
        return self.status.partition(";")[0]

    def signal(self, name: str) -> float:
        """Send a signal to the main process. The time at which it was sent."""
        sent_s = time.monotonic()
        self._machine.must("systemctl", "kill", "--kill-who=main", f"--signal=SIG{name}", self.unit)
        return sent_s

    def back_after(self, since_s: float) -> tuple[float, float]:
        """Seconds from `since_s` to the new process, and to its READY=1. Raises BootError."""
        self._wait_ready(since_s)
        times = (self._time("ExecMainStartTimestampMonotonic"), self._time("ActiveEnterTimestampMonotonic"))
        return times[0] - since_s, times[1] - since_s

    def wait_phase(self, phase: str, within_s: float = 60.0) -> None:
        """Wait until the status line has this phase. Raises BootError."""
        try:
            until(lambda: self.phase == phase, within_s, period_s=0.2)
        except BootError as error:
            raise BootError(f"phase {phase} {error}; the status is {self.status!r}") from None

    def _wait_ready(self, since_s: float) -> None:
        try:
            until(
                lambda: self.value("ActiveState") == "active" and self._time("ActiveEnterTimestampMonotonic") > since_s,
                READY_WITHIN_S,
            )
        except BootError as error:
            raise BootError(f"READY {error}; {self.journal()[-500:]}") from None

    def _time(self, name: str) -> float:
        return int(self.value(name)) / 1e6

    def journal(self) -> str:
        """All lines of the unit."""
        return self._machine.must("journalctl", "--unit", self.unit, "--output=cat", "--no-pager")
