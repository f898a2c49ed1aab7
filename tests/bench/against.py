"""Two commits measured alternately in one run, and the ratios of their speed: `make bench AGAINST=COMMIT`.

    python -m tests.bench.against COMMIT [step] [lockstep] [large] [flight]

`step` is the warm time of Agent.step, `lockstep` the vehicle-seconds in virtual time per second of CPU time of fleets of 4 and
16, `large` of one of 100 (ten minutes), `flight` CPU, memory and latency of real agents in flight; without a choice all but
`large`. The commit is unpacked into build/against; this tree is
measured as it is. Both take turns, so that the load and the temperature of the machine meet both alike. A ratio above 1 is
better than the commit.

Exit codes: 0 where no figure is worse by more than 5 %; 1 otherwise; 2 for a commit that cannot be unpacked or measured.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean, median, quantiles
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from tests.bench.page import digits
from tests.bench.processes import Program
from tests.bench.scenarios import SCENARIOS, grid_content, star_content

TOP = Path(__file__).parents[2]
WORKER = Path(__file__).parent / "programs" / "measured_commit.py"
GENERATED = Path("companion/mavlink/generated/in_use.py")
KINDS = ("step", "lockstep", "large", "flight")
USUAL = ("step", "lockstep", "flight")
ROUNDS = {"step": 12, "lockstep": 8, "large": 2, "flight": 3}
SCENARIOS_OF = {"step": ("star",), "lockstep": ("platoon", "grid of 4", "grid of 16"), "large": ("grid of 100",)}
PROCESSES = 2  # of each side, one after the other: where its memory lies makes a process a little faster or slower
FLIGHT_FORM_S = 25.0
WORST_RATIO = 0.95


@dataclass(slots=True)
class Compared:
    """One figure of both sides, a value for each round. `is_rate`: more is better."""

    name: str
    unit: str
    is_rate: bool = False
    before: list[float] = field(default_factory=list)
    now: list[float] = field(default_factory=list)

    @property
    def ratios(self) -> list[float]:
        """Of each round, above 1 where this tree is better."""
        pairs = zip(self.before, self.now, strict=True)
        return [now / before if self.is_rate else before / now for before, now in pairs]

    @property
    def is_worse(self) -> bool:
        return median(self.ratios) < WORST_RATIO

    def line(self) -> str:
        low, _, high = quantiles(self.ratios, n=4, method="inclusive") if len(self.ratios) > 1 else self.ratios * 3
        figures = f"{digits(median(self.before)):>9} {digits(median(self.now)):>9} {self.unit:12}"
        spread = f"half of {len(self.ratios)} rounds {low:.3f} to {high:.3f}"
        return f"{self.name:42} {figures} {median(self.ratios):6.3f}   {spread}{'   WORSE' if self.is_worse else ''}"


class Comparison:
    """All figures by name, in the order in which they came."""

    def __init__(self) -> None:
        self.figures: dict[str, Compared] = {}

    def add(self, name: str, unit: str, is_rate: bool, before: float, now: float) -> None:
        figure = self.figures.setdefault(name, Compared(name, unit, is_rate))
        figure.before.append(before)
        figure.now.append(now)


def checkout(commit: str) -> Path:
    """The files of a commit below build/against, with generated and compiled code. Raises RuntimeError."""
    done = subprocess.run(
        ["git", "rev-parse", "--short", f"{commit}^{{commit}}"], cwd=TOP, capture_output=True, text=True
    )
    if done.returncode:
        raise RuntimeError(f"{commit}: no such commit")
    folder = TOP / "build" / "against" / done.stdout.strip()
    if not folder.exists():
        part = folder.with_suffix(".part")
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        archive = subprocess.run(["git", "archive", commit], cwd=TOP, stdout=subprocess.PIPE, check=True)
        subprocess.run(["tar", "x", "-C", str(part)], input=archive.stdout, check=True)
        part.rename(folder)
    _compile(folder)
    return folder


def _compile(folder: Path) -> None:
    """Generated and cached code. Without cached code an agent has 5 MB more, and compiles while it is measured."""
    if not (folder / GENERATED).exists():
        subprocess.run([sys.executable, "-m", "companion.mavlink.generate"], env=environment(folder), check=True)
    subprocess.run([sys.executable, "-m", "compileall", "-q", "companion", "sitl"], cwd=folder, check=True)


def environment(folder: Path) -> dict[str, str]:
    """Variables of a process that imports companion and sitl from this folder."""
    return {**os.environ, "PYTHONPATH": str(folder)}


def measure(before: Path, kinds: Sequence[str], folder: Path) -> Comparison:
    """Everything of these kinds; files are written into `folder`."""
    comparison = Comparison()
    in_process = [kind for kind in SCENARIOS_OF if kind in kinds]
    if in_process:
        _measure_in_process(comparison, before, in_process, folder)
    if "flight" in kinds:
        for number in range(ROUNDS["flight"]):
            sides = {side: _flown(side, folder / f"{number}_{name}") for side, name in _in_turn(before, number)}
            for name, unit in FLIGHT_FIGURES.items():
                comparison.add(name, unit, False, sides[before][name], sides[TOP][name])
            print(f"  flight {number + 1} of {ROUNDS['flight']}", flush=True)
    return comparison


def _measure_in_process(comparison: Comparison, before: Path, kinds: Sequence[str], folder: Path) -> None:
    files = _scenarios(folder)
    for process in range(PROCESSES):
        with ExitStack() as stack:
            command = [sys.executable, "-P", str(WORKER)]
            workers = {side: Program(stack, command, environment(side)) for side in (before, TOP)}
            for kind in kinds:
                for number in range(ROUNDS[kind] // PROCESSES):
                    found = {side: _figures(workers[side], kind, files) for side, _ in _in_turn(before, number)}
                    for name in found[TOP]:
                        label, unit = _label(kind, name)
                        comparison.add(label, unit, kind != "step", found[before][name], found[TOP][name])
        print(f"  processes {process + 1} of {PROCESSES}", flush=True)


def _in_turn(before: Path, number: int) -> Iterator[tuple[Path, str]]:
    """Both sides with their names; each is first in every second round."""
    sides = [(before, "before"), (TOP, "now")]
    yield from sides if number % 2 else reversed(sides)


def _figures(worker: Program, kind: str, files: Mapping[str, Path]) -> dict[str, float]:
    """By the name of the scenario."""
    what = "step" if kind == "step" else "lockstep"
    found = {}
    for name in SCENARIOS_OF[kind]:
        worker.begin(f"{what} {files[name]}")
        found[name] = worker.result(float)
    return found


def _label(kind: str, scenario: str) -> tuple[str, str]:
    if kind == "step":
        return "Agent.step, three neighbours, warm, p50", "us"
    return f"lockstep, {scenario}, whole flight", "vehicle-s/s"


def _scenarios(folder: Path) -> dict[str, Path]:
    """Files by name, because their format is what all commits have in common."""
    contents = {"star": star_content(3, 6.0), "grid of 100": grid_content(100, 0.5)}
    contents |= {f"grid of {count}": grid_content(count, 3.0) for count in (4, 16)}
    for name, content in contents.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    shutil.copy(SCENARIOS / "platoon.yaml", folder)
    return {file.stem: file for file in folder.glob("*.yaml")}


FLIGHT_FIGURES = {
    "CPU of an agent with three peers": "% of a core",
    "memory of an agent": "MB",
    "telemetry to command, p50": "us",
    "telemetry to command, p99": "us",
}


def _flown(side: Path, out: Path) -> dict[str, float]:
    """Means over the agents of one real flight of the platoon. Raises RuntimeError where it fails."""
    scenario = str(side / "config" / "scenarios" / "platoon.yaml")
    settings = ["--set", f"timeline[3].for_s={FLIGHT_FORM_S:g}", "--set", "stand_in.sensors=default"]
    command = [sys.executable, "-m", "sitl", "fly", scenario, "--quiet", "--out", str(out), *settings]
    done = subprocess.run(command, cwd=out.parent, env=environment(side), capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"a flight of {side} failed: {(done.stdout + done.stderr).strip()[-300:]}")
    return figures_of_flight(json.loads((out / "summary.json").read_text(encoding="utf-8")))


def figures_of_flight(summary: Mapping[str, Any]) -> dict[str, float]:
    """From summary.json, whose format all commits have in common."""
    vehicles = summary["vehicles"]

    latencies = [vehicle["telemetry_to_command_us"] for vehicle in vehicles]
    values = (
        fmean([vehicle["cpu_percent"] for vehicle in vehicles]),
        fmean([vehicle["rss_mb"] for vehicle in vehicles]),
        fmean([latency["p50"] for latency in latencies]),
        fmean([latency["p99"] for latency in latencies]),
    )
    return dict(zip(FLIGHT_FIGURES, values, strict=True))


def main() -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.against", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("commit")
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"of {', '.join(KINDS)}; without one all but large")
    parsed = parser.parse_args()
    if unknown := set(parsed.kinds) - set(KINDS):
        parser.error(f"{', '.join(sorted(unknown))}: expected {', '.join(KINDS)}")
    try:
        before = checkout(parsed.commit)
        _compile(TOP)
        with TemporaryDirectory(prefix="against-") as name:
            comparison = measure(before, parsed.kinds or USUAL, Path(name))
    except RuntimeError as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{'':42} {before.name:>9} {'this tree':>9} {'':12} times as good")
    for figure in comparison.figures.values():
        print(figure.line())
    return 1 if any(figure.is_worse for figure in comparison.figures.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
