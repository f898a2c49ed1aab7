"""When a vehicle has reached its slot, and what became of the vehicles of a flight."""

from __future__ import annotations

import numpy as np
import pytest

from companion.types.notices import Code
from sitl.flight.orders import Refusal
from sitl.gauntlet.flight import SETTLED, FlightOutcome, SlotArrivals, reference_rests_from_s, settled_s
from sitl.gauntlet.summary import Fate, fates, summarize


def in_slot(*runs: tuple[bool, int]) -> np.ndarray:
    return np.concatenate([np.full(samples, value) for value, samples in runs])


@pytest.mark.parametrize(
    ("runs", "expected_s"),
    [
        ([(False, 30), (True, SETTLED)], 3.0),
        ([(False, 30), (True, SETTLED - 1)], None),  # not for long enough
        ([(True, SETTLED - 1), (False, 1), (True, SETTLED)], 2.0),  # flew through it first
        ([(True, SETTLED), (False, 1), (True, SETTLED)], 0.0),  # pushed aside later, and back
        ([(True, 100), (False, 1)], None),  # not there at the end
        ([(True, 100)], 0.0),
        ([(False, 100)], None),
        ([(True, 5)], None),
    ],
)
def test_a_slot_is_reached_from_when_the_vehicle_stays_in_it(
    runs: list[tuple[bool, int]], expected_s: float | None
) -> None:
    assert settled_s(in_slot(*runs)) == expected_s


@pytest.mark.parametrize(
    ("places_m", "expected_s"),
    [
        ([0.0] * 50, 10.0),  # rests from the beginning
        ([0.0] * 10 + [4.0] * 40, 11.0),
        ([0.0] * 10 + [3.95] * 5 + [4.0] * 35, 11.0),  # the rest of the way is no longer seen
        ([0.1 * k for k in range(50)], 10.0),  # moves to the end, as on a circle
        ([0.0] * 40 + [4.0] * 10, 10.0),  # reached its place too late for any vehicle to reach its own
    ],
)
def test_vehicles_arrive_with_a_reference_that_comes_to_rest(places_m: list[float], expected_s: float) -> None:
    reference_enu_m = np.array([(x, 0.0, 2.0) for x in places_m])
    times_s = 10.0 + 0.1 * np.arange(len(places_m))
    assert reference_rests_from_s(reference_enu_m, times_s) == pytest.approx(expected_s)


def refusal(vehicle_id: int) -> Refusal:
    return Refusal(time_s=10.0, vehicle=vehicle_id, command="form", code=Code.PATH_TOO_CLOSE, reason="")


def test_fates_compare_with_the_undisturbed_flight() -> None:
    outcome = FlightOutcome(
        seed=1,
        number=3,
        family="joining",
        arrivals=SlotArrivals(
            expected=9,
            not_in_formation=[1, 2],
            reached_s={3: 9.0, 4: 9.1, 5: None, 6: 30.0, 7: 2.0, 8: None, 9: 5.0},
        ),
        undisturbed_s={1: 1.0, 2: 1.0, 3: 4.0, 4: 4.0, 5: 4.0, 6: None, 7: 1.0, 8: None, 9: 0.9},
        refusals=[refusal(2), refusal(7)],
    )
    assert dict(zip([1, 2, 3, 4, 5, 6, 7, 8, 9], fates(outcome), strict=True)) == {
        1: Fate("left", False),
        2: Fate("refused", None),
        3: Fate("reached", True),
        4: Fate("reached", False),  # more than twice as long, plus 1 s
        5: Fate("not reached", False),
        6: Fate("reached", None),  # not reached undisturbed either
        7: Fate("reached", None),  # after a refusal
        8: Fate("not reached", None),
        9: Fate("reached", None),  # undisturbed it was in its slot all the time
    }
    summary = summarize([outcome])[-1]
    assert (summary.expected, summary.reached, summary.refused, summary.left) == (9, 5, 1, 1)
    assert (summary.timed, summary.in_time) == (4, 1)
