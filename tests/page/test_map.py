"""Work on the map: the reference on it, points and slots that are placed and dragged, where the fleet is to go."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from companion.geometry.formations import SHAPES
from companion.geometry.formations import slots_of as shape_slots
from page_server import PageServer, until_shown

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is missing").expect

if TYPE_CHECKING:
    from conftest import OpenPage
    from playwright.sync_api import Page

    from companion.monitor.api import VehicleView

PROBE_PX = 60.0
DRAWN = """([x, y]) => {
  const canvas = document.getElementById("scene");
  const data = canvas.getContext("2d").getImageData(x * devicePixelRatio - 3, y * devicePixelRatio - 3, 7, 7).data;
  return [...data].filter((value, i) => i % 4 === 0 && value < 150).length;
}"""


def place_at(page: Page, x: float, y: float) -> tuple[float, float]:
    """East and north, in metres, of a point of the window that is on the map."""
    page.mouse.move(x, y)
    east_m, north_m = re.findall(r"-?\d+\.\d+", page.locator("#map-cursor").inner_text().replace("−", "-"))[:2]
    return float(east_m), float(north_m)


def window_at(page: Page, east_m: float, north_m: float) -> tuple[float, float]:
    """Where a place on the ground is in the window, with the map seen from above and north up."""
    box = page.locator("#scene").bounding_box()
    assert box
    x, y = box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0
    here, there = place_at(page, x, y), place_at(page, x + 3.0 * PROBE_PX, y - PROBE_PX)
    scale = 3.0 * PROBE_PX / (there[0] - here[0])
    return x + (east_m - here[0]) * scale, y - (north_m - here[1]) * scale


def stand_still(server: PageServer) -> None:
    still = server.vehicles(server.begin_s)
    server.change = lambda _: still


def test_the_reference_is_a_line_on_the_map_until_another_one_flies(open_page: OpenPage) -> None:
    with PageServer() as server:
        stand_still(server)
        track = ((-1.0, 1.3, 4.0), (1.0, 1.3, 4.0))
        file = server.file()
        server.file = lambda: replace(file, reference_enu_m=track)  # type: ignore[method-assign]
        page = open_page(server.url)
        box = page.locator("#scene").bounding_box()
        assert box

        def drawn() -> bool:
            places = [window_at(page, 0.1 * east, 1.3) for east in range(-9, 10, 3)]
            return all(page.evaluate(DRAWN, [x - box["x"], y - box["y"]]) for x, y in places)

        until_shown(page, drawn)
        server.file = lambda: replace(file, reference_enu_m=())  # type: ignore[method-assign]
        server.change = lambda vs, change=server.change: [  # type: ignore[misc]
            replace(v, reference="3") if v.reference_enu_m else v for v in change(vs)
        ]
        until_shown(page, lambda: not drawn())


def drag(page: Page, start: tuple[float, float], by_px: tuple[float, float]) -> None:
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(start[0] + by_px[0] / 2.0, start[1] + by_px[1] / 2.0)
    page.mouse.move(start[0] + by_px[0], start[1] + by_px[1])
    page.mouse.up()


def drag_by_finger(page: Page, start: tuple[float, float], by_px: tuple[float, float]) -> None:
    session = page.context.new_cdp_session(page)

    def touch(kind: str, *points: tuple[float, float]) -> None:
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y} for x, y in points]})

    touch("touchStart", start)
    touch("touchMove", (start[0] + by_px[0] / 2.0, start[1] + by_px[1] / 2.0))
    touch("touchMove", (start[0] + by_px[0], start[1] + by_px[1]))
    touch("touchEnd")


def middle(page: Page) -> tuple[float, float]:
    box = page.locator("#scene").bounding_box()
    assert box
    return box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0


def width_m(page: Page) -> float:
    """Of 200 pixels of the map."""
    x, y = middle(page)
    return place_at(page, x + 200.0, y)[0] - place_at(page, x, y)[0]


def away(vehicles: list[VehicleView]) -> list[VehicleView]:
    """The whole fleet 60 m farther east: a map that follows shows it there."""
    names = ("position_enu_m", "slot_position_enu_m", "reference_enu_m")
    places = [{name: at for name in names if (at := getattr(v, name))} for v in vehicles]
    moved = [{name: (x + 60.0, y, z) for name, (x, y, z) in of.items()} for of in places]
    return [replace(v, **of) for v, of in zip(vehicles, moved, strict=True)]


def test_a_slot_is_dragged_and_the_vehicles_are_asked_again(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        stand_still(server)
        page = open_page(server.control_url)
        page.locator("summary", has_text="Formation").click()
        page.get_by_label("Slots").select_option("diamond")
        page.get_by_label("Spacing").fill("3")
        page.locator("[data-action=preview-formation]").click()
        send, previewed = page.locator("[data-action=send-formation]"), page.locator(".previewed")
        expect(send).to_have_count(1)
        page.keyboard.press("Control+z")  # nothing was dragged: neither does it take back what was typed
        expect(page.locator("#hint")).to_contain_text("nothing to take back")
        expect(page.get_by_label("Spacing")).to_have_value("3")
        x_m, y_m, _ = shape_slots(SHAPES["diamond"], 4, 3.0, 0.0)[1]
        start, end = window_at(page, x_m, y_m), window_at(page, x_m + 2.0, y_m + 1.0)
        drag(page, start, (end[0] - start[0], end[1] - start[1]))
        expect(page.get_by_label("Slots")).to_have_value("a slot for each vehicle")
        expect(send).to_have_count(1)
        east, north = (page.get_by_label(f"Vehicle 2, {axis}, metres") for axis in ("east", "north"))
        assert float(east.input_value()) == pytest.approx(x_m + 2.0, abs=0.15)
        assert float(north.input_value()) == pytest.approx(y_m + 1.0, abs=0.15)

        here, still = place_at(page, *middle(page)), server.change
        server.change = lambda vs: away(still(vs))
        page.wait_for_timeout(400)
        assert place_at(page, *middle(page)) == here  # what is worked on stays where it is
        page.keyboard.press("Control+z")
        expect(page.get_by_label("Slots")).to_have_value("diamond")
        expect(send).to_have_count(1)
        until_shown(page, lambda: place_at(page, *middle(page))[0] > 50.0)
        expect(page.locator("#map-note button")).to_have_count(0)
        server.change = still  # the slots of a preview go with the fleet, and the map follows
        until_shown(page, lambda: abs(place_at(page, *middle(page))[0]) < 10.0)
        page.locator(".previewed").get_by_role("button", name="Discard").click()
        near = width_m(page)
        page.get_by_label("Spacing").fill("39")
        page.locator("[data-action=preview-formation]").click()
        until_shown(page, lambda: width_m(page) > 3.0 * near)
        page.locator(".previewed").get_by_role("button", name="Discard").click()
        until_shown(page, lambda: width_m(page) == pytest.approx(near, rel=0.3))
        page.get_by_label("Spacing").fill("3")
        page.locator("[data-action=preview-formation]").click()
        send.click()
        until_shown(page, lambda: bool(server.commands))
        assert server.commands[0].content == {"shape": "diamond", "spacing_m": 3, "heading_deg": 0}
        expect(previewed).to_have_count(0)


def test_a_preview_vanishes_with_what_it_was_of(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        stand_still(server)
        page = open_page(server.control_url)
        page.locator("summary", has_text="Formation").click()
        page.locator("[data-action=preview-formation]").click()
        expect(page.locator("[data-action=send-formation]")).to_have_count(1)
        still = server.change
        server.change = lambda vs: [replace(v, formation="changing to 3") for v in still(vs)]
        expect(page.locator(".previewed")).to_have_count(0)
        expect(page.locator("#hint")).to_contain_text("flies another formation or reference now")


def test_points_are_placed_dragged_and_taken_back_by_touch(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        stand_still(server)
        page = open_page(server.control_url, width=390, height=844, has_touch=True)
        page.locator("#tabs").get_by_role("button", name="Control").click()
        page.locator("summary", has_text="Reference").click()
        page.get_by_label("Kind").select_option("waypoints")
        page.locator("[data-action=place]").click()
        x, y = middle(page)
        for dx, dy in ((-90.0, 60.0), (60.0, 60.0), (60.0, -20.0)):
            page.touchscreen.tap(x + dx, y + dy)
        east = [page.get_by_label(f"Point {i}, E, metres") for i in (1, 2, 3)]
        expect(page.locator(".points input")).to_have_count(9)
        scale = (float(east[1].input_value()) - float(east[0].input_value())) / 150.0
        page.locator("[data-action=undo]").click()
        expect(page.locator(".points input")).to_have_count(6)
        before = float(east[1].input_value())
        page.locator("[data-action=preview-reference]").click()
        send = page.locator("[data-action=send-reference]")
        expect(send).to_have_count(1)
        drag_by_finger(page, (x + 60.0, y + 60.0), (30.0, 0.0))
        until_shown(page, lambda: float(east[1].input_value()) == pytest.approx(before + 30.0 * scale, abs=0.3))
        expect(send).to_have_count(1)
        dragged = float(east[1].input_value())
        send.click()
        until_shown(page, lambda: bool(server.commands))
        points = server.commands[0].content["points_enu_m"]
        assert [len(points), points[1][0]] == [2, dragged]
        expect(page.locator(".points input")).to_have_count(0)
        expect(page.locator("#map-note button")).to_have_count(0)


def test_the_fleet_goes_to_a_place_that_is_clicked(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        stand_still(server)
        server.most_speed_m_s = 0.7
        page = open_page(server.control_url)
        page.locator("summary", has_text="Reference").click()
        for kind, label in (("circle", "Period"), ("circle", "Time to full speed"), ("waypoints", "Stop at each")):
            page.get_by_label("Kind").select_option(kind)
            page.get_by_label(label).fill("60")
        page.locator("[data-action=go]").click()
        expect(page.locator("#map-note")).to_contain_text("Click where the fleet is to go.")
        x, y = window_at(page, 2.0, -1.0)
        page.mouse.click(x, y)
        expect(page.locator("[data-action=send-reference]")).to_have_count(1)
        assert server.commands == []
        page.locator("[data-action=send-reference]").click()
        until_shown(page, lambda: bool(server.commands))
        content = server.commands[0].content
        assert (content["kind"], content["max_speed_m_s"]) == ("waypoints", 0.7)
        assert (content["wait_s"], content["max_acceleration_m_s2"]) == (0, 1)  # no other form's
        start, end = content["points_enu_m"]
        assert start == [0, 0, 5]
        assert end == pytest.approx([2.0, -1.0, 5.0], abs=0.15)
        server.change = lambda vs: [replace(v, phase="hold") for v in vs]
        expect(page.locator("[data-action=go]")).to_be_disabled()


def size(page: Page, panel: str) -> tuple[float, float]:
    box = page.locator(panel).bounding_box()
    assert box
    return box["width"], box["height"]


def test_the_map_gets_the_room_that_the_operator_gives_it(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        usual = size(page, "#map")
        assert usual[0] > 700.0 and usual[1] > 560.0
        box = page.locator("#divider-side").bounding_box()
        assert box
        drag(page, (box["x"] + 6.0, box["y"] + 300.0), (80.0, 0.0))
        assert size(page, "#map") == (usual[0] + 80.0, usual[1])
        drag(page, (box["x"] + 86.0, box["y"] + 300.0), (900.0, 0.0))
        assert size(page, "#side")[0] == 300.0  # its least width
        plots = page.locator("#divider-plots")
        plots.focus()
        for _ in range(2):
            page.keyboard.press("ArrowDown")
        assert size(page, "#map")[1] == usual[1] + 32.0
        assert plots.get_attribute("aria-valuenow") == "164"
        page.reload()
        until_shown(page, "globalThis.companionMetrics?.count > 0")
        assert (size(page, "#side")[0], size(page, "#map")[1]) == (300.0, usual[1] + 32.0)
        page.locator("#divider-side").focus()
        page.keyboard.press("Enter")
        assert size(page, "#map")[0] == usual[0]
        page.set_viewport_size({"width": 390, "height": 844})
        low = size(page, "#map")[1]
        page.locator("#divider-map").focus()
        page.keyboard.press("Shift+ArrowDown")
        assert size(page, "#map")[1] == pytest.approx(low + 64.0, abs=1.0)
        page.get_by_role("button", name="Help").click()
        page.locator("#usual-sizes").click()
        assert size(page, "#map")[1] == low
        page.set_viewport_size({"width": 1440, "height": 900})
        assert size(page, "#map") == usual
