"""The position error that is assumed when GPS or external vision is lost."""

from __future__ import annotations

from math import nan

import pytest

from companion.core.estimation.accuracy import PositionAccuracy
from companion.types.autopilot import EstimatorSample, PositionAid, PositionError

A = PositionAid
GOOD = PositionError(0.3, 0.5)
FIXED = EstimatorSample(0.0, 0.3, 0.5, aid=A.FIX)
AIDED = EstimatorSample(0.0, 0.3, 0.5, aid=A.USED)
LOST = [
    (FIXED, EstimatorSample(0.2, 0.3, 0.5, aid=A.NO_FIX)),  # the last accuracy goes on
    (FIXED, EstimatorSample(0.2, nan, nan, aid=A.NO_FIX)),
    (FIXED, EstimatorSample(0.2, 4_294_967.295, 4_294_967.295, aid=A.NO_FIX)),  # u-blox without a fix
    (FIXED, EstimatorSample(0.2, nan, nan, aid=A.FIX)),
    (AIDED, EstimatorSample(0.2, 0.3, 0.5, aid=A.NOT_USED)),
    (EstimatorSample(0.0, 0.3, 0.5), EstimatorSample(0.2, 0.3, nan)),
]


@pytest.mark.parametrize(("before", "lost"), LOST)
def test_a_loss_shows_at_once_and_the_error_grows_until_it_is_back(
    before: EstimatorSample, lost: EstimatorSample
) -> None:
    accuracy = PositionAccuracy(uses_gps=True)
    accuracy.receive(before)
    assert accuracy.at(0.1) == (GOOD, False)
    accuracy.receive(lost)
    errors = []
    for now_s in (0.2, 1.0, 3.0, 10.0, 1e6):
        error, unaided = accuracy.at(now_s)
        assert unaided and error
        errors.append((error.horizontal_m, error.vertical_m))
    assert errors == sorted(errors) and errors[0] >= (0.3, 0.5)
    assert 0.5 < errors[2][0] < 1.2 and 2.0 < errors[3][0] < 6.6  # measured: 0.6 m and 1.3 to 6.6 m of drift
    assert errors[-1][0] <= 1_000.0
    accuracy.receive(before)
    assert accuracy.at(0.1) == (GOOD, False)


def test_a_larger_error_that_the_estimator_reports_meanwhile_counts() -> None:
    accuracy = PositionAccuracy(uses_gps=True)
    accuracy.receive(AIDED)
    accuracy.receive(EstimatorSample(3.0, 7.0, 0.5, aid=A.NOT_USED))
    error, _ = accuracy.at(3.0)
    assert error and error.horizontal_m == 7.0


@pytest.mark.parametrize("sample", [EstimatorSample(0.0, nan, nan, aid=A.NO_FIX), EstimatorSample(0.0, nan, nan)])
def test_what_was_never_there_is_not_lost(sample: EstimatorSample) -> None:
    accuracy = PositionAccuracy(uses_gps=True)
    accuracy.receive(sample)
    assert accuracy.at(100.0) == (None, False)


def test_a_fix_does_not_count_where_the_position_comes_from_external_vision() -> None:
    accuracy = PositionAccuracy(uses_gps=False)
    accuracy.receive(FIXED)
    accuracy.receive(EstimatorSample(0.2, 0.3, 0.5, aid=A.NO_FIX))
    assert accuracy.at(0.2) == (GOOD, False)
