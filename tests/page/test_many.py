"""A large fleet stays readable: no text of the map is on another one, and the list has every vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from companion.monitor.api import FlagView, VehicleView
from page_server import PageServer, until_shown

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is missing").expect

if TYPE_CHECKING:
    from conftest import OpenPage

SIZES = [(1440, 900), (1024, 768), (390, 844)]
CHECKS = (Path(__file__).parent / "readable.js").read_text(encoding="utf-8")
SELECTED, SILENT, FLAGGED = 6, 7, 9
LOW = FlagView("BATTERY_LOW", "warning", "battery below leave_below_percent", "hold", "land it and change its battery")
HIDDEN_ROWS = """() => [...document.querySelectorAll("tbody.vehicle tr:first-child")].map((row) => row.getBoundingClientRect())
    .filter(({ top }, i, rows) => i && top < rows[i - 1].bottom - 0.5).length"""


def in_trouble(vehicles: list[VehicleView]) -> list[VehicleView]:
    changes = {SILENT: {"silent": True, "age_s": 64.0}, FLAGGED: {"flags": (LOW,)}}
    return [replace(v, **changes.get(v.vehicle_id, {})) for v in vehicles]


@pytest.mark.parametrize("count", [12, 50])
def test_the_texts_of_a_large_fleet_are_beside_each_other(open_page: OpenPage, count: int) -> None:
    with PageServer(count) as server:
        still = in_trouble(server.vehicles(server.begin_s))
        server.change = lambda _: still
        page = open_page(server.url)
        page.evaluate(CHECKS)
        page.locator(f"tbody.vehicle[data-id='{SELECTED}']").click()
        for width, height in SIZES:
            page.set_viewport_size({"width": width, "height": height})
            page.locator("#map-tools").get_by_role("button", name="Fit").click()
            until_shown(page, "readable.onMap().some((text) => text.startsWith('SILENT 64'))")
            page.wait_for_timeout(250)
            texts = page.evaluate("readable.onMap()")
            assert {str(n) for n in range(1, count + 1)} <= set(texts)
            assert page.evaluate("readable.overlapping({ ids: true })") == []
            phases = sum(text.startswith("formation ") for text in texts)
            assert phases == 2 if count > 16 else phases > 6  # of a large fleet the selected and the flagged one
            assert page.evaluate("readable.cutOff()") == []
            assert page.evaluate(HIDDEN_ROWS) == 0


def test_a_crowd_keeps_the_texts_that_matter(open_page: OpenPage) -> None:
    with PageServer(12) as server:
        still = in_trouble(server.vehicles(server.begin_s))
        server.change = lambda _: still
        page = open_page(server.url)
        page.evaluate(CHECKS)
        page.locator(f"tbody.vehicle[data-id='{SELECTED}']").click()
        for _ in range(5):
            page.get_by_role("button", name="Zoom out").click()
            page.wait_for_timeout(150)
            texts = page.evaluate("readable.onMap()")
            assert page.evaluate("readable.overlapping({ ids: false })") == []
            assert any(text.startswith("SILENT") for text in texts)
            assert any(text.startswith("formation ") for text in texts)  # the selected one
        assert sum(text.startswith("formation ") for text in texts) < 11
