"""Flights that are split: a branch is the flight of its scenario file, to the bit."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from pathlib import Path
from statistics import fmean, variance

import msgspec
import pytest
import yaml
from msgspec.structs import replace

from sitl.flight.scenario import load_scenario
from sitl.gauntlet import rare
from sitl.gauntlet.rare import MISSIONS, RareFlight, fly_split, mission, reseeded
from sitl.gauntlet.splitting import EVENT, Branching, Leaf, Seed, estimate


def first(seed: int) -> Branching:
    return Branching((Seed(0.0, str(seed)),))


def short(branching: Branching) -> RareFlight:
    """The platoon for four seconds in formation."""
    scenario = mission("platoon", int(branching.seeds[0].seed))
    form = scenario.timeline[-1]
    scenario = replace(scenario, timeline=(*scenario.timeline[:-1], replace(form, for_s=4.0)))
    return fly_split(reseeded(scenario, branching.seeds), branching)


def test_a_branch_flies_again_by_its_seeds() -> None:
    whole = short(first(3))
    level = whole.leaves[0].score + 0.01
    branching = Branching(first(3).seeds, level, ("a", "b", "c"))
    flight = short(branching)
    assert len({leaf.least for leaf in flight.leaves}) == 3, "each branch has random numbers of its own"
    assert all(leaf.score < level and leaf.score <= leaf.least for leaf in flight.leaves)
    assert 0.0 < flight.formation_s < whole.formation_s
    for leaf in flight.leaves[::2]:
        assert short(Branching(leaf.seeds)).leaves == [leaf]
    (deeper,) = short(Branching(flight.leaves[0].seeds, flight.leaves[0].score + 1e-6, ("d",))).leaves
    assert short(Branching(deeper.seeds)).leaves == [deeper]
    assert short(branching) == flight


def test_the_scenario_file_of_a_branch_is_its_flight(tmp_path: Path) -> None:
    seeds = (*first(3).seeds, Seed(9.5, "a"))
    scenario = reseeded(mission("platoon", 3), seeds)
    file = tmp_path / "branch.yaml"
    file.write_text(yaml.safe_dump(msgspec.to_builtins(scenario)))
    assert load_scenario(file) == scenario


def test_each_mission_ends_in_formation_and_is_disturbed() -> None:
    for name in MISSIONS:
        scenario = mission(name, 7)
        assert scenario.stand_in.seed == 7
        assert scenario.links.peer_loss > 0.0 and scenario.stand_in.wind.gust_sd_m_s > 0.0
        assert str(scenario.timeline[-1].command) not in ("hold", "land")


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_split_flights_find_what_plain_ones_find(monkeypatch: pytest.MonkeyPatch) -> None:
    """An event that some 3 % of the plain flights have: two are nearer than separation_m and 4.25 sigmas."""
    monkeypatch.setattr(rare, "SIGMAS", -4.25)

    def flown(jobs: Sequence[Branching]) -> list[Leaf]:
        return [leaf for job in jobs for leaf in short(job).leaves]

    plain = flown([first(seed) for seed in range(1000, 1400)])
    share = sum(leaf.least < EVENT for leaf in plain) / len(plain)
    found = [estimate(flown, 40, 1000 * seed).probability for seed in range(2, 12)]
    assert 0.01 < share < 0.08
    error = sqrt(variance(found) / len(found) + share * (1.0 - share) / len(plain))
    print(f"\n{share:.4f} of 400 plain flights; by splitting {fmean(found):.4f}; standard error {error:.4f}")
    assert abs(fmean(found) - share) < 2.5 * error
    assert error < share
