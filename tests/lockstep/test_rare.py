"""Flights that are split: a branch is the flight of its scenario file, to the bit."""

from __future__ import annotations

from pathlib import Path

import msgspec
import yaml
from msgspec.structs import replace

from sitl.flight.scenario import Scenario, load_scenario
from sitl.gauntlet.rare import MISSIONS, fly_split, mission, reseeded

NO_SPLIT = 0.0


def short(seed: int) -> Scenario:
    """The platoon for four seconds in formation."""
    scenario = mission("platoon", seed)
    form = scenario.timeline[-1]
    return replace(scenario, timeline=(*scenario.timeline[:-1], replace(form, for_s=4.0)))


def test_a_branch_flies_again_from_its_scenario_file(tmp_path: Path) -> None:
    (whole,) = fly_split(short(3), (NO_SPLIT,)).leaves
    level = whole.least + 0.01
    flight = fly_split(short(3), (level, NO_SPLIT))
    branches = flight.leaves
    assert len(branches) == 4
    assert len({leaf.least for leaf in branches}) == 4, "each branch has random numbers of its own"
    assert all(leaf.passed == 1 and leaf.weight == 0.25 for leaf in branches)
    file = tmp_path / "branch.yaml"
    for leaf in branches[::3]:
        file.write_text(yaml.safe_dump(msgspec.to_builtins(reseeded(short(3), leaf))))
        (again,) = fly_split(load_scenario(file), (NO_SPLIT,)).leaves
        assert again.least == leaf.least
    assert fly_split(short(3), (level, NO_SPLIT)) == flight


def test_each_mission_ends_in_formation_and_is_disturbed() -> None:
    for name in MISSIONS:
        scenario = mission(name, 7)
        assert scenario.stand_in.seed == 7
        assert scenario.links.peer_loss > 0.0 and scenario.stand_in.wind.gust_sd_m_s > 0.0
        assert str(scenario.timeline[-1].command) not in ("hold", "land")
