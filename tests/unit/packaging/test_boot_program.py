"""The parts of `make boot` that need no container: the table, the documented lines, the program's files."""

from __future__ import annotations

import pytest

from deploy.boot.documented import PAGE, documented_lines, guide_commands, missing_lines
from deploy.boot.report import Results

LINES = """\
## Journal lines

| line | meaning |
|---|---|
| `ends in phase ...` | it ended |
| `heartbeat of autopilot 1` | it is there |

## Next

| `not a line` | other |
"""


def test_documented_lines_are_those_of_their_table() -> None:
    assert missing_lines(LINES, "INFO ends in phase hold\nheartbeat of autopilot 1, PX4\n") == []
    assert missing_lines(LINES, "INFO ends in phase hold\n") == ["heartbeat\\ of\\ autopilot\\ 1"]
    assert len(missing_lines(LINES, "")) == 2


def test_the_guide_documents_lines() -> None:
    assert len(documented_lines(PAGE.read_text(encoding="utf-8"))) >= 5


def test_the_guide_needs_fewer_than_ten_commands() -> None:
    commands = guide_commands(PAGE.read_text(encoding="utf-8"))
    assert "systemctl enable --now companion@1" in " ".join(commands)
    assert 3 <= len(commands) < 10


def test_a_time_at_its_limit_fails(capsys: pytest.CaptureFixture[str]) -> None:
    results = Results()
    results.time("kill -9 to READY", 1.5, 3.0)
    results.time("hung to restarted", 4.0, 4.0)
    assert [result.passed for result in results.all] == [True, False]
    assert results.failed == 1
    assert capsys.readouterr().out.splitlines()[1].startswith("FAIL  hung to restarted")


def test_the_page_has_every_result() -> None:
    results = Results()
    results.check("purge leaves no file", False, "/etc/a|b", "none")
    page = results.page("bookworm")
    assert "| purge leaves no file | /etc/a\\|b | none | **failed** |" in page
    assert all(len(line) <= 100 for line in page.splitlines() if not line.startswith("|"))
