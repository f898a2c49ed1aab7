"""The next number that all vehicles accept, whatever numbers they report."""

from __future__ import annotations

from random import Random

import pytest

from companion.types.commands import EPOCHS_AHEAD, NUMBERS_AHEAD, is_newer, next_epoch, next_for_all


@pytest.mark.parametrize(
    ("reported", "expected"),
    [
        ((), 1),
        ((0, 0, 0), 1),
        ((7, 3, 7), 8),  # one vehicle missed some changes
        ((999, 0, 0), 1000),
        ((1000, 0, 0), 1),  # a wrong number
        ((2**62, 7, 7), 8),
        ((1500, 1500, 0), 1),  # a vehicle that has restarted
        ((1000, 999, 0), 998),
        ((1008, 7), 8),
    ],
)
def test_the_next_number_is_above_all_but_those_too_far_ahead(reported: tuple[int, ...], expected: int) -> None:
    assert next_for_all(reported) == expected


@pytest.mark.parametrize(("reported", "expected"), [((56, 0, 0), 57), ((1008, 0, 0), 1), ((1000, 999, 0), 990)])
def test_the_next_epoch_is_far_enough_below_a_wrong_one(reported: tuple[int, ...], expected: int) -> None:
    assert next_epoch(reported) == expected


def test_all_vehicles_accept_the_next_number_and_epoch() -> None:
    rng = Random(0)
    for _ in range(2000):
        reported = [rng.choice((0, 5, 900, 1000, 10**6)) + rng.randrange(120) for _ in range(rng.randrange(1, 50))]
        number, epoch = next_for_all(reported), next_epoch(reported)
        for own in reported:
            assert number != own
            assert number <= own + NUMBERS_AHEAD
            assert own < epoch <= own + NUMBERS_AHEAD or own - epoch > EPOCHS_AHEAD


def test_a_number_too_far_above_another_is_not_newer() -> None:
    assert is_newer(8, 7)
    assert not is_newer(7, 7)
    assert not is_newer(7 + NUMBERS_AHEAD + 1, 7)
