"""Trend of the resources of processes: what counts as constant."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from companion.wire.messages import Percentiles, Timing
from sitl.flight.scenario import load_scenario
from tests.bench.machine import Machine
from tests.soak.page import page
from tests.soak.run import VEHICLES, scenario_file
from tests.soak.samples import ROWS, Sample, Ticks, findings, slope, table

pytestmark = pytest.mark.long


def samples(count: int = 100, **growth: float) -> list[Sample]:
    """Constant but for the growth per sample, 10 s apart."""
    start: dict[str, float] = {"memory_mb": 48.0, "files": 20, "threads": 9, "rate_hz": 50.0, "command_p99_us": 800.0}
    return [
        Sample(
            time_s=10.0 * n,
            missed=0,
            **{name: type(value)(value + n * growth.get(name, 0.0)) for name, value in start.items()},  # type: ignore[arg-type]
        )
        for n in range(count)
    ]


def growing(made: list[Sample]) -> list[str]:
    return [finding.name for finding in findings(made) if not finding.constant]


@pytest.mark.parametrize(
    ("growth", "names"),
    [
        ({}, []),
        ({"memory_mb": 0.02}, ["memory"]),
        ({"memory_mb": 0.004}, []),
        ({"files": 0.1}, ["files"]),
        ({"threads": 0.1}, ["threads"]),
        ({"rate_hz": -0.05}, ["tick rate"]),
        ({"command_p99_us": 50.0}, ["telemetry to command"]),
    ],
)
def test_a_growing_figure_is_found(growth: dict[str, float], names: list[str]) -> None:
    assert growing(samples(**growth)) == names


@pytest.mark.parametrize(("slow", "names"), [(1, []), (9, ["tick rate"])])
def test_a_single_stall_of_the_machine_is_not_a_change(slow: int, names: list[str]) -> None:
    made = [replace(sample, rate_hz=48.5) if 40 <= n < 40 + slow else sample for n, sample in enumerate(samples(200))]
    assert growing(made) == names


def test_a_file_open_for_a_moment_is_no_growth() -> None:
    made = samples()
    made[70] = replace(made[70], files=21)
    assert growing(made) == []
    late = [replace(sample, files=21) if n > 80 else sample for n, sample in enumerate(samples())]
    assert growing(late) == ["files"]


def test_a_rate_is_by_the_agents_clock() -> None:
    """A report may hold a measurement 0.9 s old."""
    none = Percentiles(0.0, 0.0, 0.0)
    one = Ticks.of(Timing(50.0, 501, 0, none, none, 5.0, 48.0))
    other = Ticks.of(Timing(49.9, 997, 0, none, none, 5.0, 48.0))
    assert other.rate_hz(one) == pytest.approx(496 / (996 / 49.9 - 10.0))
    assert one.rate_hz(one) == 0.0


def test_growth_during_the_warm_up_does_not_count() -> None:
    made = samples(memory_mb=0.0)
    warm = [Sample(s.time_s, 20.0 + s.time_s / 10.0, s.files, s.threads, s.rate_hz, 0, 800.0) for s in made[:15]]
    assert growing(warm + made[15:]) == []


def test_a_few_samples_give_no_verdict() -> None:
    with pytest.raises(ValueError, match="samples after the warm-up"):
        findings(samples(4))


def test_the_table_has_the_first_and_the_last_sample() -> None:
    lines = table(samples(100))
    assert len(lines) <= ROWS + 2
    assert lines[1].split()[0] == "0"
    assert lines[-1].split()[0] == "990"


def test_the_page_has_the_verdict_the_samples_and_what_failed() -> None:
    machine = Machine(
        processor="P", cores=2, python="3.11", commit="abc", date="2026-01-02", lasted_s=3660.0, stolen_percent=0.5
    )
    made = samples(memory_mb=0.02)
    text = page(machine, made, findings(made), ["vehicle 3 left the formation"])
    assert "Measured on 2026-01-02 in 61.0 minutes on 2 cores of P" in text
    assert "| memory | **changes** | +7.20 MB/h" in text
    assert "| files | constant | 20 to 20 |" in text
    assert "| 990 | 49.98 | 20 | 9 | 50.00 | 0 | 0.80 |" in text
    assert "The flight failed: vehicle 3 left the formation." in text


def test_slope_of_a_line() -> None:
    assert slope([0.0, 1.0, 2.0], [1.0, 3.0, 5.0]) == pytest.approx(2.0)


def test_the_scenario_of_the_soak_is_valid(tmp_path: Path) -> None:
    scenario = load_scenario(scenario_file(tmp_path, 60.0))
    assert len(scenario.fleet.vehicles) == VEHICLES
