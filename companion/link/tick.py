"""Trigger of the control loop's ticks, and measurement of their rate and delay. No sockets."""

from __future__ import annotations

import asyncio
import logging
import os
import resource
import time
from bisect import bisect_left
from collections.abc import Callable
from itertools import accumulate
from math import inf, log
from pathlib import Path
from typing import Protocol

from companion.types.flight import FlightPhase
from companion.types.notices import Code, Notice
from companion.wire.messages import Percentiles, Timing

PERIOD_S = 0.02  # 50 Hz
BACK_UP_S = 0.03  # longest time between two ticks
LEAST_PERIOD_S = 1 / 60  # mean time between ticks while positions come faster than requested
TICKS_AT_ONCE = 3  # after a late position the next ones follow at once
PREPARED_S = 0.002  # the first part runs so long before the next position is due; autopilots send them to a millisecond
LATE_S = 0.02  # logged from this lateness on; on an idle machine a tick is less than 2 ms late
LOG_PERIOD_S = 1.0
# Between two measurements of the timing: one takes half the time of a decision. The first ticks are shown at once.
MEASURED_PERIOD_S, MEASURED_TICKS = 0.9, 50
OWN_MEMORY = Path("/proc/self/statm")

_log = logging.getLogger(__name__)


def monotonic_s() -> float:
    """Time of this machine's monotonic clock, to the microsecond. More digits would be noise in packets and recordings."""
    return round(time.monotonic(), 6)


class TickTrigger:
    """A position triggers the tick at once: a free-running timer would add up to one period to its age.

    Without positions a back-up timer triggers the ticks, so that peers, commands and failsafes are served. A flood of
    positions triggers one tick per LEAST_PERIOD_S, after a burst of TICKS_AT_ONCE. Ticks run in callbacks of the event loop:
    to wake a task would take another pass of the loop.
    """

    def __init__(self) -> None:
        self._ticking: Ticking | None = None
        self._ended: asyncio.Future[None] | None = None

    async def run(self, tick: Callable[[], None], prepare: Callable[[], None]) -> None:
        """Tick until `end`, with `prepare` shortly before a position is expected. Neither may raise."""
        loop = asyncio.get_running_loop()
        self._ended, self._ticking = loop.create_future(), Ticking(loop, tick, prepare)
        try:
            await self._ended
        finally:
            self._ticking.end()

    def position_arrived(self, arrived_s: float) -> None:
        """Tick now, or soon where positions come too fast. `arrived_s`: when it came, which may be before it was read."""
        if self._ticking:
            self._ticking.position_arrived(arrived_s)

    def end(self) -> None:
        """No further tick; `run` returns."""
        if self._ticking and self._ended:
            self._ticking.end()
            if not self._ended.done():
                self._ended.set_result(None)


class Timer(Protocol):
    """A call that is to come."""

    def cancel(self) -> None:
        """It does not come."""


class Timers(Protocol):
    """What ticks need of an event loop: its clock, and calls at a time. That of virtual time has both, too."""

    def time(self) -> float:
        """Now, seconds."""

    def call_at(self, when: float, callback: Callable[[], None], /) -> Timer:
        """Call once at this time."""


class Ticking:
    """The ticks of one run. The one timer is for the preparation, the back-up, or a position that came too soon."""

    def __init__(self, timers: Timers, tick: Callable[[], None], prepare: Callable[[], None]) -> None:
        self._timers, self._tick, self._prepare = timers, tick, prepare
        self._has_ended = False
        self._ticked_s = timers.time()  # when the last tick began
        self._expected_s = -inf  # when the next position will come
        self._nominal_s = -inf  # time of the next tick at the highest mean rate
        self._postponed = False  # whether the timer is for a position that came too soon
        self._timer = timers.call_at(self._ticked_s + BACK_UP_S, self._tick_now)

    def position_arrived(self, arrived_s: float) -> None:
        """As `TickTrigger.position_arrived`."""
        self._expected_s = arrived_s + PERIOD_S
        earliest_s = self._nominal_s - (TICKS_AT_ONCE - 1) * LEAST_PERIOD_S
        if earliest_s <= self._timers.time():
            self._tick_now()
        elif not self._postponed:
            self._postponed = True
            self._set_timer(earliest_s, self._tick_now)

    def end(self) -> None:
        """No further tick."""
        self._has_ended = True
        self._timer.cancel()

    def _tick_now(self) -> None:
        if self._has_ended:
            return
        self._postponed = False
        self._ticked_s = self._timers.time()
        self._nominal_s = max(self._nominal_s, self._ticked_s) + LEAST_PERIOD_S
        if self._expected_s <= self._ticked_s:  # no position came
            self._expected_s = self._ticked_s + PERIOD_S
        self._tick()
        self._set_timer(self._expected_s - PREPARED_S, self._prepare_now)

    def _prepare_now(self) -> None:
        self._prepare()
        self._set_timer(self._ticked_s + BACK_UP_S, self._tick_now)

    def _set_timer(self, at_s: float, callback: Callable[[], None]) -> None:
        self._timer.cancel()
        if not self._has_ended:
            self._timer = self._timers.call_at(at_s, callback)


class LateLoopLog:
    """Reports cycles of a loop that started more than LATE_S after their due time, in one line a second at most.

    Cause: another process had the processor, or the cycle before took too long.
    """

    def __init__(self, report: Callable[[Notice], object] = _log.warning) -> None:
        self._report = report
        self._count = 0
        self._worst_s = 0.0
        self._reported_s = float("-inf")

    def cycle(self, due_s: float, now_s: float) -> None:
        """A cycle that was due at `due_s` starts."""
        if now_s - due_s > LATE_S:
            self._count += 1
            self._worst_s = max(self._worst_s, now_s - due_s)
        if self._count and now_s - self._reported_s >= LOG_PERIOD_S:
            text = f"{self._count} cycles of the loop started late, at most {self._worst_s * 1000:.0f} ms"
            self._report(Notice(Code.LOOP_LATE, text))
            self._count, self._worst_s, self._reported_s = 0, 0.0, now_s


class Histogram:
    """Percentiles of times in microseconds, in constant memory: buckets 5 % apart from 1 us to 100 s."""

    _RATIO = 1.05
    _BUCKETS = int(log(1e8) / log(_RATIO)) + 2

    def __init__(self) -> None:
        self._counts = [0] * self._BUCKETS
        self._total = 0
        self._max_us = 0.0

    def add(self, value_us: float) -> None:
        """Add one time."""
        index = int(log(value_us) / log(self._RATIO)) + 1 if value_us > 1.0 else 0
        self._counts[min(index, self._BUCKETS - 1)] += 1
        self._total += 1
        self._max_us = max(self._max_us, value_us)

    def percentiles(self) -> Percentiles:
        """50 %, 99 % and maximum; zeros without data. At most 5 % above the true value; the maximum is exact."""
        return Percentiles(self._at(0.50), self._at(0.99), round(self._max_us, 1))

    def _at(self, fraction: float) -> float:
        if not self._total:
            return 0.0
        index = bisect_left(list(accumulate(self._counts)), fraction * self._total)
        return round(min(self._RATIO**index, self._max_us), 1)


class TickMeter:
    """Timing of the ticks since the start, or of the last formation once there was one.

    So the timing reported after landing is that of the formation flight.
    """

    def __init__(self, now_s: float) -> None:
        self._formed = False  # whether this is the timing of a formation
        self._frozen: Timing | None = None
        self._newest: tuple[float, Timing] | None = None  # when it was measured
        self._start(now_s)

    def _start(self, now_s: float) -> None:
        self._first_s = now_s
        self._last_s = now_s
        self._newest = None
        self._ticks = 0
        self._missed = 0
        self._late = Histogram()
        self._telemetry_to_command = Histogram()
        self._cpu_at_start_s = _cpu_time_s()

    def tick(self, now_s: float) -> None:
        """Record the start of a tick."""
        if self._frozen:
            return
        if self._ticks == 0:
            self._first_s = now_s  # the first tick has no due time
        else:
            interval_s = now_s - self._last_s
            self._late.add(max(0.0, interval_s - PERIOD_S) * 1e6)
            # Counted over the whole time: back-up ticks 30 ms apart miss every third period, though no single one does.
            # A missed period stays missed, even if faster ticks follow.
            self._missed = max(self._missed, round((now_s - self._first_s) / PERIOD_S) - self._ticks)
        self._ticks += 1
        self._last_s = now_s

    def add_command(self, position_received_s: float, sent_s: float) -> None:
        """Record that the setpoint for this position was handed to the socket."""
        if not self._frozen:
            self._telemetry_to_command.add((sent_s - position_received_s) * 1e6)

    def phase_after_tick(self, phase: FlightPhase, now_s: float) -> None:
        """Restart the measurement when a formation begins; stop it when the formation ends."""
        in_formation = phase is FlightPhase.FORMATION
        if in_formation and (not self._formed or self._frozen):
            self._formed, self._frozen = True, None
            self._start(now_s)
        elif not in_formation and self._formed and not self._frozen:
            self._frozen = self._measure(now_s)

    def timing(self, now_s: float) -> Timing:
        """Timing since the start, or of the last formation; at most MEASURED_PERIOD_S old."""
        if self._frozen:
            return self._frozen
        if self._newest and now_s - self._newest[0] < MEASURED_PERIOD_S:
            return self._newest[1]
        measured = self._measure(now_s)
        if self._ticks >= MEASURED_TICKS:
            self._newest = now_s, measured
        return measured

    def _measure(self, now_s: float) -> Timing:
        elapsed_s = self._last_s - self._first_s
        wall_s = now_s - self._first_s
        return Timing(
            # Six decimals: the rate of some seconds is told from two such means, hours after the first tick.
            rate_hz=round((self._ticks - 1) / elapsed_s, 6) if elapsed_s > 0 else 0.0,
            ticks=self._ticks,
            missed=self._missed,
            late_us=self._late.percentiles(),
            telemetry_to_command_us=self._telemetry_to_command.percentiles(),
            cpu_percent=round((_cpu_time_s() - self._cpu_at_start_s) / wall_s * 100, 1) if wall_s > 0 else 0.0,
            rss_mb=round(_rss_mb(), 1),
        )


def _cpu_time_s() -> float:
    """CPU time of this process with all its threads."""
    times = os.times()
    return times.user + times.system


def _rss_mb() -> float:
    """Resident memory, MB; the peak where /proc is missing."""
    try:
        pages = int(OWN_MEMORY.read_bytes().split()[1])
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return pages * resource.getpagesize() / 1e6
