"""Work on the map: the reference on it, points and slots that are placed and dragged, where the fleet is to go."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from page_server import PageServer, until_shown

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is missing").expect

if TYPE_CHECKING:
    from conftest import OpenPage
    from playwright.sync_api import Page

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
