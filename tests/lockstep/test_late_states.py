"""Chains of vehicles whose states arrive with jitter and loss, as batches with ideal sensors."""

import pytest
from msgspec.structs import replace

from companion.analysis.prediction import settle_time_s
from sitl.batch.flight import BatchFlight, fly_batch
from sitl.compare.graphs import led
from sitl.compare.shapes import chain
from sitl.vehicle.config import Links

JITTER = Links(peer_delay_s=0.02, peer_jitter_s=0.05, peer_loss=0.1)
MUCH_JITTER = Links(peer_delay_s=0.02, peer_jitter_s=0.15, peer_loss=0.2)
SPACING_M = 1.5


def flown(vehicles: int, links: Links, duration_s: float) -> BatchFlight:
    """A chain under `cooperative`, after a step of 1 m."""
    return fly_batch([replace(led(chain(vehicles), 1), links=links)], duration_s)


def distances_m(flight: BatchFlight) -> list[float]:
    """Smallest and largest of two in line."""
    apart = abs(flight.positions_enu_m[:, 0, 1:, 0] - flight.positions_enu_m[:, 0, :-1, 0])
    return [float(apart.min()), float(apart.max())]


def test_with_jitter_a_chain_of_16_settles_nearly_as_without() -> None:
    """4.7 s with a velocity extrapolated over the whole age; 3.1 s without any extrapolation."""
    flight = flown(16, JITTER, 8.0)
    time_s = settle_time_s(flight.times_s, flight.errors_m()[:, 0].max(axis=1), 0.1)
    assert time_s is not None
    assert time_s < 2.9


@pytest.mark.long
def test_much_jitter_does_not_break_a_chain_of_100() -> None:
    """Extrapolated over the whole age the far end swings by metres: the smallest distance is 0 then."""
    smallest_m, largest_m = distances_m(flown(100, MUCH_JITTER, 25.0))
    assert smallest_m > 0.4 * SPACING_M
    assert largest_m < 2.0 * SPACING_M
