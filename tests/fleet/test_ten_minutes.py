"""Ten minutes of four real agents, with changes of leader and formation: every tick replays bit for bit."""

from pathlib import Path

import pytest

from companion.recording.reader import recordings
from companion.types.notices import Code
from processes import free_fleet_offset
from tests.bench.replay import changes, fly, replayed

pytestmark = [pytest.mark.fleet, pytest.mark.long, pytest.mark.timeout(1200)]

VEHICLES, FLOWN_S, TICKS_PER_S = 4, 600.0, 50


def test_every_tick_replays_bit_for_bit(tmp_path: Path) -> None:
    fly(tmp_path, "--port-offset", str(free_fleet_offset()))
    assert [one.vehicle_id for one in recordings(tmp_path, print)] == list(range(1, VEHICLES + 1))
    found = changes(tmp_path)
    assert found[Code.ROLE_CHANGED] >= 2
    assert found[Code.FORMATION_CHANGED] >= VEHICLES
    result = replayed(tmp_path)
    assert result.equal, result.text
    assert result.ticks >= 0.95 * VEHICLES * FLOWN_S * TICKS_PER_S  # nothing was left out
