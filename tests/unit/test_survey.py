"""What came on the bench, and how often."""

from __future__ import annotations

import pytest

from companion.core.survey import WINDOW_S, Survey
from companion.types import LandedSample, LandedState, PositionSample, SystemSample, TextSample

POSITION = PositionSample(0.0, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_rates_are_those_of_the_last_whole_window() -> None:
    survey = Survey()
    survey.hear(10.0, [POSITION] * 500)  # what had piled up before
    survey.hear(11.0, [POSITION] * 60)
    assert survey.rates_hz is None
    survey.hear(10.0 + WINDOW_S, [POSITION] * 40 + [LandedSample(12.0, LandedState.ON_GROUND)] * 4)
    assert survey.rates_hz == {"positions": 50.0, "attitudes": 0.0, "modes": 0.0, "landed states": 2.0}
    survey.hear(13.0, [POSITION] * 50)
    assert survey.rates_hz["positions"] == 50.0
    survey.hear(14.5, ())  # a wake that came late counts by its own length
    assert survey.rates_hz["positions"] == pytest.approx(20.0)


def test_what_the_autopilots_checks_lack() -> None:
    survey = Survey()
    assert survey.checks_lack is None
    survey.hear(0.0, [])
    survey.hear(0.1, [SystemSample(0.1, 80.0, may_arm=False)])
    assert (survey.battery_percent, survey.checks_lack) == (80.0, "its checks before arming do not pass")
    survey.hear(0.2, [TextSample(0.2, 6, "all is well"), TextSample(0.2, 4, "Preflight Fail: no GPS")])
    assert survey.checks_lack == "Preflight Fail: no GPS"
    survey.hear(0.3, [SystemSample(0.3, 79.0, may_arm=True)])
    assert survey.checks_lack == ""
