"""Themes, widths, keyboard and names: that every operator can read and operate the page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from companion.types.vehicle_looks import COLOURS
from page_server import PageServer, until_shown

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is missing").expect
expect.set_options(timeout=20_000)

if TYPE_CHECKING:
    from conftest import OpenPage
    from playwright.sync_api import Page

SIZES = [(1440, 900), (1024, 768), (768, 1024), (390, 844), (844, 390)]
TABS = ("Vehicles", "Alarms", "Control", "Plots", "Events")
LONG = "an event with a very long text, " * 8


def test_the_theme_follows_the_system_and_is_remembered(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url, color_scheme="dark")
        theme = "document.documentElement.dataset.theme"
        assert page.evaluate(theme) == "dark"
        assert_in_their_colours(page, [colour.on_dark for colour in COLOURS])
        page.get_by_role("button", name="Theme: system").click()
        assert page.evaluate(theme) == "light"
        assert_in_their_colours(page, [colour.on_light for colour in COLOURS])
        page.reload()
        until_shown(page, "globalThis.companionMetrics?.count > 0")
        expect(page.get_by_role("button", name="Theme: light")).to_be_visible()
        assert page.evaluate(theme) == "light"
        page.emulate_media(color_scheme="light")
        page.get_by_role("button", name="Theme: light").click()
        assert page.evaluate(theme) == "dark"


def assert_in_their_colours(page: Page, colours: list[str]) -> None:
    """Symbols of the list and lines of the plots, of the first four vehicles."""
    for n, colour in enumerate(colours[:4]):
        red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
        symbol = page.locator(f"tbody.vehicle[data-id='{n + 1}'] .symbol path")
        expect(symbol).to_have_css("stroke", f"rgb({red}, {green}, {blue})")
        expect(page.locator(".plot-key line").nth(n)).to_have_attribute("stroke", colour)


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_every_panel_fits_the_width(open_page: OpenPage, width: int, height: int) -> None:
    with PageServer(may_control=True) as server:
        server.change = lambda vs: [replace(v, silent=v.vehicle_id == 4, last_event=LONG, mode=LONG) for v in vs]
        server.alarm(4, "SILENT", text=LONG)
        server.event("PHASE_CHANGED", LONG, 1)
        page = open_page(server.control_url, width=width, height=height)
        page.locator("tbody.vehicle[data-id='1'] button").click()
        expect(page.locator("#details h2")).to_be_visible()
        assert_fits(page, width)
        if page.locator("#tabs").is_visible():
            for name in TABS:
                page.locator("#tabs").get_by_role("button", name=name).click()
                assert_fits(page, width)
        expect(page.locator("#abort")).to_be_in_viewport()


def assert_fits(page: Page, width: int) -> None:
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    wide = """[...document.querySelectorAll('main section, main section *, header *')].filter((e) => {
        const box = e.getBoundingClientRect();
        return box.width && box.right > innerWidth + 1 && !e.closest('.unseen, svg, canvas, .u-wrap');
    }).map((e) => e.tagName + '.' + e.className)"""
    assert page.evaluate(wide) == []


def test_the_keyboard_alone_selects_a_vehicle_with_visible_focus(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        page.keyboard.press("Tab")
        expect(page.get_by_role("link", name="Skip to the vehicles")).to_be_focused()
        page.keyboard.press("Enter")
        for _ in range(3):
            page.keyboard.press("Tab")
            if page.evaluate("document.activeElement.closest('tbody.vehicle') !== null"):
                break
        assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
        page.keyboard.press("Enter")
        expect(page.locator("#details h2")).to_have_text("Vehicle 1, leader")


def test_the_keyboard_comes_to_the_commands_by_one_link(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url, 390, 844)
        for _ in range(2):
            page.keyboard.press("Tab")
        expect(page.get_by_role("link", name="Skip to the commands")).to_be_focused()
        page.keyboard.press("Enter")
        page.keyboard.press("Tab")
        page.keyboard.press("Tab")
        expect(page.locator("button[data-action='doctor']")).to_be_focused()


def test_everything_that_can_be_operated_has_a_name(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        server.alarm(4, "SILENT")
        page = open_page(server.control_url)
        for form in page.locator("details.form summary").all():
            form.click()
        nameless = """[...document.querySelectorAll('button, input, select, #scene, section')].filter((e) =>
            !(e.getAttribute('aria-label') || e.textContent.trim() || e.labels?.length)).map((e) => e.outerHTML)"""
        assert page.evaluate(nameless) == []


def test_sound_is_off_until_it_is_switched_on(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        button = page.get_by_role("button", name="Sound")
        expect(button).to_have_attribute("aria-pressed", "false")
        count = "globalThis.tones = 0; const start = OscillatorNode.prototype.start;"
        page.evaluate(
            count + "OscillatorNode.prototype.start = function (at) { tones += 1; return start.call(this, at); }; 0"
        )
        server.alarm(3, "SILENT")
        expect(page.locator("#alarms li")).to_have_count(1)
        assert page.evaluate("tones") == 0
        button.click()
        expect(button).to_have_attribute("aria-pressed", "true")
        until_shown(page, "tones >= 2")  # one to show that it works, then the alarm that is not acknowledged


def test_the_help_explains_the_abort_key(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        page.get_by_role("button", name="Help").click()
        expect(page.locator("#help")).to_contain_text("both held for half a second: ABORT")
        page.get_by_role("button", name="Close").click()
        expect(page.locator("#help")).to_be_hidden()


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1440, 900)])
def test_phase_and_whether_it_is_armed_are_not_cut_off(open_page: OpenPage, width: int, height: int) -> None:
    with PageServer() as server:
        server.change = lambda vehicles: [
            replace(vehicle, mode="AUTO.LOITER", armed=False, silent=vehicle.vehicle_id == 2) for vehicle in vehicles
        ]
        page = open_page(server.url, width=width, height=height)
        expect(page.locator("[data-id='2']")).to_contain_text("SILENT")
        cut_off = """() => [...document.querySelectorAll(".fleet thead th, .fleet tr:not(.note) td:is(:nth-child(2), .mode)")]
            .filter((cell) => cell.checkVisibility() && cell.scrollWidth > cell.clientWidth).map((cell) => cell.innerText)"""
        assert page.evaluate(cut_off) == []
