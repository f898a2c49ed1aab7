"""No text is cut off, in the states of the screens of docs/monitor.md, at every width and zoom that people use."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from companion.monitor.api import FlagView, ReplayView, VehicleView
from page_server import PageServer

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is missing").expect

if TYPE_CHECKING:
    from conftest import OpenPage
    from playwright.sync_api import Page

# A page at 200 % is laid out in half of the width of the window: 1920, 1440 and 1024 then are 960, 720 and 512.
WIDTHS = (1920, 1440, 1024, 768, 512, 390)
HEIGHT = 900
TABS = ("Vehicles", "Alarms", "Control", "Plots", "Events")
LONG_NAME = "a_fleet_with_a_rather_long_name"

# A text is cut off where it is wider than its box, or its box than one around it that hides the rest. Meant are: what scrolls,
# and an ellipsis with a title.
CUT_OFF = """() => {
  const meant = (e) => ["auto", "scroll"].includes(getComputedStyle(e).overflowX)
    || (getComputedStyle(e).textOverflow === "ellipsis" && e.closest("[title]"));
  const written = new OffscreenCanvas(1, 1).getContext("2d");
  const width = (e, text) => { written.font = getComputedStyle(e).font; return written.measureText(text).width; };
  const padding = (e) => parseFloat(getComputedStyle(e).paddingLeft) + parseFloat(getComputedStyle(e).paddingRight);
  const inner = (e) => e.clientWidth - padding(e);
  const field = (e) => e.matches("input:not([type]), input[type=text], input[type=number]") && width(e, e.value) > inner(e) + 1;
  const wide = (e) => e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).overflowX !== "visible" && !meant(e);
  const hidden = (e) => {
    const { right, left } = e.getBoundingClientRect();
    for (let around = e.parentElement; around; around = around.parentElement) {
      if (meant(around)) return false;
      if (getComputedStyle(around).overflowX === "visible") continue;
      const box = around.getBoundingClientRect();
      if (right > box.right + 1 || left < box.left - 1) return true;
    }
    return right > innerWidth + 1;
  };
  const written_in = (e) => e.matches("input, select") || [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
  const texts = [...document.querySelectorAll("body *")].filter((e) => e.checkVisibility() && written_in(e)
    && !e.closest(".unseen, .skip, script, svg, dialog:not([open]), noscript"));
  return texts.filter((e) => field(e) || wide(e) || hidden(e))
    .map((e) => `${e.tagName}.${e.className} in #${e.closest("[id]")?.id}: ${(e.value || e.textContent).trim().slice(0, 40)}`);
}"""

LOW = FlagView("BATTERY_LOW", "warning", "battery below leave_below_percent", "hold", "land it and change its battery")


def on_the_ground(vehicles: list[VehicleView]) -> list[VehicleView]:
    return [replace(v, phase="observe", landed="on_ground", armed=False, mode="AUTO.LOITER") for v in vehicles]


def armed(vehicles: list[VehicleView]) -> list[VehicleView]:
    return [replace(v, phase="armed", landed="on_ground", mode="AUTO.TAKEOFF") for v in vehicles]


def in_trouble(vehicles: list[VehicleView]) -> list[VehicleView]:
    changes = {3: {"flags": (LOW,), "phase": "hold", "mode": "AUTO.LOITER"}, 4: {"silent": True, "age_s": 64.0}}
    return [replace(v, **changes.get(v.vehicle_id, {"mode": "OFFBOARD"})) for v in vehicles]


def assert_nothing_is_cut_off(page: Page) -> None:
    found = {}
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": HEIGHT})
        tabs = page.locator("#tabs")
        for name in TABS if tabs.is_visible() else ("",):
            if name and (button := tabs.get_by_role("button", name=name)).count():
                button.click()
            if cut := page.evaluate(CUT_OFF):
                found[width, name] = cut
    assert not found


@pytest.mark.parametrize("state", [on_the_ground, armed, in_trouble], ids=lambda state: state.__name__)
def test_no_text_of_a_fleet_is_cut_off(open_page: OpenPage, state: object) -> None:
    with PageServer(may_control=True) as server:
        server.fleet_name = LONG_NAME
        server.change = state
        server.refuse = {3: "vehicle 3 is not armed; it is in hold, with a battery below leave_below_percent"}
        server.alarm(4, "SILENT", text="no report any more; when it last reported: formation, armed")
        page = open_page(server.control_url)
        page.locator("tbody.vehicle[data-id='3'] button").click()
        for summary in page.locator("summary").all():
            summary.click()
        page.locator("[data-action=hold]").click()
        expect(page.locator(".answer li")).to_have_count(2)  # of vehicle 3, and of the others
        assert_nothing_is_cut_off(page)


def test_no_text_is_cut_off_without_a_fleet(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        server.change = lambda _vehicles: []
        assert_nothing_is_cut_off(open_page(server.control_url))


def test_no_text_of_a_replay_is_cut_off(open_page: OpenPage) -> None:
    with PageServer() as server:
        server.replay = ReplayView(server.begin_s, server.begin_s + 420.0, server.begin_s + 100.0, 1.0)
        assert_nothing_is_cut_off(open_page(server.url))
