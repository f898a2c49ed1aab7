"""Every text can be read, in the states of the screens of docs/monitor.md, at every width and zoom that people use.

None is cut off, its contrast is at least 4.5 in both themes, and axe-core finds nothing against WCAG 2 A and AA.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from companion.monitor.api import FlagView, LogFileView, LogsView, ReplayView, VehicleView
from page_server import PageServer, flown

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is missing").expect

if TYPE_CHECKING:
    from conftest import OpenPage
    from playwright.sync_api import Page

WIDTHS = (1920, 1440, 1024, 768, 390)
HEIGHT = 900
# At 200 % a page is laid out in half of the window.
SIZES = [(width // zoom, HEIGHT // zoom) for zoom in (1, 2) for width in WIDTHS]
LOOKED_AT = (1440, 390)  # everything at once, and one panel at a time
HERE = Path(__file__).parent
SCRIPTS = [file.read_text(encoding="utf-8") for file in (HERE / "vendor/axe-core/axe.min.js", HERE / "readable.js")]
LONG_NAME = "a_fleet_with_a_rather_long_name"

LOGS = (
    LogFileView("0123456789abcdef", "vehicle-3_2026-05-03_14-07-09_log-12.ulg", 3, "autopilot", 48_211_345, 1.78e9),
    LogFileView("0123456789abcde0", "ground_0042_001.mcap", None, "recording", 211_345, 1.78e9),
)
LOW = FlagView("BATTERY_LOW", "warning", "battery below leave_below_percent", "hold", "land it and change its battery")


def on_the_ground(vehicles: list[VehicleView]) -> list[VehicleView]:
    return [replace(v, phase="observe", landed="on_ground", armed=False, mode="AUTO.LOITER") for v in vehicles]


def armed(vehicles: list[VehicleView]) -> list[VehicleView]:
    return [replace(v, phase="armed", landed="on_ground", mode="AUTO.TAKEOFF") for v in vehicles]


def in_trouble(vehicles: list[VehicleView]) -> list[VehicleView]:
    changes = {3: {"flags": (LOW,), "phase": "hold", "mode": "AUTO.LOITER"}, 4: {"silent": True, "age_s": 64.0}}
    return [replace(v, **changes.get(v.vehicle_id, {"mode": "OFFBOARD"})) for v in vehicles]


def assert_readable(page: Page) -> None:
    assert_its_colours_are_readable(page)
    found = {}
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        found[width, height] = page.evaluate("readable.cutOff()")
    assert {size: texts for size, texts in found.items() if texts} == {}


def assert_its_colours_are_readable(page: Page) -> None:
    found = {}
    for script in SCRIPTS:
        page.evaluate(script)
    for theme in ("light", "dark"):
        page.emulate_media(color_scheme=theme)  # type: ignore[arg-type]
        for width in LOOKED_AT:
            page.set_viewport_size({"width": width, "height": HEIGHT})
            found[theme, width] = page.evaluate("readable.colours()")
    assert {where: texts for where, texts in found.items() if texts} == {}


@pytest.mark.parametrize("state", [on_the_ground, armed, in_trouble], ids=lambda state: state.__name__)
def test_every_text_of_a_fleet_can_be_read(open_page: OpenPage, state: object) -> None:
    with PageServer(may_control=True) as server:
        server.fleet_name = LONG_NAME
        server.logs = LogsView(True, LOGS)
        server.change = state
        server.refuse = {3: "vehicle 3 is not armed; it is in hold, with a battery below leave_below_percent"}
        server.alarm(4, "SILENT", text="no report any more; when it last reported: formation, armed")
        page = open_page(server.control_url)
        page.locator("tbody.vehicle[data-id='3'] button").click()
        for summary in page.locator("summary").all():
            summary.click()
        page.locator("[data-action=place]").click()
        page.locator("[data-action=hold]").click()
        expect(page.locator(".answer li")).to_have_count(2)  # of vehicle 3, and of the others
        page.locator("[data-action=preview-formation]").click()
        expect(page.locator(".previewed")).to_contain_text("smallest separation")
        assert_readable(page)


def test_every_text_without_a_fleet_can_be_read(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        server.change = lambda _vehicles: []
        assert_readable(open_page(server.control_url))


def test_every_text_of_a_replay_can_be_read(open_page: OpenPage) -> None:
    with PageServer() as server:
        server.replay = ReplayView(server.begin_s, server.begin_s + 420.0, server.begin_s + 100.0, 1.0)
        server.flight = flown(server.begin_s)
        page = open_page(server.url)
        expect(page.locator("#replay .timeline")).to_contain_text("hold")
        assert_readable(page)


def test_every_text_of_before_can_be_read_when_the_server_is_lost(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        server.change = in_trouble
        server.alarm(4, "SILENT")
        page = open_page(server.control_url)
        server.stop()
        expect(page.locator("#banner .lost-server")).to_be_visible()
        assert_its_colours_are_readable(page)
