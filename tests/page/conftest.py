"""A headless Chromium and the live page in it. Skipped where one is missing; `make test-page` ends before that."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from page_server import until_shown

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

CHROMIUM = Path(os.environ.get("CHROMIUM", "/usr/bin/chromium"))
ARGUMENTS = [
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--autoplay-policy=user-gesture-required"),
]
PATIENCE_MS = 20_000
# No map tiles; a server that a test has stopped; a test that reads pixels.
EXPECTED = ("Failed to load resource", "WebSocket connection to", "Canvas2D: Multiple readback operations")

OpenPage = Callable[..., "Page"]


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is missing: pip install playwright")
    if not CHROMIUM.exists():
        pytest.skip(f"{CHROMIUM} is missing: apt install chromium")
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=str(CHROMIUM), args=ARGUMENTS)
        yield chromium
        chromium.close()


@pytest.fixture
def open_page(browser: Browser) -> Iterator[OpenPage]:
    """Opens a URL in a context of its own and waits for the first snapshot. Unexpected console messages fail the test."""
    messages: list[str] = []
    contexts = []

    def listen(page: Page) -> None:
        page.on("pageerror", lambda error: messages.append(str(error)))
        page.on("console", lambda m: messages.append(m.text) if m.type in ("error", "warning") else None)

    def open_(url: str, width: int = 1440, height: int = 900, **options: Any) -> Page:
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        context.set_default_timeout(PATIENCE_MS)
        contexts.append(context)
        page = context.new_page()
        listen(page)
        page.goto(url)
        until_shown(page, "globalThis.companionMetrics?.count > 0")
        return page

    yield open_
    for context in contexts:
        context.close()
    assert [text for text in messages if not text.startswith(EXPECTED)] == []
