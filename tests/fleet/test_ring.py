"""Real processes change their leader in flight, on the figure 8 of the paper's second experiment."""

from pathlib import Path

import pytest

from common import ROOT
from companion.types.notices import Code
from process_fleet import fly
from sitl.report.summary import read_summary

pytestmark = [pytest.mark.fleet, pytest.mark.long, pytest.mark.timeout(300)]

RING = ROOT / "config" / "scenarios" / "ring_figure_8.yaml"
LEADERS = (2, 1, 2, 1, 2)
STEPS = (
    "{command: prepare}",
    "{command: arm}",
    "{command: takeoff, for_s: 2}",
    "{command: form, for_s: 12}",
    *(f"{{command: lead, leaders: [{leader}], for_s: 6}}" for leader in LEADERS),
    "{command: land}",
)


def test_the_leader_changes_five_times_in_one_formation(tmp_path: Path) -> None:
    """The timeline of the scenario with shorter times between the changes."""
    timeline = f"timeline=[{', '.join(STEPS)}]"
    fly(RING, tmp_path, "--quiet", "--set", timeline)
    summary = read_summary(tmp_path / "summary.json")
    changes = [
        (event.vehicle, event.event.split(" (")[0]) for event in summary.events if event.code is Code.ROLE_CHANGED
    ]
    expected = [
        (vehicle, f"{change} in epoch {epoch}")
        for epoch, leader in enumerate(LEADERS, start=1)
        for vehicle, change in ((leader, "follower -> leader"), (3 - leader, "leader -> follower"))
    ]
    assert sorted(changes) == sorted(expected)
    assert summary.duration_s == pytest.approx(42.0, abs=2.0)
    assert summary.smallest_distance_m is not None
    assert summary.smallest_distance_m > 1.4
    assert [asked.in_words for asked in summary.commands if "lead" in asked.in_words] == [f"lead {i}" for i in LEADERS]
    assert all(asked.answered_in_s is not None for asked in summary.commands)
    for vehicle in summary.vehicles:
        assert vehicle.tracking_error_m is not None and vehicle.tracking_error_m < 0.6
        assert vehicle.behind_leader_m is not None and vehicle.behind_leader_m < 0.3
        assert vehicle.largest_step_deg is not None and 0.0 < vehicle.largest_step_deg < 5.0
        assert not any("LEADER" in key or "BEACON" in key or "PRC" in key for key in vehicle.rejected)
    assert (tmp_path / "from_above.png").stat().st_size > 10_000
