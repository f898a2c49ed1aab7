"""What the live page shows of a fleet, and how it follows it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from companion.monitor.api import FlagView, ReplayView, VehicleView
from page_server import PageServer, until_shown

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is missing").expect
expect.set_options(timeout=20_000)

if TYPE_CHECKING:
    from conftest import OpenPage
    from playwright.sync_api import Page

BATTERY_LOW = FlagView("BATTERY_LOW", "warning", "battery below 25 %", "hold", "change the battery of vehicle 3")


def in_hold(vehicles: list[VehicleView]) -> list[VehicleView]:
    """Vehicle 3 with a flag, in hold."""
    return [
        replace(v, phase="hold", flags=(BATTERY_LOW,), battery_percent=21.0) if v.vehicle_id == 3 else v
        for v in vehicles
    ]


def test_every_vehicle_has_a_row_and_its_details(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        expect(page.locator("tbody.vehicle")).to_have_count(4)
        expect(page.locator("tbody.vehicle[data-id='1']")).to_contain_text("formation")
        expect(page.locator("tbody.vehicle[data-id='1'] .leader")).to_be_visible()
        expect(page.locator("#details")).to_contain_text("Select a vehicle")
        ends = "['#side', '#events'].map((panel) => document.querySelector(panel).getBoundingClientRect().bottom)"
        assert len(set(page.evaluate(ends))) == 1  # the list takes the room of the details
        page.locator("tbody.vehicle[data-id='2']").click()
        expect(page.locator("#details h2")).to_have_text("Vehicle 2, follower")
        names = {name.strip() for name in page.locator("#details dt").all_inner_texts()}
        assert {"Battery", "PrC", "Fresh peers", "Error to slot", "Required distance", "Last event", "Epoch"} <= names
        expect(page.locator("#details dl div", has_text="Landed").locator("dd")).to_have_text("in air")
        expect(page.locator("#details .neighbours tbody tr")).not_to_have_count(0)
        expect(page.locator("#control")).to_be_hidden()
        expect(page.locator("#abort")).to_have_count(0)


def test_the_bar_says_who_else_commands(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url, 390, 844)
        holder = page.locator("#bar .holder")
        expect(page.locator("#figures")).to_contain_text("4 of 4")
        expect(holder).to_have_count(0)
        server.change = lambda vs: [replace(v, holder="anna@laptop") if v.vehicle_id < 3 else v for v in vs]
        expect(holder).to_have_text("anna@laptop commands 1, 2")
        server.change = lambda vs: [replace(v, holder="anna@laptop") for v in vs]
        expect(holder).to_have_text("anna@laptop commands")
        expect(holder).to_be_visible()


def test_a_page_without_vehicles_says_why_and_what_starts_some(open_page: OpenPage) -> None:
    with PageServer() as server:
        server.unreachable = tuple(
            f"tcp/127.0.0.1:{7448 + i}: connection refused; no agent listens there" for i in range(7)
        )
        page = open_page(server.url)
        lines = page.locator("#vehicles .empty li")
        expect(lines.nth(0)).to_have_text(server.unreachable[0])
        expect(lines.last).to_have_text("and 2 more")
        expect(page.locator("#vehicles .empty code").last).to_have_text("sitl fleet platoon")
        server.unreachable = ("tcp/192.168.10.11:7447: no route to host",)
        expect(page.locator("#vehicles .empty code")).to_have_count(1)  # no simulated fleet for one of real vehicles
        server.unreachable = ()
        expect(page.locator("tbody.vehicle")).to_have_count(4)
        expect(page.locator("#vehicles .empty")).to_have_count(0)


def test_a_changed_vehicle_changes_its_row(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        row = page.locator("tbody.vehicle[data-id='3']")
        expect(row).to_contain_text("formation")
        server.change = in_hold
        expect(row).to_contain_text("hold")
        expect(row).to_contain_text("BATTERY_LOW: battery below 25 %. Agent: hold. change the battery of vehicle 3")


def test_a_vehicle_in_the_air_without_its_agent_is_not_drawn_on_the_ground(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        taken = {"phase": "observe", "refuses_return": "NO_HOME: it has no home"}
        server.change = lambda vs: [replace(v, **taken) if v.vehicle_id == 3 else v for v in vs]
        page = open_page(server.control_url)
        symbol = page.locator("tbody.vehicle[data-id='3'] .symbol")
        expect(symbol).to_have_class(re.compile("hollow"))
        circle = page.locator("tbody.vehicle[data-id='2'] .symbol path").get_attribute("d")
        assert circle
        expect(symbol.locator("path")).to_have_attribute("d", circle)
        back = page.locator("button[data-action='return']")
        expect(back).to_have_attribute("title", re.compile("Not possible: 3 is in observe"))
        server.change = lambda vs: [replace(v, refuses_return="NO_HOME: it has no home") for v in vs]
        expect(back).to_have_class("refused")
        expect(back).to_have_attribute("title", re.compile("1: NO_HOME: it has no home"))


def test_a_silent_vehicle_is_marked_with_its_age(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url, height=813)
        expect(page.locator("#figures")).to_contain_text("4 of 4")
        server.change = lambda vs: [
            replace(v, silent=True, age_s=12.3) if v.vehicle_id == 4 else v for v in in_hold(vs)
        ]
        ended = server.alarm(1, "LEADER_LOST")
        server.alarms = [replace(ended, until_s=ended.since_s + 1.0)]
        server.alarm(3, "BATTERY_LOW", "warning")
        server.alarm(4, "SILENT", text="no report any more")
        row = page.locator("tbody.vehicle[data-id='4']")
        expect(row).to_contain_text("SILENT")
        expect(row).to_contain_text("no report for 12.3")
        expect(page.locator("#figures")).to_contain_text("3 of 4")
        alarms = page.locator("#alarms li strong")
        expect(alarms).to_have_text(["vehicle 4: SILENT", "vehicle 3: BATTERY_LOW", "vehicle 1: LEADER_LOST"])
        row.click()
        expect(page.locator("#details")).to_contain_text("SILENT for 12.3")
        expect(row).to_be_in_viewport(ratio=0.95)  # also beside alarms and details


def click_along(page: Page, points: list[tuple[float, float]], stop_at: str = "") -> None:
    """Clicks from outside inwards until a vehicle is selected; a click beside all of them selects none."""
    for x, y in points:
        page.mouse.click(x, y)
        page.wait_for_timeout(60)
        selected = page.locator("tbody.vehicle.selected")
        if selected.count() and stop_at in (selected.get_attribute("data-id") or ""):
            return


def test_a_click_on_the_map_selects_the_vehicle_there(open_page: OpenPage) -> None:
    with PageServer() as server:
        still = server.vehicles(server.begin_s)
        server.change = lambda _: still
        page = open_page(server.url)
        box = page.locator("#scene").bounding_box()
        assert box
        page.locator("#scene").focus()
        page.keyboard.press("f")
        # North is up and the fleet is in the middle: its northernmost vehicle is straight above it, vehicle 1 to the right.
        x, y = box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0
        expect(page.locator("#details")).to_contain_text("Select a vehicle")
        click_along(page, [(x, y - step) for step in range(int(box["height"] / 2.0), 0, -12)])
        expect(page.locator("#details h2")).to_contain_text("Vehicle 2")
        click_along(page, [(x + step, y) for step in range(int(box["width"] / 2.0) - 80, 0, -12)], stop_at="1")
        expect(page.locator("#details h2")).to_contain_text("Vehicle 1")


def test_the_map_says_what_place_is_under_the_pointer(open_page: OpenPage) -> None:
    def place(text: str) -> tuple[float, ...]:
        return tuple(float(number) for number in re.findall(r"-?\d+\.\d+", text.replace("−", "-")))

    with PageServer() as server:
        page = open_page(server.url)
        box, cursor = page.locator("#scene").bounding_box(), page.locator("#map-cursor")
        assert box
        x, y = box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0
        for _ in range(6):  # places are shown in tenths of a metre
            page.get_by_role("button", name="Zoom out").click()
        page.mouse.move(x, y)
        expect(cursor).to_contain_text(re.compile(r"m east, .* m north; \d"))
        east_m, north_m, latitude_deg, longitude_deg = place(cursor.inner_text())
        page.mouse.move(x + 80.0, y - 40.0)
        moved = place(cursor.inner_text())
        assert moved[0] - east_m == pytest.approx(2.0 * (moved[1] - north_m), abs=0.2) and moved[1] > north_m
        assert moved[2] - latitude_deg == pytest.approx((moved[1] - north_m) / 111_200.0, abs=0.11 / 111_200.0)
        assert moved[3] > longitude_deg
        page.mouse.move(1.0, 1.0)
        expect(cursor).to_have_text("")


def test_keys_turn_the_map_into_3d_and_back(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        button = page.get_by_role("button", name="3-D")
        page.locator("#scene").focus()
        page.keyboard.press("3")
        expect(button).to_have_attribute("aria-pressed", "true")
        expect(page.get_by_role("button", name="North")).to_be_visible()
        page.keyboard.press("n")
        expect(page.get_by_role("button", name="North")).to_have_count(0)
        page.keyboard.press("ArrowLeft")
        expect(page.get_by_role("button", name="Fit")).to_have_attribute("aria-pressed", "false")
        page.keyboard.press("f")
        expect(page.get_by_role("button", name="Fit")).to_have_attribute("aria-pressed", "true")


def test_alarms_are_acknowledged(open_page: OpenPage) -> None:
    with PageServer() as server:
        server.alarm(3, "BATTERY_LOW", "warning")
        server.alarm(4, "SILENT")
        page = open_page(server.url)
        expect(page.locator("#alarms li")).to_have_count(2)
        expect(page.locator("#alarms li").first).to_contain_text("SILENT")  # the most severe first
        page.get_by_role("button", name="Acknowledge vehicle 4 SILENT").click()
        expect(page.locator("#alarms li.acknowledged")).to_contain_text("vehicle 4")
        expect(page.get_by_role("button", name="1 alarms not acknowledged")).to_be_visible()
        assert [alarm.acknowledged for alarm in server.alarms] == [False, True]


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (1280, 720)])
def test_many_alarms_cover_nothing_on_a_wide_screen(open_page: OpenPage, width: int, height: int) -> None:
    with PageServer(8) as server:
        server.replay = ReplayView(server.begin_s, server.begin_s + 300.0, server.begin_s + 60.0, 1.0)
        for vehicle_id in range(1, 9):
            server.alarm(vehicle_id, "BATTERY_LOW", "warning", text="a text that needs more than one line of the list")
        page = open_page(server.url, width, height)
        page.locator("tbody.vehicle[data-id='3']").click()
        expect(page.locator("#details h2")).to_contain_text("Vehicle 3")
        bottoms = page.evaluate(
            """() => ["#alarms", "#vehicles", "#details", "#events", "#replay", "#replay input"].map(
                (selector) => document.querySelector(selector).getBoundingClientRect())
                .map(({ top, bottom }) => [top, bottom])"""
        )
        events, replay = bottoms[3], bottoms[4]
        assert events[1] <= replay[0] + 1.0
        assert all(bottom - top >= 60.0 for top, bottom in bottoms[:4])
        expect(page.locator("#replay input")).to_be_in_viewport(ratio=1.0)


@pytest.mark.parametrize("width", [360, 390, 1440])
def test_the_age_of_a_vehicle_is_shown_with_its_unit(open_page: OpenPage, width: int) -> None:
    with PageServer() as server:
        ages = {1: 0.166, 2: 0.999, 3: 59.9}
        server.change = lambda vs: [replace(v, data_age_s=ages.get(v.vehicle_id, 0.05)) for v in vs]
        page = open_page(server.url, width, 844)
        cells = page.locator("tbody.vehicle tr:first-child td:last-child")
        expect(cells.nth(1)).to_have_text("999\u00a0ms")
        assert cells.evaluate_all("(all) => all.filter((cell) => cell.scrollWidth > cell.clientWidth).length") == 0


def test_an_old_position_is_no_altitude_of_now(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        points = page.evaluate(
            """async () => {
                const { History } = await import("/js/history.js");
                const history = new History();
                const vehicle = { vehicle_id: 1, position_enu_m: [0, 0, 5], timing: {}, nearest: null };
                history.accept(10, null, [{ ...vehicle, data_age_s: 0.1 }]);
                history.accept(20, null, [{ ...vehicle, data_age_s: 3 }]);
                return history.points.map((point) => point.of.get(1).altitudeM);
            }"""
        )
        assert points == [5, None]


def test_events_are_listed_with_the_newest_first(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        server.event("ROLE_CHANGED", "follower", 2)
        expect(page.locator("#events li")).to_have_count(1)
        server.event("hold", "anna: hold", kind="command")
        expect(page.locator("#events li").first).to_contain_text("anna: hold")
        page.locator("#events").get_by_role("button", name="Commands").click()
        expect(page.locator("#events li")).to_have_count(1)


def test_plots_have_titles_units_and_lines(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        expect(page.locator(".plot canvas")).to_have_count(4)
        titles = page.locator(".plot figcaption span").all_inner_texts()
        assert titles == ["Distance to the nearest (m)", "Error to slot (m)", "Altitude (m)", "Tick lateness, p99 (ms)"]
        expect(page.locator(".plot-key li")).to_have_text(["1", "2", "3", "4", "┊command"])


def test_a_large_fleet_is_plotted_by_its_range(open_page: OpenPage) -> None:
    with PageServer(20) as server:
        page = open_page(server.url)
        expect(page.locator(".plot-key li")).to_have_text(["smallest", "median", "largest", "┊command"])
        page.locator("tbody.vehicle[data-id='7']").click()
        expect(page.locator(".plot-key li")).to_have_text(["smallest", "median", "largest", "7", "┊command"])


def test_a_replay_is_never_taken_for_a_flight(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        server.replay = ReplayView(server.begin_s, server.begin_s + 300.0, server.begin_s + 60.0, 1.0)
        page = open_page(server.control_url)
        expect(page.locator("#banner")).to_contain_text("REPLAY of a recorded flight")
        expect(page.locator(".live")).to_have_text("REPLAY")
        expect(page.locator("#control")).to_be_hidden()
        expect(page.locator("#abort")).to_have_count(0)
        page.get_by_role("button", name="Pause").click()
        page.locator("#replay input").fill("120")
        until_shown(page, lambda: {"type": "speed", "speed": 0} in server.received)
        until_shown(page, lambda: {"type": "seek", "time_s": server.begin_s + 120.0} in server.received)


def test_update_times_are_measured(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        until_shown(page, "companionMetrics.count >= 10")
        p50_ms, p95_ms = page.evaluate("[companionMetrics.p50_ms, companionMetrics.p95_ms]")
        assert 0.0 < p50_ms <= p95_ms
        assert page.evaluate("performance.getEntriesByName('snapshot').length") >= 1
