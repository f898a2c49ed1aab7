"""Progress of a long computation, on a terminal and elsewhere."""

import io

import pytest

from sitl.report.progress import ShareProgress

HIDE_CURSOR = "\x1b[?25l"
ONE_UP_AND_ERASE = "\x1b[1A\x1b[2K"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class ClosedPipe(io.StringIO):
    def write(self, _text: str) -> int:
        raise BrokenPipeError


@pytest.fixture(autouse=True)
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Its last item is the current time."""
    times_s = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: times_s[-1])
    return times_s


def test_share_done_and_times_are_shown_and_removed_from_a_terminal(clock: list[float]) -> None:
    screen = Terminal()
    with ShareProgress(False, screen) as progress:
        progress.begin("flying")
        clock.append(140.0)
        progress.show(0.25, "50 of 240 flights")
    assert screen.getvalue().startswith(HIDE_CURSOR + "flying  25%   50 of 240 flights   40 s")
    assert screen.getvalue().endswith(ONE_UP_AND_ERASE)


def test_a_terminal_is_refreshed_in_place_five_times_a_second(clock: list[float]) -> None:
    screen = Terminal()
    with ShareProgress(False, screen) as progress:
        for share in range(1, 101):
            clock.append(clock[-1] + 0.0625)
            progress.show(share / 100)
    shown = [text for text in screen.getvalue().split("\x1b[2K") if "%" in text]
    assert len(shown) == 25 + 1  # the last one again at the end
    assert screen.getvalue().count("\n") == 1


def test_a_line_is_printed_after_two_seconds_and_then_every_ten_without_a_terminal(clock: list[float]) -> None:
    out = io.StringIO()
    with ShareProgress(False, out) as progress:
        progress.begin("flying")
        for share in range(101):
            clock.append(100.0 + 0.35 * share)
            progress.show(share / 100)
    lines = out.getvalue().splitlines()
    assert lines[0] == "flying   6%   2 s"
    assert lines[1].startswith("flying  35%   12 s, ")
    assert len(lines) == 4


def test_the_time_left_is_known_after_five_seconds_of_work_and_does_not_count_the_start(clock: list[float]) -> None:
    """Workers need 8 s here before they work, then 1 % a second."""
    out = io.StringIO()
    with ShareProgress(False, out) as progress:
        progress.begin("flying")
        for second in range(61):
            clock.append(100.0 + second)
            progress.show(max(0.0, (second - 8) / 100))
    left = [line.rpartition(", ")[2] for line in out.getvalue().splitlines() if "left" in line]
    assert out.getvalue().splitlines()[:2] == ["flying   0%   2 s", "flying   4%   12 s"]
    assert left == ["86 s left", "76 s left", "66 s left", "56 s left"]


def test_what_is_over_within_two_seconds_prints_no_line_without_a_terminal(clock: list[float]) -> None:
    out = io.StringIO()
    with ShareProgress(False, out) as progress:
        clock.append(101.9)
        progress.show(0.9)
    assert out.getvalue() == ""


def test_quiet_shows_nothing() -> None:
    screen = Terminal()
    with ShareProgress(True, screen) as progress:
        progress.show(0.5)
    assert screen.getvalue() == ""


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_closed_pipe_does_not_stop_the_computation(is_terminal: bool, clock: list[float]) -> None:
    closed = ClosedPipe()
    closed.isatty = lambda: is_terminal  # type: ignore[method-assign]
    with ShareProgress(False, closed) as progress:
        for _ in range(3):
            clock.append(clock[-1] + 20.0)
            progress.show(0.5)
