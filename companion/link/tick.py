"""When the control loop ticks, and how well it keeps its rate. No sockets."""

from __future__ import annotations

import asyncio
import os
import resource
from math import log
from pathlib import Path

from companion.types import FlightPhase
from companion.wire.ground import Percentiles, Timing

PERIOD_S = 0.02  # 50 Hz
BACK_UP_S = 0.03  # a tick comes at the latest this long after the one before


class TickTrigger:
    """A position sets off the tick at once: a free-running timer would add up to a whole period to its age.

    When positions stay away a back-up timer keeps the ticks going, so that peers, commands and failsafes are served.
    """

    def __init__(self) -> None:
        self._arrived = asyncio.Event()

    def position_arrived(self) -> None:
        self._arrived.set()

    async def wait(self, last_tick_s: float) -> None:
        """Until a position has come or BACK_UP_S after the last tick. Times are of the event loop's clock."""
        try:
            async with asyncio.timeout_at(last_tick_s + BACK_UP_S):
                await self._arrived.wait()
        except TimeoutError:
            pass
        self._arrived.clear()


class Histogram:
    """Percentiles of a time in microseconds, in constant memory: buckets 5 % apart from 1 us to 100 s."""

    _RATIO = 1.05
    _BUCKETS = int(log(1e8) / log(_RATIO)) + 2

    def __init__(self) -> None:
        self._counts = [0] * self._BUCKETS
        self._total = 0
        self._max_us = 0.0

    def add(self, value_us: float) -> None:
        index = int(log(value_us) / log(self._RATIO)) + 1 if value_us > 1.0 else 0
        self._counts[min(index, self._BUCKETS - 1)] += 1
        self._total += 1
        self._max_us = max(self._max_us, value_us)

    def percentiles(self) -> Percentiles:
        """Zeros while nothing was added. Within 5 % above the true value; the maximum is exact."""
        return Percentiles(self._at(0.50), self._at(0.99), round(self._max_us, 1))

    def _at(self, fraction: float) -> float:
        seen = 0
        for index, count in enumerate(self._counts):
            seen += count
            if count and seen >= fraction * self._total:
                return round(min(self._RATIO**index, self._max_us), 1)
        return 0.0


class TickMeter:
    """Measures the ticks: since the start, from FORMATION on anew, and no further once a formation has ended.

    So the timing reported after landing is that of the flight in formation.
    """

    def __init__(self, now_s: float) -> None:
        self._formed = False  # is this the timing of a formation?
        self._frozen: Timing | None = None
        self._start(now_s)

    def _start(self, now_s: float) -> None:
        self._first_s = now_s
        self._last_s = now_s
        self._ticks = 0
        self._missed = 0
        self._late = Histogram()
        self._telemetry_to_command = Histogram()
        self._cpu_at_start_s = _cpu_time_s()

    def tick(self, now_s: float) -> None:
        """A tick starts."""
        if self._frozen:
            return
        if self._ticks == 0:
            self._first_s = now_s  # the first has no due time; it begins the count
        else:
            interval_s = now_s - self._last_s
            self._late.add(max(0.0, interval_s - PERIOD_S) * 1e6)
            # Over all the time: back-up ticks 30 ms apart miss every third period, though none of them seems to miss one.
            # What was missed stays missed, however fast the ticks that follow.
            self._missed = max(self._missed, round((now_s - self._first_s) / PERIOD_S) - self._ticks)
        self._ticks += 1
        self._last_s = now_s

    def command_sent(self, position_received_s: float, sent_s: float) -> None:
        """The setpoint made from this position has been handed to the socket."""
        if not self._frozen:
            self._telemetry_to_command.add((sent_s - position_received_s) * 1e6)

    def phase_after_tick(self, phase: FlightPhase, now_s: float) -> None:
        """Begin anew where a formation begins; stop where it ends."""
        forms = phase is FlightPhase.FORMATION
        if forms and (not self._formed or self._frozen):
            self._formed, self._frozen = True, None
            self._start(now_s)
        elif not forms and self._formed and not self._frozen:
            self._frozen = self._measured(now_s)

    def timing(self, now_s: float) -> Timing:
        return self._frozen or self._measured(now_s)

    def _measured(self, now_s: float) -> Timing:
        elapsed_s = self._last_s - self._first_s
        wall_s = now_s - self._first_s
        return Timing(
            rate_hz=round((self._ticks - 1) / elapsed_s, 3) if elapsed_s > 0 else 0.0,
            ticks=self._ticks,
            missed=self._missed,
            late_us=self._late.percentiles(),
            telemetry_to_command_us=self._telemetry_to_command.percentiles(),
            cpu_percent=round((_cpu_time_s() - self._cpu_at_start_s) / wall_s * 100, 1) if wall_s > 0 else 0.0,
            rss_mb=round(_rss_mb(), 1),
        )


def _cpu_time_s() -> float:
    """Of this process with all its threads."""
    times = os.times()
    return times.user + times.system


def _rss_mb() -> float:
    """Resident memory now; where /proc is missing, the most there ever was."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return pages * resource.getpagesize() / 1e6
