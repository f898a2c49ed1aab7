"""The live page of `companion monitor --control`, with a real simulated fleet."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from common import ROOT
from page_server import until_shown
from processes import free_fleet_offset, running

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is missing").expect

if TYPE_CHECKING:
    from conftest import OpenPage
    from playwright.sync_api import Locator, Page

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(300)]

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
HELD_MS = 1300
PATIENCE_MS = 60_000


@pytest.fixture
def fleet_file(tmp_path: Path) -> Iterator[Path]:
    """That of four vehicles on the ground."""
    offset = str(free_fleet_offset())
    with running("sitl", "fleet", str(PLATOON), "--out", str(tmp_path), "--quiet", "--port-offset", offset) as fleet:
        assert fleet.stdout
        assert fleet.stdout.readline().startswith("fleet platoon")
        yield tmp_path / "fleet.yaml"


def hold(page: Page, selector: str) -> None:
    page.locator(selector).hover()
    page.mouse.down()
    page.wait_for_timeout(HELD_MS)
    page.mouse.up()


def answered(answer: Locator, which: str) -> list[int]:
    """Vehicles with such an answer; those that say the same stand in one line."""
    texts = answer.locator(which).locator("strong:first-of-type").all_inner_texts()
    return sorted(int(i) for text in texts for i in text.split(", "))


def test_an_operator_arms_a_fleet_on_the_page_and_aborts(open_page: OpenPage, fleet_file: Path) -> None:
    monitor = ["companion", "monitor", "--control", "--fleet-file", str(fleet_file), "--listen", "127.0.0.1:0"]
    with running(*monitor) as server:
        assert server.stdout
        page = open_page(server.stdout.readline().strip())
        expect(page.locator("tbody.vehicle")).to_have_count(4, timeout=PATIENCE_MS)
        expect(page.locator("#figures")).to_contain_text("4 of 4", timeout=PATIENCE_MS)

        file = "fetch('api/v1/fleets/platoon').then((response) => response.json())"
        until_shown(
            page, lambda: page.evaluate(file)["reference_enu_m"] == [[1.0, 0.0, 1.0]]
        )  # as its leader describes it

        def all_checks_pass() -> bool:
            page.locator("[data-action=doctor]").click()
            expect(page.locator(".answer").first.locator("li")).not_to_have_count(0, timeout=PATIENCE_MS)
            return answered(page.locator(".answer").first, "li.ready, li.ready-with-warnings") == [1, 2, 3, 4]

        until_shown(page, all_checks_pass)
        hold(page, "[data-action=arm]")
        until_shown(page, lambda: answered(page.locator(".answer", has_text="arm, all"), "li.accepted") == [1, 2, 3, 4])
        expect(page.locator("tbody.vehicle tr:first-child td:nth-child(2)")).to_have_text(
            ["armed"] * 4, timeout=PATIENCE_MS
        )
        expect(page.locator("#events li.command")).to_have_count(1)

        page.keyboard.down("Shift")
        page.keyboard.down("Escape")
        until_shown(
            page, lambda: answered(page.locator(".answer", has_text="abort, all"), "li.accepted") == [1, 2, 3, 4]
        )
        page.keyboard.up("Escape")
        page.keyboard.up("Shift")
        expect(page.locator("tbody.vehicle", has_text="disarmed")).to_have_count(4, timeout=PATIENCE_MS)
    expect(page.locator("#banner .lost-server")).to_be_visible(timeout=PATIENCE_MS)
    expect(page.locator(".live")).to_have_text("LOST")
