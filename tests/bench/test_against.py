"""`make bench AGAINST=COMMIT`: its ratios, its figures of a flight, and the worker that measures a checkout."""

from __future__ import annotations

import json
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
import yaml

from common import ROOT
from tests.bench.against import WORKER, Compared, checkout, environment, figures_of_flight
from tests.bench.processes import Program
from tests.bench.scenarios import star_content

pytestmark = pytest.mark.long


def test_a_ratio_above_one_is_better() -> None:
    time_us = Compared("step", "us", is_rate=False, before=[110.0, 100.0], now=[100.0, 100.0])
    assert time_us.ratios == [1.1, 1.0]
    assert Compared("lockstep", "1/s", is_rate=True, before=[200.0], now=[300.0]).ratios == [1.5]


def test_a_figure_is_worse_by_more_than_five_percent_of_its_median_round() -> None:
    assert not Compared("step", "us", before=[96.0, 96.0, 50.0], now=[100.0, 100.0, 100.0]).is_worse
    worse = Compared("step", "us", before=[94.0, 94.0, 150.0], now=[100.0, 100.0, 100.0])
    assert worse.is_worse
    assert "0.940" in worse.line()
    assert worse.line().endswith("WORSE")


def test_figures_of_a_flight_are_means_of_its_agents() -> None:
    vehicles = [
        {"cpu_percent": 5.0, "rss_mb": 40.0, "telemetry_to_command_us": {"p50": 300.0, "p99": 900.0, "max": 1e4}},
        {"cpu_percent": 7.0, "rss_mb": 42.0, "telemetry_to_command_us": {"p50": 500.0, "p99": 1100.0, "max": 1e4}},
    ]
    assert list(figures_of_flight({"vehicles": vehicles}).values()) == [6.0, 41.0, 400.0, 1000.0]


def test_an_unknown_commit_is_one_line() -> None:
    with pytest.raises(RuntimeError, match="nothing: no such commit"):
        checkout("nothing")


def test_a_checkout_is_measured_and_not_this_tree(tmp_path: Path) -> None:
    folder, scenario = checkout("HEAD"), tmp_path / "star.yaml"
    scenario.write_text(yaml.safe_dump(star_content(1, 1.0)), encoding="utf-8")
    code = f"import companion, sitl; print([companion.__file__, sitl.__file__]); exec(open({str(WORKER)!r}).read())"
    with ExitStack() as stack:
        worker = Program(stack, [sys.executable, "-P", "-c", code], environment(folder))
        assert worker.line() == f"{[str(folder / program / '__init__.py') for program in ('companion', 'sitl')]}\n"
        worker.begin(f"step {scenario}")
        assert 10.0 < json.loads(worker.line()) < 5000.0
        worker.begin(f"lockstep {scenario}")
        assert 1.0 < json.loads(worker.line()) < 10_000.0
    assert folder.parent == ROOT / "build" / "against"
