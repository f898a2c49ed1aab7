"""A lost server, late data, hostile texts: what must never look live, and never run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from companion.monitor.api import FlagView, VehicleView
from page_server import PageServer, until_shown

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is missing").expect
expect.set_options(timeout=20_000)

if TYPE_CHECKING:
    from conftest import OpenPage
    from playwright.sync_api import Browser

HOSTILE = '<img src=x onerror="globalThis.harmed = 1"><script>globalThis.harmed = 1</script>${globalThis.harmed = 1}'

SCRIPT_ELEMENT = """() => {
    const script = document.createElement('script');
    script.textContent = 'harmed = 1';
    document.body.append(script);
}"""


def test_a_lost_server_is_shown_at_once_and_control_ends(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        expect(page.locator(".live")).to_have_text("LIVE")
        expect(page.locator("[data-action=hold]")).to_be_enabled()
        server.stop()
        banner = page.locator("#banner .lost-server")
        expect(banner).to_contain_text("Server lost: everything below is")
        expect(page.locator(".live")).to_have_text("LOST")
        expect(page.locator("[data-action=hold]")).to_be_disabled()
        expect(page.locator("#abort")).to_be_enabled()
        assert page.evaluate("getComputedStyle(document.getElementById('map')).filter").startswith("grayscale(1)")
        box = banner.bounding_box()
        assert box
        assert box["width"] == 1440
        before = banner.inner_text()
        until_shown(page, lambda: banner.inner_text() != before)  # the age counts up


def test_a_server_that_only_stops_sending_is_lost_too(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        server.paused = True
        expect(page.locator("#banner .lost-server")).to_be_visible()
        server.paused = False
        expect(page.locator("#banner .lost-server")).to_have_count(0)
        expect(page.locator(".live")).to_have_text("LIVE")


def test_a_client_that_misses_snapshots_asks_for_the_history_now_and_then(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        server.skipped = 1
        page.wait_for_timeout(2000)  # twenty snapshots
        assert 1 <= server.histories <= 2


def test_the_page_returns_with_the_server(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        server.stop()
        expect(page.locator(".live")).to_have_text("LOST")
        with PageServer(port=server.port):
            expect(page.locator(".live")).to_have_text("LIVE")


def test_a_page_without_a_place_says_so_until_it_gets_one(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        server.stop()
        banner = page.locator("#banner .refused")
        with PageServer(port=server.port) as full:
            full.no_place = f"8 live connections are open already; {HOSTILE}"
            expect(banner).to_contain_text("This page gets no data: 8 live connections are open already; <img src=x")
            expect(banner).to_contain_text("Everything below is")
            full.no_place = ""
            expect(page.locator(".live")).to_have_text("LIVE")
            expect(banner).to_have_count(0)
        expect(page.locator("#banner .lost-server")).to_contain_text("Server lost")


def test_a_new_page_without_a_place_says_so(browser: Browser) -> None:
    with PageServer() as server:
        server.no_place = "8 live connections are open already"
        page = browser.new_page()
        page.goto(server.url)
        expect(page.locator("#banner .refused")).to_have_text(
            "This page gets no data: 8 live connections are open already. It tries again by itself."
        )
        page.close()


@pytest.mark.parametrize("token", ["a-token-of-this-test", "no%20token,%22\u00e4"])
def test_a_page_with_a_token_opens_although_a_proxy_drops_subprotocols(open_page: OpenPage, token: str) -> None:
    with PageServer() as server:
        server.drops_protocols = True
        page = open_page(f"{server.url}#token={token}")
        expect(page.locator(".live")).to_have_text("LIVE")


def test_snapshots_that_arrive_late_are_not_live(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        expect(page.locator(".live")).to_have_text("LIVE")
        server.delayed_by = 20  # snapshots: two seconds
        expect(page.locator("#banner .lost-server")).to_contain_text("Data arrives late")


def test_abort_is_tried_although_snapshots_are_missing(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        server.paused = True
        expect(page.locator(".live")).to_have_text("LOST")
        page.keyboard.down("Shift")
        page.keyboard.down("Escape")
        until_shown(page, lambda: [command.name for command in server.commands] == ["abort"])
        page.keyboard.up("Escape")
        page.keyboard.up("Shift")


def test_foreign_texts_are_shown_and_never_run(open_page: OpenPage) -> None:
    def hostile(vehicles: list[VehicleView]) -> list[VehicleView]:
        flag = FlagView(HOSTILE, "critical", HOSTILE, HOSTILE, HOSTILE)
        texts = {"phase": HOSTILE, "mode": HOSTILE, "formation": HOSTILE, "holder": HOSTILE, "last_event": HOSTILE}
        return [replace(v, flags=(flag,), lacks=(HOSTILE,), refuses_return=HOSTILE, **texts) for v in vehicles]

    with PageServer(may_control=True) as server:
        server.change = hostile
        server.alarm(1, HOSTILE, text=HOSTILE)
        server.refuse = {1: HOSTILE}
        server.event(HOSTILE, HOSTILE, 1)
        page = open_page(server.control_url)
        page.locator("tbody.vehicle[data-id='1'] button").click()
        page.locator("[data-action=hold]").click()
        expect(page.locator(".answer li").first).to_contain_text("<script>")
        for panel in ("#vehicles", "#details", "#alarms", "#events"):
            expect(page.locator(panel)).to_contain_text("<img src=x")
        assert page.evaluate("globalThis.harmed ?? null") is None
        assert page.locator("main img, main script").count() == 0


def test_an_inline_script_would_be_stopped(browser: Browser) -> None:
    """Also one that came through as an element; the test above shows that none does."""
    with PageServer() as server:
        page = browser.new_page()
        page.goto(server.url)
        refusals: list[str] = []
        page.on("console", lambda message: refusals.append(message.text))
        page.evaluate(SCRIPT_ELEMENT)
        until_shown(page, lambda: any("Content Security Policy" in text for text in refusals))
        assert page.evaluate("globalThis.harmed ?? null") is None
        page.close()
