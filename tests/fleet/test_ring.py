"""Real processes change their leader in flight, on the figure 8 of the paper's second experiment."""

import subprocess
import sys
from pathlib import Path

import pytest

from sitl.summary import read_summary

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(300)]

RING = Path(__file__).parents[2] / "config" / "scenarios" / "ring_figure_8.yaml"
STEPS = (
    "{command: prepare}",
    "{command: arm}",
    "{command: takeoff, for_s: 2}",
    "{command: form, for_s: 12}",
    "{command: lead, leaders: [2], for_s: 6}",
    "{command: lead, leaders: [1], for_s: 6}",
    "{command: land}",
)


def test_the_lead_changes_twice_in_one_formation(tmp_path: Path) -> None:
    timeline = f"timeline=[{', '.join(STEPS)}]"
    command = [
        sys.executable,
        "-m",
        "sitl",
        "fly",
        str(RING),
        "--out",
        str(tmp_path),
        "--port-offset",
        "2300",
        "--quiet",
    ]
    done = subprocess.run([*command, "--set", timeline], capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    summary = read_summary(tmp_path / "summary.json")
    changes = [(event.vehicle, event.event) for event in summary.events if "epoch" in event.event]
    assert sorted(changes) == [
        (1, "follower -> leader in epoch 2 (told so)"),
        (1, "leader -> follower in epoch 1 (told so)"),
        (2, "follower -> leader in epoch 1 (told so)"),
        (2, "leader -> follower in epoch 2 (told so)"),
    ]
    assert summary.duration_s == pytest.approx(24.0, abs=1.0)
    assert summary.final_error_m is not None
    assert summary.final_error_m < 0.6
    assert summary.smallest_distance_m is not None
    assert summary.smallest_distance_m > 1.4
    assert all(not any("leader" in reason or "PrC" in reason for reason in v.rejected) for v in summary.vehicles)
