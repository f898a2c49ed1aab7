"""`serial` and `trimmed` in flight: with attitude lag, late and lost packets, vehicles that are kept off, and one that lies."""

from __future__ import annotations

import numpy as np

from common import ROOT
from sitl.api import FlightData, fly

SHIPPED, EXAMPLES = ROOT / "config/scenarios", ROOT / "config/examples"
FAST = {"stand_in.sensors": "ideal", "stand_in.armable_after_s": 1.0}


def in_formation(flight: FlightData) -> np.ndarray:
    assert flight.summary.failure is None
    return np.all(np.isfinite(flight.errors_m), axis=1)


def test_a_chain_under_serial_closes_up_without_overshoot_over_late_and_lossy_links() -> None:
    n, step_m = 6, 1.0
    chain = {
        "fleet.vehicles": [
            {"id": i, "role": "follower" if i > 1 else "leader", "slot_enu_m": [1.5 - 1.5 * i, 0.0, 0.0]}
            for i in range(1, n + 1)
        ],
        "starts_enu_m": {i: [1.5 - 1.5 * i, 0.0, 0.0] for i in range(1, n + 1)},
        "fleet.neighbours.edges": [[i, i + 1] for i in range(1, n)],
        "reference.point_enu_m": [step_m, 0.0, 1.0],
        "links": {"peer_delay_s": 0.1, "peer_loss": 0.1},
        "timeline[3].for_s": 16.0,
    }
    flight = fly(SHIPPED / "chain_16.yaml", law="serial", overrides=FAST | chain)
    formed = in_formation(flight)
    along_m = flight.positions_enu_m[formed, :, 0] - np.array([1.5 - 1.5 * i for i in range(1, n + 1)])
    assert along_m.max() < step_m + 0.02
    assert flight.errors_m[formed][-1].max() < 0.15
    assert flight.distances_m[formed].min() > 1.4


def test_a_vehicle_that_is_kept_off_its_slot_draws_no_other_with_it_under_serial() -> None:
    """What it publishes is that of the RFT by which it flies, as its position is."""
    for_s = {"timeline[3].for_s": 3.0, "timeline[4].for_s": 20.0}
    flight = fly(SHIPPED / "exchange.yaml", law="serial", overrides=FAST | for_s)
    beside = flight.pairs.index((1, 4))  # 3 m apart before, after and on the way
    assert flight.distances_m[in_formation(flight), beside].max() < 3.4


def test_one_of_eight_lies_and_no_other_is_drawn_off() -> None:
    from_s, grows_for_s = 20.0, 10.0
    lie = {"vehicle": 6, "kind": "drift", "from_s": from_s, "by_enu": [0.0, 3.0, 0.0], "over_s": grows_for_s}
    shorter = {"stand_in.armable_after_s": 1.0, "timeline[3].for_s": 22.0, "links.lies": [lie]}
    flight = fly(EXAMPLES / "trimmed_liar.yaml", overrides=shorter)
    lied = in_formation(flight) & (flight.time_s > from_s)
    assert flight.time_s[lied][-1] > from_s + grows_for_s
    errors_m = dict(zip(flight.vehicles, flight.errors_m[lied].max(axis=0), strict=True))
    del errors_m[6]
    assert max(errors_m.values()) < 0.3
