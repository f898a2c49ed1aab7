"""Ten minutes of four real agents: is every tick replayed bit for bit, and how long does the report take?

`python -m tests.bench.replay` flies, which takes eleven minutes; with a folder it takes the recordings there.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec

from companion.recording.reader import recordings
from companion.recording.records import EVENT
from companion.types.notices import Code
from tests.bench.scenarios import SCENARIOS

SCENARIO = SCENARIOS / "ring_figure_8.yaml"
STEP_S = 66.0
STEPS = (
    "{command: prepare}",
    "{command: arm}",
    "{command: takeoff, for_s: 5}",
    f"{{command: form, for_s: {STEP_S:g}}}",
    f"{{command: lead, leaders: [2], for_s: {STEP_S:g}}}",
    f"{{command: formation, formation: {{shape: circle, spacing_m: 3.0}}, for_s: {STEP_S:g}}}",
    f"{{command: lead, leaders: [1], for_s: {STEP_S:g}}}",
    f"{{command: formation, formation: {{shape: line, spacing_m: 3.0}}, for_s: {STEP_S:g}}}",
    f"{{command: lead, leaders: [2], for_s: {STEP_S:g}}}",
    f"{{command: formation, formation: {{shape: diamond, spacing_m: 3.0}}, for_s: {STEP_S:g}}}",
    f"{{command: lead, leaders: [1], for_s: {STEP_S:g}}}",
    f"{{command: formation, formation: {{shape: v, spacing_m: 3.0}}, for_s: {STEP_S:g}}}",
    "{command: land}",
)
SETTINGS = ("stand_in.sensors=default", f"timeline=[{', '.join(STEPS)}]")
REPORT_LIMIT_S = 20.0
REPORT_EXIT_CODES = (0, 1)  # without and with critical findings


@dataclass(frozen=True, slots=True)
class Replayed:
    """Of all vehicles. `text` is what `companion replay` printed."""

    ticks: int
    equal: bool
    text: str


def fly(folder: Path, *more: str) -> None:
    """By `sitl fly`: real agents and stand-ins, in real time. Raises subprocess.CalledProcessError."""
    settings = [word for setting in SETTINGS for word in ("--set", setting)]
    _run(["sitl", "fly", str(SCENARIO), "--quiet", "--out", str(folder), *settings, *more])


def changes(folder: Path) -> Counter[str]:
    """How often a vehicle changed its role and its formation in flight."""
    events = (message.value.code for one in recordings(folder, print) for message in one.read([EVENT], print))
    return Counter(code for code in events if code in (Code.ROLE_CHANGED, Code.FORMATION_CHANGED))


def replayed(folder: Path) -> Replayed:
    """By `companion replay`, in another process."""
    done = _python(["companion", "replay", str(folder), "--json"])
    if not done.stdout:
        return Replayed(0, False, done.stderr)
    result = msgspec.json.decode(done.stdout)
    return Replayed(
        sum(one["ticks"] for one in result["vehicles"]), result["equal"] and not done.returncode, done.stdout
    )


def main() -> int:
    """The exit code: 0 where every tick is equal and the report is soon there."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.replay", description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", metavar="FOLDER", help="recordings of an earlier flight")
    given: Path | None = parser.parse_args().folder
    if given:
        return _judged(given)
    with TemporaryDirectory(prefix="replay-") as name:
        fly(Path(name))
        return _judged(Path(name))


def _judged(folder: Path) -> int:
    found = changes(folder)
    all_ticks = replayed(folder)
    if not all_ticks.equal:
        print(all_ticks.text)
    began_s = time.monotonic()
    reported = _python(["companion", "report", str(folder), "--out", str(folder / "benchmark_report.html")])
    report_s = time.monotonic() - began_s
    print(
        f"{all_ticks.ticks} ticks with {found[Code.ROLE_CHANGED]} changes of a role and {found[Code.FORMATION_CHANGED]} of"
        f" a formation: {'all equal' if all_ticks.equal else 'NOT EQUAL'}\n"
        f"report: {report_s:.1f} s, limit {REPORT_LIMIT_S:g} ({report_s / REPORT_LIMIT_S:.2f});"
        f" {reported.stderr.splitlines()[-1].strip()}"
    )
    written = reported.returncode in REPORT_EXIT_CODES
    return 0 if all_ticks.equal and len(found) == 2 and written and report_s <= REPORT_LIMIT_S else 1


def _python(module: Sequence[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", *module], capture_output=True, text=True, check=False)


def _run(module: Sequence[str]) -> None:
    subprocess.run([sys.executable, "-m", *module], check=True)


if __name__ == "__main__":
    sys.exit(main())
