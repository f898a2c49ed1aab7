"""Batches of 1,000 and 10,000 vehicles beside RotorPy, by tests.bench.batch_models in the environment that has RotorPy."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.bench.figures import Row, Section

COUNTS = (1_000, 10_000)
PYTHON = Path(".venv-bench/bin/python")
PAIRS = (
    ("vehicle model, Euler", "RotorPy, Euler, no drag"),
    ("vehicle model, RK4", "RotorPy, RK4, no drag"),
    ("whole formations", "RotorPy, Euler, no drag"),
)
MILLION = 1e6
HOW = """\
`make bench-batch` with 1,000 and 10,000 vehicles: one core, one thread, steps of 4 ms, states in double precision. \
The models take turns in five rounds of half a second; each round is a repeat. RotorPy 3.0.0 (BatchedMultirotor, \
cmd_ctatt, PyTorch on the processor) is fastest without drag, so it stands here without; our models always have drag. \
Whole formations are the platoon's agents, packets and vehicles, not a vehicle model alone."""


def measure() -> Section:
    rates = {count: _rates_1_s(count) for count in COUNTS} if PYTHON.exists() else {}
    return section(rates, "" if rates else f"{PYTHON} is missing: make .venv-bench/bench.ready")


def _rates_1_s(count: int) -> Mapping[str, Sequence[float]]:
    """Vehicle-steps per second of each model, every round. Raises RuntimeError."""
    command = [str(PYTHON), "-m", "tests.bench.batch_models", "--vehicles", str(count), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"tests.bench.batch_models: {(done.stderr.strip() or 'failed').splitlines()[-1]}")
    rates: Mapping[str, Sequence[float]] = json.loads(done.stdout)
    return rates


def section(rates_1_s: Mapping[int, Mapping[str, Sequence[float]]], remark: str) -> Section:
    """From the rates by number of vehicles; rows without figures, with the remark, where there are none."""
    rows = []
    for count in COUNTS:
        models = rates_1_s.get(count, {})
        for own, other in PAIRS:
            rows.append(
                Row(
                    what=f"{own}, {count:,} vehicles",
                    unit="million steps/s",
                    values=_millions(models.get(own, ())),
                    beside=other,
                    beside_values=_millions(models.get(other, ())),
                    remark=remark,
                )
            )
    return Section(title="Batch", how=HOW, rows=tuple(rows))


def _millions(rates_1_s: Sequence[float]) -> tuple[float, ...]:
    return tuple(rate / MILLION for rate in rates_1_s)
