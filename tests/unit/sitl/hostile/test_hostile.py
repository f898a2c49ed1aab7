"""A short run of the hostile input: the long one is `make hostile`."""

import pytest

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
