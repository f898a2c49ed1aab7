"""`make test` never leaves a part out silently."""

from __future__ import annotations

import os
import subprocess

from common import ROOT


def make(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("MAKE")}
    return subprocess.run(
        ["make", "--no-print-directory", *arguments],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_without_chromium_the_command_that_installs_it_is_named_and_nothing_is_tested() -> None:
    for target in ("test", "test-page"):
        ended = make("-o", ".venv/test.ready", target, "CHROMIUM=/nowhere/chromium")
        assert ended.returncode != 0
        assert ended.stdout.splitlines() == [
            "The live page is tested in Chromium, and /nowhere/chromium is missing: sudo apt install chromium"
            " (or CHROMIUM=PATH); make test SKIP_PAGE=1 leaves it out"
        ]


def test_the_part_that_is_left_out_is_named_in_the_last_line() -> None:
    planned = make("-n", "-o", ".venv/test.ready", "test", "SKIP_PAGE=1", "CHROMIUM=/nowhere/chromium").stdout
    assert "tests/lockstep" in planned
    assert "pytest -q tests/page/" not in planned
    assert planned.splitlines()[-1] == "SKIPPED: the live page, tests/page (SKIP_PAGE=1)"
