"""The pictures of docs/monitor.md and docs/report.md: `make screenshots`.

The live page is real, its fleet is that of the page's tests. The report is of a flight in virtual
time, which the target flies.
"""

from __future__ import annotations

import sys
import time
from io import BytesIO
from pathlib import Path

from msgspec.structs import replace
from PIL import Image
from playwright.sync_api import Browser, Locator, Page, sync_playwright

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

from common import ROOT
from companion.monitor.api import FlagView, ReplayView, VehicleView
from page_server import PageServer, flown

IMAGES = ROOT / "docs" / "images"
CHROMIUM = "/usr/bin/chromium"
COLOURS = 200
TRAIL_S = 14.0
DESK, PHONE = (1440, 900), (390, 844)
REPORT = ROOT / "runs" / "pictures" / "report" / "report.html"
SHEET, MARGIN_PX, GAP_PX = (920, 1301), 47, 20  # A4 upright
BATTERY_LOW = FlagView(
    "BATTERY_LOW", "warning", "battery below leave_below_percent", "hold", "land it and change its battery"
)


def troubled(vehicles: list[VehicleView]) -> list[VehicleView]:
    """Vehicle 3 in hold with a low battery, vehicle 4 silent."""
    changes = {
        3: {"flags": (BATTERY_LOW,), "phase": "hold", "mode": "AUTO.LOITER", "battery_percent": 21.0},
        4: {"silent": True, "age_s": 6.4},
    }
    return [replace(vehicle, **changes.get(vehicle.vehicle_id, {})) for vehicle in vehicles]


def save(page: Page | Locator, name: str) -> None:
    with Image.open(BytesIO(page.screenshot())) as image:
        write(image, f"monitor_{name}")


def write(image: Image.Image, name: str) -> None:
    reduced = image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    reduced.save(IMAGES / f"{name}.png", optimize=True)


def opened(browser: Browser, server: PageServer, size: tuple[int, int], scheme: str = "light") -> Page:
    page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme)  # type: ignore[arg-type]
    page.goto(server.control_url)
    page.locator("tbody.vehicle").first.wait_for()
    time.sleep(TRAIL_S)
    return page


def live(browser: Browser) -> None:
    with PageServer(may_control=True) as server:
        server.event("FORMATION_CHANGED", "formation 2 is flown", 2)
        page = opened(browser, server, DESK)
        page.locator("tbody.vehicle[data-id='2']").click()
        for _ in range(3):
            page.get_by_role("button", name="Zoom out").click()
        page.locator("summary", has_text="Formation").click()
        page.locator("[data-action=hold]").click()
        page.locator("[data-action=preview-formation]").click()
        page.locator("[data-action=send-formation]").scroll_into_view_if_needed()
        time.sleep(1.0)
        save(page, "live")
        page.close()


def night(browser: Browser) -> None:
    with PageServer() as server:
        server.change = troubled
        server.alarm(4, "SILENT", text="no report any more; when it last reported: formation, armed")
        server.alarm(3, "BATTERY_LOW", "warning", text=BATTERY_LOW.text)
        page = opened(browser, server, DESK, "dark")
        page.get_by_role("button", name="3-D").click()
        page.locator("tbody.vehicle[data-id='3']").click()
        time.sleep(1.0)
        save(page, "night")
        page.get_by_text("Symbols").click()
        save(page.locator("#map-legend details"), "symbols")
        page.close()


def phone(browser: Browser) -> None:
    with PageServer(may_control=True) as server:
        page = opened(browser, server, PHONE)
        page.locator("#tabs").get_by_role("button", name="Control").click()
        time.sleep(0.5)
        save(page, "phone")
        page.close()


def lost(browser: Browser) -> None:
    with PageServer(may_control=True) as server:
        page = opened(browser, server, DESK)
        server.stop()
        time.sleep(4.0)
        save(page, "lost")
        page.close()


def replayed(browser: Browser) -> None:
    with PageServer() as server:
        server.replay = ReplayView(server.begin_s, server.begin_s + 420.0, server.begin_s + 100.0, 1.0)
        server.flight = flown(server.begin_s)
        page = opened(browser, server, DESK)
        save(page, "replay")
        page.close()


def report(browser: Browser) -> None:
    """The first sheet and that of the formation, as printed, side by side."""
    width, height = SHEET
    page = browser.new_page(viewport={"width": width, "height": height})
    page.emulate_media(media="print")
    page.goto(REPORT.as_uri())
    page.add_style_tag(content=f"body {{ padding: {MARGIN_PX}px; }}")
    tops = [0.0, page.evaluate("document.getElementById('formation').getBoundingClientRect().top") - MARGIN_PX]
    both = Image.new("RGB", (2 * width + GAP_PX, height), "grey")
    for number, top in enumerate(tops):
        png = page.screenshot(full_page=True, clip={"x": 0, "y": top, "width": width, "height": height})
        with Image.open(BytesIO(png)) as sheet:
            both.paste(sheet, (number * (width + GAP_PX), 0))
    write(both, "report")
    page.close()


if __name__ == "__main__":
    wanted = sys.argv[1:]
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        for picture in (live, night, phone, lost, replayed, report):
            if not wanted or picture.__name__ in wanted:
                picture(chromium)
        chromium.close()
