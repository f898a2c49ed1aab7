"""Resources of agent processes over time, and a verdict on their trend. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

from companion.wire.messages import Timing

WARM_UP = 0.2  # share of the time that does not count: caches fill, the formation settles
MOST_GROWTH_MB_H = 2.0
MOST_GROWTH_MB = 1.0  # short runs: what allocators scatter
LEAST_MEAN_RATE_HZ = 49.5  # of each half of the time
LEAST_RATE_HZ, MOST_SLOW = 49.0, 0.01  # of one sample, and the share of samples below it: the machine stalls at times
MOST_LATER = 1.5  # telemetry to command, the second half to the first
ROWS = 12  # of the table
COLUMNS = ("time [s]", "memory [MB]", "files", "threads", "rate [Hz]", "missed", "p99 [ms]")


@dataclass(frozen=True, slots=True)
class Ticks:
    """Ticks of one agent since it began formation, missed ones, and the time from the first to the last by its own clock.

    An agent measures its timing once in 0.9 s: the time at which a report of it arrives says little.
    """

    ticks: int
    missed: int
    elapsed_s: float

    @classmethod
    def of(cls, timing: Timing) -> Ticks:
        """From a report."""
        return cls(timing.ticks, timing.missed, (timing.ticks - 1) / timing.rate_hz if timing.rate_hz else 0.0)

    def rate_hz(self, before: Ticks) -> float:
        """Mean rate since an earlier measurement; 0 where there was none since."""
        duration_s = self.elapsed_s - before.elapsed_s
        return (self.ticks - before.ticks) / duration_s if duration_s > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class Sample:
    """All agents at one time: the worst of each figure, and ticks since the sample before.

    `rate_hz` is of the slowest agent; `command_p99_us` from a position's arrival to its setpoint, since the formation began.
    """

    time_s: float
    memory_mb: float
    files: int
    threads: int
    rate_hz: float
    missed: int
    command_p99_us: float


@dataclass(frozen=True, slots=True)
class Finding:
    """One figure of the verdict."""

    name: str
    constant: bool
    text: str


def findings(samples: Sequence[Sample]) -> list[Finding]:
    """The trend of each figure after the warm-up. Raises ValueError with fewer than five samples."""
    settled = [sample for sample in samples if sample.time_s >= samples[0].time_s + WARM_UP * _span_s(samples)]
    if len(settled) < 5:
        raise ValueError(f"{len(settled)} samples after the warm-up, expected at least 5")
    slope_mb_h = slope([s.time_s for s in settled], [s.memory_mb for s in settled]) * 3600.0
    growth_mb = slope_mb_h * _span_s(settled) / 3600.0
    rates = [sample.rate_hz for sample in settled]
    half = len(settled) // 2
    early_us, late_us = (fmean(s.command_p99_us for s in part) for part in (settled[:half], settled[half:]))
    return [
        Finding(
            "memory",
            slope_mb_h <= MOST_GROWTH_MB_H or growth_mb <= MOST_GROWTH_MB,
            f"{slope_mb_h:+.2f} MB/h, {growth_mb:+.2f} MB in {_span_s(settled):.0f} s",
        ),
        _counted("files", [sample.files for sample in settled]),
        _counted("threads", [sample.threads for sample in settled]),
        _rate(rates),
        Finding(
            "telemetry to command",
            late_us <= MOST_LATER * early_us,
            f"p99 {early_us / 1000:.2f} ms in the first half, {late_us / 1000:.2f} ms in the second",
        ),
    ]


def slope(xs: Sequence[float], ys: Sequence[float]) -> float:
    """Of the least-squares line through the points."""
    x0, y0 = fmean(xs), fmean(ys)
    spread = sum((x - x0) ** 2 for x in xs)
    return sum((x - x0) * (y - y0) for x, y in zip(xs, ys, strict=True)) / spread if spread else 0.0


def shown(samples: Sequence[Sample]) -> list[Sample]:
    """At most ROWS of them over the time, the first and the last among them."""
    step = max(1, -(-len(samples) // ROWS))
    return [*samples[:-1:step], samples[-1]]


def cells(sample: Sample) -> tuple[str, ...]:
    """Values of a row, one for each of COLUMNS."""
    return (
        f"{sample.time_s:.0f}",
        f"{sample.memory_mb:.2f}",
        f"{sample.files}",
        f"{sample.threads}",
        f"{sample.rate_hz:.2f}",
        f"{sample.missed}",
        f"{sample.command_p99_us / 1000:.2f}",
    )


def table(samples: Sequence[Sample]) -> list[str]:
    """Lines for the terminal."""
    rows = [COLUMNS, *(cells(sample) for sample in shown(samples))]
    return ["".join(f"{cell:>{len(name) + 2}}" for name, cell in zip(COLUMNS, row, strict=True)) for row in rows]


def _rate(rates_hz: Sequence[float]) -> Finding:
    """Constant where both halves keep the mean rate and hardly a sample is slow."""
    half = len(rates_hz) // 2
    means_hz = [fmean(rates_hz[:half]), fmean(rates_hz[half:])]
    slow = sum(rate_hz < LEAST_RATE_HZ for rate_hz in rates_hz)
    return Finding(
        "tick rate",
        min(means_hz) >= LEAST_MEAN_RATE_HZ and slow <= MOST_SLOW * len(rates_hz),
        f"mean {means_hz[0]:.2f} and {means_hz[1]:.2f} Hz in the halves; {slow} of {len(rates_hz)} samples below"
        f" {LEAST_RATE_HZ:g} Hz, lowest {min(rates_hz):.2f} Hz",
    )


def _counted(name: str, values: Sequence[int]) -> Finding:
    """Constant where the end comes down to what the first half had: a file that is open for a moment is no growth."""
    constant = min(values[-max(1, len(values) // 10) :]) <= max(values[: len(values) // 2])
    return Finding(name, constant, f"{min(values)} to {max(values)}")


def _span_s(samples: Sequence[Sample]) -> float:
    return samples[-1].time_s - samples[0].time_s
