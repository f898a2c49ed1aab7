"""Commands from the live page: what is sent, what must be held, what each vehicle has answered."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from page_server import WARNING, PageServer, until_shown

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is missing").expect

if TYPE_CHECKING:
    from conftest import OpenPage
    from playwright.sync_api import Page

HELD_MS = 1300
SHORTLY_MS = 150
REFUSED = "vehicle 3 is not armed"
# The buttons of which the middle cannot be pressed.
COVERED = """() => [...document.querySelectorAll(".actions button")].filter((button) => {
  const { x, y, width, height } = button.getBoundingClientRect();
  return !button.contains(document.elementFromPoint(x + width / 2, y + height / 2));
})"""


def hold(page: Page, action: str, duration_ms: int = HELD_MS) -> None:
    """Press a button with the mouse for this time."""
    button = page.locator(f"[data-action={action}]")
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    assert box
    page.mouse.move(box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0)
    page.mouse.down()
    page.wait_for_timeout(duration_ms)
    page.mouse.up()


def test_a_dangerous_action_is_sent_only_when_it_is_held(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        assert "token" not in page.url  # nor in the address bar
        hold(page, "takeoff", SHORTLY_MS)
        expect(page.locator("#hint")).to_contain_text('Hold "Take off" for a second')
        assert server.commands == []
        hold(page, "takeoff")
        until_shown(page, lambda: len(server.commands) == 1)
        assert (server.commands[0].name, server.commands[0].vehicle_ids) == ("takeoff", ())


def test_keys_hold_a_button_too(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        page.locator("[data-action=arm]").focus()
        page.keyboard.down("Enter")
        page.wait_for_timeout(HELD_MS)
        page.keyboard.up("Enter")
        until_shown(page, lambda: [command.name for command in server.commands] == ["arm"])


def test_each_vehicles_answer_is_shown(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        server.refuse = {3: REFUSED}
        page = open_page(server.control_url)
        page.locator("[data-action=hold]").click()
        answers = page.locator(".answer li")
        expect(answers).to_have_count(2)  # vehicles with the same answer share a line
        expect(answers.nth(0)).to_contain_text(REFUSED)
        expect(answers.nth(0)).to_contain_text("COMMAND_REFUSED")
        expect(answers.nth(1)).to_contain_text("1, 2, 4 accepted")
        for answer in answers.all():
            expect(answer).to_be_in_viewport(ratio=1.0)
        hold(page, "land")
        page.locator("#control").evaluate("panel => panel.scrollTo(0, 0)")
        for width, height in ((1440, 813), (390, 844)):
            page.set_viewport_size({"width": width, "height": height})
            if width < 600:
                page.locator("#tabs").get_by_role("button", name="Control").click()
            until_shown(page, f"({COVERED})().length === 0")
        page.locator("[data-action=close-answers]").click()
        expect(answers).to_have_count(0)


def test_commands_go_to_the_selected_vehicles_where_that_is_chosen(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        page.get_by_label("selected: none").check()
        expect(page.locator("[data-action=hold]")).to_be_disabled()
        page.locator("tbody.vehicle[data-id='3']").click()
        page.locator("tbody.vehicle[data-id='2']").click(modifiers=["Shift"])
        page.get_by_label("selected: 2, 3").check()
        page.locator("[data-action=hold]").click()
        until_shown(page, lambda: [command.vehicle_ids for command in server.commands] == [(2, 3)])


def test_a_selected_vehicle_becomes_leader(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        page.locator("tbody.vehicle[data-id='4']").click()
        expect(page.locator("[data-action=leader]")).to_be_disabled()  # it may not lead
        page.locator("tbody.vehicle[data-id='2']").click()
        expect(page.locator("[data-action=leader]")).to_have_text("Make 2 leader")
        hold(page, "leader")
        until_shown(page, lambda: [command.content for command in server.commands] == [{"leader_ids": [2]}])


def test_the_next_command_is_marked_and_one_that_is_refused_says_why(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:

        def all_in(phase: str, landed: str = "on_ground") -> None:
            server.change = lambda vs: [replace(v, phase=phase, landed=landed) for v in vs]

        all_in("observe")
        page = open_page(server.control_url)
        next_step, marked = page.locator(".next-step"), page.locator(".actions .next")
        expect(marked).to_have_text("Arm")
        expect(next_step).to_have_text("Next: Arm.")
        take_off = page.locator("[data-action=takeoff]")
        expect(take_off).to_have_class("refused")
        assert "Not possible: 1 is in observe, 2 is in observe" in (take_off.get_attribute("title") or "")
        all_in("armed")
        expect(marked).to_have_text("Take off")
        expect(next_step).to_contain_text("within 8 s")
        all_in("observe")
        expect(next_step).to_contain_text("Vehicles 1, 2, 3, 4 disarmed again: no take-off within some 10 s")
        all_in("hold", "in_air")
        expect(marked).to_have_text("Form")
        all_in("formation", "in_air")
        expect(marked).to_have_count(0)
        expect(next_step).to_have_text("")
        all_in("hold", "in_air")  # after an ABORT it is up to the operator
        page.locator("tbody.vehicle[data-id='1']").get_by_text("hold").wait_for()
        expect(marked).to_have_count(0)
        server.change = lambda vs: [replace(v, phase="observe" if v is vs[0] else "takeoff") for v in vs]
        page.locator("tbody.vehicle[data-id='1']").get_by_text("observe").wait_for()
        expect(marked).to_have_count(0)  # one has landed while others fly


def test_a_formation_is_previewed_before_it_can_be_sent(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        page.locator("summary", has_text="Formation").click()
        expect(page.locator("[data-action=send-formation]")).to_have_count(0)
        page.get_by_label("Spacing").fill("1")
        page.locator("[data-action=preview-formation]").click()
        expect(page.locator(".previewed")).to_contain_text("SLOT_TOO_CLOSE")
        expect(page.locator("[data-action=send-formation]")).to_have_count(0)
        page.get_by_label("Spacing").fill("200")
        page.locator("[data-action=preview-formation]").click()
        expect(page.locator(".previewed")).to_contain_text("SLOT_OUTSIDE_FENCE")
        page.get_by_role("button", name="Use 40 m", exact=True).click()
        expect(page.locator("[data-action=send-formation]")).to_have_count(1)
        expect(page.get_by_label("Spacing")).to_have_value("40")
        page.get_by_label("Spacing").fill("3.5")
        expect(page.locator(".previewed")).to_have_count(0)  # it was of other values
        page.locator("[data-action=preview-formation]").click()
        expect(page.locator(".previewed")).to_contain_text("smallest separation on the way 2.81")
        assert server.commands == []
        page.locator("[data-action=send-formation]").click()
        until_shown(page, lambda: bool(server.commands))
        assert server.commands[0].content == {"shape": "line", "spacing_m": 3.5, "heading_deg": 0}


def test_free_slots_begin_with_those_flown_at_the_time(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        page.locator("summary", has_text="Formation").click()
        slots, east = page.get_by_label("Slots"), page.get_by_label("Vehicle 2, east, metres")
        slots.select_option("a slot for each vehicle")
        before = east.input_value()
        slots.select_option("line")
        server.change = lambda vs: [
            replace(v, slot_offset_enu_m=(9.0, 8.0, 7.0)) for v in vs
        ]  # another formation flies
        page.locator("tbody.vehicle[data-id='2']").click()
        expect(page.locator("#details dl div", has_text="Slot offset").locator("dd")).to_have_text("9.00, 8.00, 7.00")
        slots.select_option("a slot for each vehicle")
        expect(east).to_have_value("9.00")
        assert before != "9.00"


def test_the_answer_of_a_preview_comes_into_sight(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url, height=620)
        page.locator("summary", has_text="Formation").click()
        page.locator("[data-action=preview-formation]").click()
        expect(page.locator("[data-action=send-formation]")).to_be_in_viewport(ratio=1.0)


def test_a_reference_is_placed_on_the_map(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        page.locator("summary", has_text="Reference").click()
        page.get_by_label("Kind").select_option("circle")
        page.get_by_label("Altitude").fill("6")
        page.get_by_label("Altitude").blur()
        page.locator("[data-action=place]").click()
        expect(page.locator("#map-note")).to_contain_text("Click a point on the map.")
        page.locator("#scene").click(position={"x": 200, "y": 200})
        expect(page.locator(".points input")).to_have_count(3)
        page.get_by_label("Point 1, E, metres").fill("2.5")
        page.get_by_label("Point 1, N, metres").fill("-1")
        page.get_by_label("Point 1, N, metres").blur()
        page.locator("[data-action=preview-reference]").click()
        expect(page.locator(".previewed .warning")).to_have_text(WARNING)
        page.locator("[data-action=send-reference]").click()
        until_shown(page, lambda: bool(server.commands))
        content = server.commands[0].content
        circle = {"kind": "circle", "centre_enu_m": [2.5, -1, 6], "radius_m": 6, "period_s": 40, "ramp_s": 5}
        assert content == circle


def test_shift_escape_aborts_from_everywhere_when_it_is_held(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        page.locator("summary", has_text="Formation").click()
        page.get_by_label("Spacing").focus()
        page.keyboard.down("Shift")
        page.keyboard.down("Escape")
        expect(page.locator("#banner")).to_contain_text("Keep holding Shift+Escape")
        page.keyboard.up("Escape")
        expect(page.locator("#banner")).not_to_contain_text("Keep holding")
        assert server.commands == []
        page.keyboard.down("Escape")
        until_shown(page, lambda: bool(server.commands))
        page.keyboard.up("Escape")
        page.keyboard.up("Shift")
        assert [(command.name, command.vehicle_ids) for command in server.commands] == [("abort", ())]


def test_the_abort_button_is_held_for_half_a_second_also_before_any_report(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        server.unreachable = ("tcp/192.168.1.10:7447: no answer",)
        page = open_page(server.control_url, width=390, height=844)
        abort = page.locator("#abort")
        expect(abort).to_be_in_viewport()
        abort.click()
        expect(page.locator("#hint")).to_contain_text("Hold ABORT for half a second")
        assert server.commands == []
        abort.hover()
        page.mouse.down()
        page.wait_for_timeout(HELD_MS)
        page.mouse.up()
        until_shown(page, lambda: [(sent.fleet, sent.name) for sent in server.commands] == [("ring", "abort")])
        expect(page.locator("[data-action=hold]")).to_be_disabled()
        expect(page.locator("#control")).to_contain_text("No vehicle reports yet")


def test_an_alarm_is_acknowledged_by_a_page_with_the_token(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        server.alarm(2, "BATTERY_LOW")
        without = open_page(server.url)
        without.locator("[data-alarm='1'] button").click()
        expect(without.locator("#hint")).to_contain_text("Not acknowledged: the token is missing")
        open_page(server.control_url).locator("[data-alarm='1'] button").click()
        expect(without.locator("[data-alarm='1']")).to_contain_text("acknowledged")


def test_without_its_token_the_page_says_how_to_get_control(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.url)
        expect(page.locator("#control")).to_contain_text("without the token")
        expect(page.locator("[data-action]")).to_have_count(0)


def test_a_restarted_server_ends_control_until_its_new_url_is_opened(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        expect(page.locator("[data-action=hold]")).to_be_enabled()
        server.stop()
        port = server.port
    with PageServer(may_control=True, port=port) as server:
        server.token = "of-the-new-start"
        expect(page.locator("#banner .no-control")).to_contain_text("this page commands no vehicle, ABORT included")
        expect(page.locator("[data-action]")).to_have_count(0)
        page.locator("#abort").hover()
        page.mouse.down()
        expect(page.locator("#banner .abort-error")).to_contain_text(
            "ABORT was not sent: the token is missing or wrong"
        )
        page.mouse.up()
        page.goto(server.control_url)  # the same tab: only the part after # differs
        expect(page.locator("[data-action=hold]")).to_be_enabled()
        expect(page.locator("#banner p")).to_have_count(0)
        assert page.url == server.url


def test_a_notice_moves_no_button(open_page: OpenPage) -> None:
    with PageServer(may_control=True) as server:
        page = open_page(server.control_url)
        before = page.locator("[data-action=land]").bounding_box()
        page.locator("[data-action=land]").click()
        expect(page.locator("#hint")).to_contain_text('Hold "Land" for a second')
        assert page.locator("[data-action=land]").bounding_box() == before
        assert server.commands == []
