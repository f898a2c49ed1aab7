"""Computations in processes of their own, and what a long one says of itself."""

import io
import os
from collections.abc import Iterator

import pytest

from sitl.share import share_shown
from sitl.workers import in_processes


def square(x: int) -> int:
    return x * x


def own_process(_job: int) -> int:
    return os.getpid()


def fail(job: int) -> int:
    raise ValueError(f"job {job}")


def test_results_come_with_their_places() -> None:
    assert dict(in_processes(square, [3, 4, 5])) == {0: 9, 1: 16, 2: 25}


def test_nothing_to_do() -> None:
    assert list(in_processes(square, [])) == []


def test_they_are_other_processes_and_end_with_the_listening() -> None:
    results: Iterator[tuple[int, int]] = in_processes(own_process, list(range(20)))
    _, pid = next(results)
    assert pid != os.getpid()
    results.close()  # type: ignore[attr-defined]
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_an_error_comes_out() -> None:
    with pytest.raises(ValueError, match="job 7"):
        list(in_processes(fail, [7]))


def test_a_line_for_each_tenth_where_there_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.StringIO()
    monkeypatch.setattr("sys.stderr", out)
    with share_shown("flying", quiet=False) as show:
        for k in range(101):
            show(k / 100)
    lines = out.getvalue().splitlines()
    assert lines[0] == "flying: 0 %"
    assert 10 <= len(lines) <= 12


def test_quiet_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with share_shown("flying", quiet=True) as show:
        show(0.5)
    assert capsys.readouterr() == ("", "")
