"""The autopilot's clock against this computer's: how late its samples arrive. No clocks of its own, no sockets.

A full serial buffer or a slow radio delivers telemetry at its full rate, but up to seconds late: the time since its arrival
says nothing. TIMESYNC measures the way: the autopilot answers with the clock of its `time_boot_ms`. This computer's clock is
ahead of that one by at least (time of the request - time in the answer) and at most (arrival of the answer - time in the
answer), as in NTP. The smaller difference is used, so that the delay of requests and setpoints counts as well.
"""

from __future__ import annotations

from collections import deque
from math import inf

REQUEST_PERIOD_S = 0.2
LATE_S = 0.1  # less is usual: a radio, or a busy computer
EXCHANGES = 10  # 2 s: a single slow answer says nothing
WAITING = 50  # requests without an answer, 10 s
REBOOT_S = 1.0  # a time_boot_ms that decreases by more is a reboot
# PX4's clock runs 1 to 2 % slow. Without new answers the delay may seem to grow by this share.
CLOCK_ERROR = 0.02
WINDOW_S = 1.0  # of two windows the smallest difference counts where TIMESYNC is not answered
SILENT_S = 10.0  # so long without an answer, and TIMESYNC counts as not answered
OTHER_CLOCK_S = 60.0  # an answer so far from the last position is of another clock than time_boot_ms


class AutopilotClock:
    """Answers of TIMESYNC, and without them the smallest difference between arrival and `time_boot_ms` of the last 1 to 2 s."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Nothing is known of this clock: before the first sample, and after a reboot of the autopilot."""
        self._waiting_ns: deque[int] = deque(maxlen=WAITING)
        self._exchanges: deque[tuple[float, float]] = deque(maxlen=EXCHANGES)  # (ahead by at least, round trip), in s
        self._boot_s = -inf
        self._ahead_s = self._answered_s = -inf
        self._least_s = self._least_before_s = inf
        self._window_s = -inf  # begin of the present window

    @property
    def round_trip_s(self) -> float | None:
        """The shortest round trip of the last answers; None where none came."""
        return min((round_trip_s for _, round_trip_s in self._exchanges), default=None)

    def request(self, now_s: float) -> int:
        """`ts1` of a request that is sent now, in ns."""
        self._waiting_ns.append(round(now_s * 1e9))
        return self._waiting_ns[-1]

    def receive_answer(self, ts1_ns: int, tc1_ns: int, received_s: float) -> None:
        """TIMESYNC with its two times. What answers no request of this end, or by another clock, is ignored.

        Before the first position all count: ArduCopter sends none until it has used a pose, whose stamp is of its clock.
        """
        boot_s = tc1_ns / 1e9
        if ts1_ns not in self._waiting_ns or OTHER_CLOCK_S < abs(boot_s - self._boot_s) < inf:
            return
        self._waiting_ns.remove(ts1_ns)
        self.exchange(ts1_ns / 1e9, boot_s, received_s)

    def exchange(self, sent_s: float, boot_s: float, received_s: float) -> None:
        """A request sent at `sent_s` was answered at `boot_s` of the autopilot's clock, and the answer came at `received_s`."""
        self._exchanges.append((sent_s - boot_s, received_s - sent_s))
        self._ahead_s, self._answered_s = max(ahead_s for ahead_s, _ in self._exchanges), received_s

    def boot_s(self, at_s: float) -> float:
        """The autopilot's clock when this computer's shows `at_s`; 0 before its first position or answer."""
        ahead_s = self._ahead_s if self._exchanges else min(self._least_s, self._least_before_s)
        return max(0.0, at_s - ahead_s)

    def late_s(self, boot_s: float, received_s: float) -> float:
        """How old a sample of `boot_s` was on arrival at `received_s`; 0 where that is usual."""
        other = self._exchanges and abs(self.boot_s(received_s) - boot_s) > OTHER_CLOCK_S
        if other or boot_s < self._boot_s - REBOOT_S:
            self.restart()
        self._boot_s = boot_s
        ahead_s = received_s - boot_s
        if self._exchanges and received_s - self._answered_s > SILENT_S:
            self._exchanges.clear()
            self._least_s = self._least_before_s = inf  # of the time before the exchanges
        if self._exchanges:
            late_s = ahead_s - self._ahead_s - CLOCK_ERROR * (received_s - self._answered_s)
        else:
            late_s = ahead_s - self._least(ahead_s, received_s)
        return round(late_s, 3) if late_s > LATE_S else 0.0

    def _least(self, ahead_s: float, received_s: float) -> float:
        """The smallest difference of this window and the one before."""
        if received_s - self._window_s > WINDOW_S:
            self._least_before_s, self._least_s, self._window_s = self._least_s, inf, received_s
        self._least_s = min(self._least_s, ahead_s)
        return min(self._least_s, self._least_before_s)
