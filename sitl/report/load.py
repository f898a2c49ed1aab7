"""Whether the machine was too busy for real time, from the agents' own timing."""

from __future__ import annotations

from sitl.report.metrics import TrackSource

MAX_MISSED_SHARE, MAX_LATENCY_MS = 0.005, 5.0  # of the ticks; p99 from telemetry to command. Idle: none, below 1 ms
IF_TOO_BUSY = "distrust the figures, or fly in virtual time: sitl run"
TOO_SLOW = {
    "true": "the machine was too busy for real time: {}; " + IF_TOO_BUSY,
    "estimated": "the machine or the autopilots were too slow for real time: {}",  # PX4's clock may run 2 % slow
}


def overload(ticks: int, missed: int, slowest_us: float) -> str | None:
    """What was measured beyond the limits, in one line; None within them, and in virtual time.

    `ticks` and `missed` are sums over all agents; `slowest_us` is the largest p99 from telemetry to command.
    """
    found = []
    if missed > MAX_MISSED_SHARE * (ticks + missed):
        found.append(f"{100.0 * missed / (ticks + missed):.1f} % of the ticks missed")
    if slowest_us > 1000.0 * MAX_LATENCY_MS:
        found.append(f"{slowest_us / 1000.0:.0f} ms from telemetry to command (p99)")
    return ", ".join(found) or None


def overload_line(found: str, source: TrackSource = "true") -> str:
    return TOO_SLOW[source].format(found)
