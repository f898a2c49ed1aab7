"""The mission along time: what was commanded, by whom and how it was answered, who led; and the jumps of a replay."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from companion.monitor.api import LogFileView, LogsView, ReplayView
from companion.monitor.events import Given
from page_server import ANNA, PageServer, flown, until_shown

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is missing").expect

if TYPE_CHECKING:
    from conftest import OpenPage
    from playwright.sync_api import Page

LASTS_S = 300.0


def assert_sought(page: Page, server: PageServer, offset_s: float) -> None:
    def sought() -> bool:
        last = [message for message in server.received if message["type"] == "seek"][-1:]
        return [pytest.approx(message["time_s"] - server.begin_s, abs=0.02) for message in last] == [offset_s]

    until_shown(page, sought)
    until_shown(page, f"Math.abs(document.querySelector('#replay input').value - {offset_s}) < 0.3")


def test_a_replay_jumps_to_events_and_findings_by_buttons_and_keys(open_page: OpenPage) -> None:
    with PageServer() as server:
        server.replay = ReplayView(server.begin_s, server.begin_s + LASTS_S, server.begin_s + 60.0, 0.0)
        server.flight = flown(server.begin_s)
        page = open_page(server.url)
        expect(page.locator("#replay .timeline")).to_contain_text("hold")
        page.get_by_role("button", name="Next event").click()
        assert_sought(page, server, 100.01)
        expect(page.locator("#hint")).to_contain_text("formation 1 -> 2")
        page.get_by_role("button", name="Next finding").click()
        assert_sought(page, server, 200.0)
        page.get_by_role("button", name="Previous event").click()
        assert_sought(page, server, 150.0)
        page.keyboard.press("j")
        assert_sought(page, server, 100.01)
        page.keyboard.press("Shift+L")
        assert_sought(page, server, 200.0)
        page.keyboard.press("l")
        page.keyboard.press("l")  # at once: it counts from the jump before
        assert_sought(page, server, 250.0)
        page.keyboard.press("Shift+L")
        expect(page.locator("#hint")).to_contain_text("No finding after this time.")


def test_the_speed_of_a_replay_is_chosen_by_keys_too(open_page: OpenPage) -> None:
    with PageServer() as server:
        server.replay = ReplayView(server.begin_s, server.begin_s + LASTS_S, server.begin_s + 60.0, 0.5)
        page = open_page(server.url)
        for key, speed in (("u", 0.25), ("u", 0.25), ("o", 0.5), ("k", 0.0), ("k", 0.5)):
            page.keyboard.press(key)
            until_shown(page, lambda speed=speed: server.replay.speed == speed)
            expect(page.locator("#replay .play")).to_contain_text("Pause" if speed else "Play")
        page.keyboard.press("k")
        until_shown(page, lambda: server.replay.speed == 0.0)
        for key in ("o", "o"):  # while it is paused: for when it goes on
            page.keyboard.press(key)
        expect(page.locator("#replay select")).to_have_value("2")
        assert server.replay.speed == 0.0
        page.keyboard.press("k")
        until_shown(page, lambda: server.replay.speed == 2.0)
        page.locator("#replay select").select_option("16")
        until_shown(page, lambda: server.replay.speed == 16.0)
        page.locator("#replay select").focus()
        page.keyboard.press("k")  # a letter chooses in a list
        page.wait_for_timeout(150)
        assert server.replay.speed != 0.0


def test_a_replay_shows_the_mission_with_what_is_still_to_come(open_page: OpenPage) -> None:
    with PageServer() as server:
        server.replay = ReplayView(server.begin_s, server.begin_s + LASTS_S, server.begin_s + 120.0, 0.0)
        server.flight = flown(server.begin_s)
        page = open_page(server.url)
        line = page.locator("#replay .timeline")
        expect(line.locator(".span text")).to_have_text(["1", "2", "1", "2"])
        expect(line.locator(".span.later text")).to_have_text(["2"])
        expect(line.locator(".sign")).to_have_count(3)
        expect(line.locator(".sign").first).to_contain_text("✗")
        page.locator("#events").get_by_role("button", name="Timeline").click()
        items = page.locator("#events .mission li")
        expect(items).to_have_count(5)
        expect(items.nth(2)).to_contain_text("leader 2")
        answered = f"{ANNA}: hold to 1, 2: accepted by 1; refused by 2: it is not armed"
        expect(page.locator("#events .mission li", has_text="hold")).to_contain_text(answered)
        box = line.bounding_box()
        assert box
        page.mouse.click(box["x"] + 68.0 + (box["width"] - 78.0) * 200.0 / LASTS_S + 4.0, box["y"] + 70.0)
        assert_sought(page, server, 200.0)  # of the alarm beside the click


def test_the_timeline_of_live_vehicles_follows_its_events(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        page.locator("#events").get_by_role("button", name="Timeline").click()
        line = page.locator("#events .timeline")
        expect(line.locator(".span text")).to_have_text(["1"])  # who leads now
        times, panel = page.locator("#events .axis p").bounding_box(), page.locator("#events").bounding_box()
        assert times and panel
        assert times["y"] + times["height"] <= panel["y"] + panel["height"]  # below the line, not cut off
        given = Given(ANNA, f"{ANNA}/1")
        server.event("hold", f"{ANNA}: hold to vehicles 1 to 4", kind="command", given=given)
        expect(line.locator(".sign")).to_contain_text("·")
        for i in range(1, 5):
            server.event("PHASE_CHANGED", "hold accepted: holds", i, "answer", given.answered("accepted"))
        expect(line.locator(".sign")).to_contain_text("✓")
        expect(page.locator("#events .mission li")).to_contain_text("accepted by 1, 2, 3, 4")
        server.event("ROLE_CHANGED", "follower -> leader in epoch 2", 3, "leader")
        expect(page.locator("#events .mission li").first).to_contain_text("leader 3: follower -> leader in epoch 2")


def test_a_selected_vehicle_has_its_logs_and_how_to_fetch_others(open_page: OpenPage) -> None:
    with PageServer() as server:
        page = open_page(server.url)
        page.locator("tbody.vehicle[data-id='3']").click()
        logs = page.locator("#details .logs")
        expect(logs).to_contain_text("The monitor has none")
        expect(logs).to_contain_text("companion logs --config /etc/companion/vehicle-3.yaml")
        own = LogFileView("0123456789abcdef", "vehicle_3_0042_001.mcap", 3, "recording", 4_200_000, server.begin_s)
        other = LogFileView("0123456789abcde0", "vehicle_2_0042_001.mcap", 2, "recording", 4_200_000, server.begin_s)
        server.logs = LogsView(True, (own, other))
        page.reload()
        page.locator("tbody.vehicle[data-id='3']").click()
        expect(logs.locator("a")).to_have_count(1)
        expect(logs.locator("a")).to_have_attribute("href", f"api/v1/logs/{own.id}")
        expect(logs.locator("li")).to_contain_text("recording, 4.2")
