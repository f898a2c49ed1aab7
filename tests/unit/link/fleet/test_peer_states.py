"""How many messages under the keys of the vehicles wait for a tick."""

from __future__ import annotations

import pytest

from companion.link.fleet.peer_states import LEAST_PER_VEHICLE, PACKETS_PER_VEHICLE, SAMPLES_KEPT, samples_to_keep
from companion.types.values import MAX_VEHICLES

REFUSED_IN_US = 15  # one message, counted
TICK_US = 20_000


@pytest.mark.parametrize("vehicles", [1, 2, 8, 9, 16, 63, 64, 65, MAX_VEHICLES])
def test_garbage_under_all_keys_is_refused_within_a_tick(vehicles: int) -> None:
    kept = samples_to_keep(vehicles)
    assert kept >= 2 * PACKETS_PER_VEHICLE  # a packet among as much garbage
    assert vehicles * kept <= SAMPLES_KEPT or kept == LEAST_PER_VEHICLE
    assert vehicles > SAMPLES_KEPT // LEAST_PER_VEHICLE or vehicles * kept * REFUSED_IN_US < TICK_US


def test_in_a_small_fleet_a_hundred_messages_displace_no_packet() -> None:
    assert samples_to_keep(8) == 128
