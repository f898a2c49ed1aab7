"""Survey of the telemetry on the bench: messages and rates."""

from __future__ import annotations

import pytest

from companion.core.preflight import WINDOW_S, Survey
from companion.types.autopilot import LandedSample, LandedState, PositionSample, SystemSample, TextSample

POSITION = PositionSample(0.0, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_rates_are_of_the_last_complete_window() -> None:
    survey = Survey()
    survey.update(10.0, [POSITION] * 500)  # what had piled up before
    survey.update(11.0, [POSITION] * 60)
    assert survey.rates_hz is None
    survey.update(10.0 + WINDOW_S, [POSITION] * 40 + [LandedSample(12.0, LandedState.ON_GROUND)] * 4)
    assert survey.rates_hz == {"positions": 50.0, "attitudes": 0.0, "modes": 0.0, "landed states": 2.0}
    survey.update(13.0, [POSITION] * 50)
    assert survey.rates_hz["positions"] == 50.0
    survey.update(14.5, ())  # a wake that came late counts by its own length
    assert survey.rates_hz["positions"] == pytest.approx(20.0)


def test_it_is_told_whether_what_is_found_has_changed() -> None:
    survey = Survey()
    assert not survey.update(10.0, [POSITION])
    assert survey.update(10.1, [SystemSample(10.1, 80.0, may_arm=True)])
    assert not survey.update(10.2, [SystemSample(10.2, 80.0, may_arm=True), POSITION])
    assert survey.update(10.3, [SystemSample(10.3, 79.0, may_arm=True)])
    assert not survey.update(10.4, [TextSample(10.4, 6, "all is well")])
    assert survey.update(10.5, [TextSample(10.5, 4, "Preflight Fail: no GPS")])
    assert survey.update(10.0 + WINDOW_S, [])  # the first rates
    assert not survey.update(10.1 + WINDOW_S, [POSITION])


def test_failed_arming_checks_are_named() -> None:
    survey = Survey()
    assert survey.failing_checks is None
    survey.update(0.0, [])
    survey.update(0.1, [SystemSample(0.1, 80.0, may_arm=False)])
    assert (survey.battery_percent, survey.failing_checks) == (80.0, "the autopilot's preflight checks do not pass")
    survey.update(0.2, [TextSample(0.2, 6, "all is well"), TextSample(0.2, 4, "Preflight Fail: no GPS")])
    assert survey.failing_checks == "Preflight Fail: no GPS"
    survey.update(0.3, [SystemSample(0.3, 79.0, may_arm=True)])
    assert survey.failing_checks == ""
