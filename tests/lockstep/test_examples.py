"""The example laws of config/examples and the one in docs/your-own-law.md pass their check, and fly."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from common import ROOT
from companion.tools.laws import check_file
from sitl.api import fly
from tests.helpers.bad_laws import write_law

LAWS = sorted((ROOT / "config" / "examples").glob("*.py"))
PAGE = ROOT / "docs" / "your-own-law.md"
LONGEST_LINES = 40


def check_and_fly(path: Path) -> float:
    """Final error of the platoon, m."""
    findings = check_file(path)
    assert all(finding.passed for finding in findings), findings
    flight = fly("platoon", law=str(path), overrides={"timeline[3].for_s": 10, "stand_in.sensors": "ideal"})
    assert flight.summary.failure is None
    return flight.summary.final_error_m


@pytest.mark.parametrize("path", LAWS, ids=[path.stem for path in LAWS])
def test_an_example_flies(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= LONGEST_LINES
    assert check_and_fly(path) < 0.6


def test_the_law_in_the_page_flies(tmp_path: Path) -> None:
    (source,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert check_and_fly(write_law(tmp_path, "mine", source)) < 0.5
