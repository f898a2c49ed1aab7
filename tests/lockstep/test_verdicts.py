"""What `companion analyze` says is what flies: settings of every law with links of 0.1 s. `make verdicts` has many more."""

from __future__ import annotations

import pytest

from tests.bench.verdicts import APART_M, RATIO, SEED, Verdict, judge

FLOWN_S = 12.0
ACCEPTED = [6, 42]  # cooperative on PX4; weighted with much feed-forward and high gains on ArduPilot
REFUSED = [61]  # weighted with high gains on PX4
MORE = [1, 7, 11, 23, 29, 44, 57, 63]


@pytest.mark.parametrize("number", ACCEPTED)
def test_an_accepted_setting_flies_as_predicted(number: int) -> None:
    as_said(judge(SEED, number, FLOWN_S))


@pytest.mark.long
@pytest.mark.parametrize("number", MORE)
def test_more_accepted_settings_fly_as_predicted(number: int) -> None:
    as_said(judge(SEED, number))


def as_said(verdict: Verdict) -> None:
    assert verdict.accepted
    assert verdict.flies_well
    assert verdict.ratio <= RATIO
    assert verdict.apart_m <= APART_M


@pytest.mark.parametrize("number", REFUSED)
def test_a_refused_setting_does_not_settle(number: int) -> None:
    verdict = judge(SEED, number, FLOWN_S)
    assert not verdict.accepted
    assert verdict.flown_settle_s is None
