"""The offset and rate between two clocks by messages in both directions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.recording.alignment import ClockLine, fit_line

FLIGHT_S, PERIOD_S = 600.0, 0.1


class Clocks:
    """Two clocks, and the delays of messages between them: at least `least_s`, with an exponential rest of `jitter_s`."""

    def __init__(self, offset_s: float, rate: float, seed: int = 1, jitter_s: float = 0.01) -> None:
        self.offset_s, self.rate, self.jitter_s = offset_s, rate, jitter_s
        self._random = np.random.default_rng(seed)

    def b_of(self, a_s: np.ndarray) -> np.ndarray:
        return a_s + self.offset_s + self.rate * a_s

    def fitted(self, least_ab_s: float, least_ba_s: float) -> ClockLine:
        sent_s = np.arange(0.0, FLIGHT_S, PERIOD_S)
        to_b_s = sent_s + least_ab_s + self._random.exponential(self.jitter_s, len(sent_s))
        to_a_s = sent_s + least_ba_s + self._random.exponential(self.jitter_s, len(sent_s))
        line = fit_line(sent_s, self.b_of(to_b_s), self.b_of(sent_s), to_a_s)
        assert line is not None
        return line

    def error_s(self, line: ClockLine, a_s: float) -> float:
        truth_s = self.offset_s + self.rate * a_s
        return line.offset_s + line.rate * (a_s - line.at_s) - truth_s


@given(st.floats(-1e6, 1e6), st.floats(-50e-6, 50e-6), st.integers(0, 1000))
def test_offset_and_rate_of_drifting_clocks(offset_s: float, rate: float, seed: int) -> None:
    clocks = Clocks(offset_s, rate, seed)
    line = clocks.fitted(0.002, 0.002)
    assert line.rate == pytest.approx(rate, abs=5e-6)
    for a_s in (0.0, 300.0, 600.0):
        assert abs(clocks.error_s(line, a_s)) < 0.002


def test_an_asymmetric_delay_is_an_error_of_half_of_it() -> None:
    clocks = Clocks(5.0, 20e-6)
    line = clocks.fitted(0.020, 0.004)
    assert clocks.error_s(line, 300.0) == pytest.approx(0.008, abs=0.001)
    assert abs(clocks.error_s(line, 300.0)) <= line.width_s / 2.0


def test_one_early_message_does_not_decide() -> None:
    """A sender's wrong time would make the shortest delay negative."""
    clocks = Clocks(5.0, 0.0)
    sent_s = np.arange(0.0, FLIGHT_S, PERIOD_S)
    sent_wrong_s = sent_s.copy()
    sent_wrong_s[1000] += 3.0
    line = fit_line(sent_wrong_s, clocks.b_of(sent_s + 0.003), clocks.b_of(sent_s), sent_s + 0.003)
    assert line is not None
    assert abs(clocks.error_s(line, 300.0)) < 1e-6


def test_messages_in_one_direction_are_not_enough() -> None:
    some, none = np.array([1.0, 2.0]), np.array([])
    assert fit_line(some, some, none, none) is None
    assert fit_line(none, none, some, some) is None


def test_a_single_message_each_way_gives_an_offset() -> None:
    line = fit_line(np.array([10.0]), np.array([110.003]), np.array([110.1]), np.array([10.103]))
    assert line is not None
    assert line.offset_s == pytest.approx(100.0, abs=1e-4)
    assert abs(line.rate) < 1e-3
