"""A short run of the hostile input: the long one is `make hostile`."""

import pytest

from sitl.hostile import command
from sitl.hostile.command import EPISODE_TICKS, run_hostile
from sitl.hostile.decoders import decoders, fuzz
from sitl.hostile.episode import fly


@pytest.mark.parametrize("name", decoders())
def test_decoders_refuse_damaged_input_with_their_own_error(name: str) -> None:
    result = fuzz(name, 5000, seed=0)
    assert result.failures == []
    assert 0 < result.passed <= 5000


@pytest.mark.parametrize("seed", [0, 1])
def test_agents_withstand_hostile_packets_and_commands(seed: int) -> None:
    outcome = fly(seed)
    assert outcome.failures == []
    assert outcome.passed["packet"] > 500


def test_another_seed_flies_other_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    flown: list[list[int]] = []

    def collect(_work: object, jobs: list[command.Job], _show: object) -> list[object]:
        flown.append([seed for name, seed, _count in jobs if not name])
        return []

    monkeypatch.setattr(command, "in_processes", collect)
    for seed in (0, 100):
        run_hostile(inputs=0, ticks=9 * EPISODE_TICKS, seed=seed, out=None)
    assert flown == [[0, 4, 8], [100, 104, 108]]
