"""What a long computation says of itself."""

import io

import pytest

from sitl.share import ShareProgress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class ClosedPipe(io.StringIO):
    def write(self, _text: str) -> int:
        raise BrokenPipeError


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Its last item is now."""
    times_s = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: times_s[-1])
    return times_s


def test_share_what_is_done_how_long_it_took_and_will_take(clock: list[float]) -> None:
    screen = Terminal()
    with ShareProgress(False, screen) as progress:
        clock.append(110.0)
        progress.begin("flying")
        clock.append(140.0)
        progress.show(0.25, "50 of 240 flights")
    assert screen.getvalue() == "flying  25%   50 of 240 flights   40 s, 90 s left\n\x1b[1F\x1b[J"


def test_in_place_on_a_terminal_and_not_too_often(clock: list[float]) -> None:
    screen = Terminal()
    progress = ShareProgress(False, screen)
    for share in range(1, 101):
        clock.append(clock[-1] + 0.0625)
        progress.show(share / 100)
    assert screen.getvalue().count("left\n") == 25
    assert screen.getvalue().count("\x1b[1F\x1b[J") == 24


def test_a_line_every_ten_seconds_where_there_is_no_terminal(clock: list[float]) -> None:
    out = io.StringIO()
    with ShareProgress(False, out) as progress:
        progress.begin("flying")
        for share in range(101):
            clock.append(100.0 + 0.35 * share)
            progress.show(share / 100)
    lines = out.getvalue().splitlines()
    assert lines[0] == "flying  29%   10 s, 25 s left"
    assert len(lines) == 3


def test_quiet_says_nothing() -> None:
    screen = Terminal()
    with ShareProgress(True, screen) as progress:
        progress.show(0.5)
    assert screen.getvalue() == ""


def test_nobody_reading_is_no_reason_to_stop() -> None:
    closed = ClosedPipe()
    closed.isatty = lambda: True  # type: ignore[method-assign]
    with ShareProgress(False, closed) as progress:
        progress.show(0.5)
        progress.show(0.6)
