"""Waiting in tests of the live page. Its Content-Security-Policy forbids eval, which Playwright's own wait needs."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Page

PATIENCE_S = 30.0
STEP_MS = 50


def until(page: Page, condition: str | Callable[[], object]) -> None:
    """Until an expression in the page, or a function here, is true. The page goes on meanwhile."""
    end_s = time.monotonic() + PATIENCE_S
    while not (page.evaluate(condition) if isinstance(condition, str) else condition()):
        assert time.monotonic() < end_s, condition
        page.wait_for_timeout(STEP_MS)
