"""Commands over HTTP, Zenoh and the links of agents, and back."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable

import pytest
from aiohttp import ClientSession, TCPConnector, WSServerHandshakeError
from msgspec.structs import replace

from common import with_fields
from companion.config.fleet import FleetConfig
from companion.ground.changes import FleetAction
from companion.ground.commands import check_content
from companion.ground.reports import Check
from companion.ground.session import FleetSession
from companion.monitor.access import MOST_OF_ADDRESS
from companion.monitor.api import LIVE_PROTOCOL, TOKEN_HEADER, TOKEN_PROTOCOL
from companion.monitor.commander import readiness_view
from companion.types.commands import Command, CommandName, CommandReply
from companion.types.formation import FlownSlot, FormationChange
from companion.types.notices import Code
from companion.wire.messages import StatusReport
from ground_fleet import LinkedVehicles, accept, linked_vehicles
from live_site import TOKEN, Served, served_live, until_served
from tests.bench.monitor_load import SteadyFleet


def with_fleet(work: Callable[[Served, LinkedVehicles], Awaitable[None]]) -> None:
    async def run(vehicles: LinkedVehicles) -> None:
        async with served_live(vehicles) as server:
            await until_served(lambda: all_report(server))
            await work(server, vehicles)

    with linked_vehicles() as vehicles:
        asyncio.run(run(vehicles))


async def all_report(server: Served) -> bool:
    snapshot = (await server.get("/api/v1/snapshot"))[1]
    return len([v for v in snapshot["vehicles"] if not v["silent"]]) == 3


def refuse(vehicle_id: int, command: Command) -> CommandReply:
    return CommandReply(vehicle_id, command.number, False, Code.WRONG_PHASE, "not now", command.operator)


@pytest.mark.parametrize("token", [None, "", "wrong", TOKEN + "x", TOKEN.upper()])
def test_no_command_without_the_token(token: str | None) -> None:
    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        headers = {} if token is None else {TOKEN_HEADER: token}
        for path in ("commands", "preview"):
            status, answer = await server.post(f"/api/v1/{path}", {"fleet": "load", "name": "abort"}, **headers)
            assert (status, "token" in answer["error"]) == (403, True)
        assert (await server.get("/api/v1/snapshot"))[1]["commands"] == "load"
        assert vehicles.commands == []

    with_fleet(work)


def test_strangers_with_sockets_shut_out_neither_the_operator_nor_another_address() -> None:
    async def work(server: Served, _vehicles: LinkedVehicles) -> None:
        live, offered = f"{server.url}/api/v1/live", (LIVE_PROTOCOL, TOKEN_PROTOCOL + TOKEN)
        async with ClientSession() as http, ClientSession(connector=TCPConnector(local_addr=("127.0.0.2", 0))) as other:
            opened = await asyncio.gather(*(http.ws_connect(live) for _ in range(100)), return_exceptions=True)
            strangers = [one for one in opened if not isinstance(one, BaseException)]
            assert len(strangers) == MOST_OF_ADDRESS
            with pytest.raises(WSServerHandshakeError, match="503"):
                await http.ws_connect(live, protocols=(LIVE_PROTOCOL, TOKEN_PROTOCOL + "wrong"))
            status, answer = await server.get("/api/v1/live")  # as the page asks for the reason
            assert (status, "open the URL that companion monitor printed" in answer["error"]) == (503, True)
            async with other.ws_connect(live) as beside, http.ws_connect(live, protocols=offered) as of_page:
                assert (await beside.receive_json())["type"] == "snapshot"
                assert (await of_page.receive_json())["type"] == "snapshot"
                assert of_page.protocol == LIVE_PROTOCOL  # a browser takes no connection that chooses none
            async with http.ws_connect(live, headers={TOKEN_HEADER: TOKEN}) as of_program:
                assert (await of_program.receive_json())["type"] == "snapshot"
            await strangers[0].close()
            await until_served(lambda: has_place(server))

    with_fleet(work)


async def has_place(server: Served) -> bool:
    return (await server.get("/api/v1/live"))[0] == 426


def test_an_alarm_is_acknowledged_only_with_the_token() -> None:
    async def work(server: Served, _vehicles: LinkedVehicles) -> None:
        path = "/api/v1/alarms/999/acknowledge"
        assert (await server.post(path, {}))[0] == 403
        assert (await server.post(path, {}, **{TOKEN_HEADER: TOKEN}))[0] == 404  # there is no such alarm

    with_fleet(work)


@pytest.mark.parametrize("token", [b"\xff", "\u00e4".encode()])
def test_a_token_that_is_no_plain_text_is_refused(token: bytes) -> None:
    async def work(server: Served, _vehicles: LinkedVehicles) -> None:
        lines = ["POST /api/v1/commands HTTP/1.1", "Content-Length: 0"]
        status, answer = await server.raw(lines, TOKEN_HEADER.encode() + b": " + token)
        assert (status, answer["error"].split()[0]) == (400, f"{TOKEN_HEADER}:")

    with_fleet(work)


def test_a_body_that_is_not_encoded_as_it_says_is_refused() -> None:
    async def work(server: Served, _vehicles: LinkedVehicles) -> None:
        lines = ["POST /api/v1/commands HTTP/1.1", "Content-Type: application/json", "Content-Encoding: gzip"]
        header = f"{TOKEN_HEADER}: {TOKEN}\r\nContent-Length: 3\r\n\r\nabc"
        status, answer = await server.raw(lines, header.encode())
        assert (status, "Content-Encoding" in answer["error"]) == (400, True)

    with_fleet(work)


def test_the_timeline_has_the_answers_to_other_programs_of_this_operator_once() -> None:
    """Those to a command of the page are logged with it. Vehicle 2 answers `hold` when the page has stopped to wait."""
    held: list[Command] = []

    def answer(vehicle_id: int, command: Command) -> CommandReply | None:
        if vehicle_id == 2 and command.name == "hold":
            held.append(command)
            return None
        if vehicle_id == 2 and command.name == "take" and held:
            return accept(2, held.pop())
        return accept(vehicle_id, command)

    async def answers(server: Served) -> list[int]:
        events = (await server.get("/api/v1/history"))[1]["events"]
        return sorted(e["vehicle_id"] for e in events if e["kind"] == "answer")

    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        vehicles.answer = answer
        with FleetSession("load", vehicles.endpoints, "anna@ground") as program:
            await asyncio.to_thread(program.command, [1, 3], CommandName.LAND, 5.0)
        await until_served(lambda: equal(answers(server), [1, 3]))
        await server.command("hold", ids=(1, 2))
        assert await answers(server) == [1, 1, 2, 3]  # vehicle 2: no reply
        held[:] = held[-1:]
        await server.command("take", ids=(2,))
        await until_served(lambda: equal(answers(server), [1, 1, 2, 2, 2, 3]))

    async def equal(found: Awaitable[list[int]], expected: list[int]) -> bool:
        return await found == expected

    with_fleet(work)


def test_a_command_reaches_the_vehicles_named_and_their_answers_come_back() -> None:
    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        vehicles.answer = lambda i, command: refuse(i, command) if i == 2 else accept(i, command)
        result = await server.command("hold", ids=(1, 2))
        assert [(a["vehicle_id"], a["kind"], a["code"]) for a in result["answers"]] == [
            (1, "accepted", "PHASE_CHANGED"),
            (2, "refused", "WRONG_PHASE"),
        ]
        assert all(a["after_ms"] > 0.0 for a in result["answers"])
        assert vehicles.received("hold") == [1, 2]
        assert {command.operator for _, command in vehicles.commands} == {"anna@ground"}
        events = (await server.get("/api/v1/history"))[1]["events"]
        assert [(e["kind"], e["vehicle_id"]) for e in events if e["kind"] in ("command", "answer")] == [
            ("command", None),
            ("answer", 1),
            ("answer", 2),
        ]

    with_fleet(work)


def test_every_change_is_sent_with_its_content() -> None:
    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        result = await server.command("leader", {"leader_ids": [1]})
        assert result["error"] == ""
        result = await server.command("formation", {"shape": "line", "spacing_m": 4.0})
        assert result["error"] == ""
        point = [10.0, 0.0, 10.0]
        result = await server.command("reference", {"kind": "point", "point_enu_m": point})
        assert result["error"] == ""
        assert vehicles.received("lead") == [1, 2, 3]
        assert vehicles.received("formation") == [1, 2, 3]
        assert vehicles.received("reference") == [1]  # the only one that may lead
        contents = {command.name: command.content for _, command in vehicles.commands}
        assert contents["reference"].reference["point_enu_m"] == point  # type: ignore[union-attr]

    with_fleet(work)


def test_what_the_ground_refuses_is_not_sent() -> None:
    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        for name, content, words in (
            ("formation", {"shape": "line", "spacing_m": 0.1}, "separation_m"),
            ("reference", {"kind": "point", "point_enu_m": [0.0, 0.0, 900.0]}, "outside the fence"),
            ("leader", {"leader_ids": [77]}, "not in the fleet"),
        ):
            result = await server.command(name, content)
            assert words in result["error"]
            assert "\n" not in result["error"]
        result = await server.command("takeoff")  # they are in formation
        assert {(a["kind"], a["code"]) for a in result["answers"]} == {("not sent", "WRONG_PHASE")}
        assert vehicles.commands == []

    with_fleet(work)


class _Far:
    """The fleet, but vehicle 2 reports a slot whose square is no number."""

    def __init__(self, load: SteadyFleet) -> None:
        self.fleet, self._load = load.fleet, load

    def report(self, vehicle_id: int, time_s: float) -> StatusReport:
        report = self._load.report(vehicle_id, time_s)
        slot = FlownSlot((1e200 if vehicle_id == 2 else 0.0, 4.0 * vehicle_id, 0.0))
        return replace(report, status=with_fields(report.status, slot=slot))


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("formation", {"shape": "line", "spacing_m": 4.0}),
        ("reference", {"kind": "point", "point_enu_m": [0.0, 0.0, 10.0]}),
    ],
)
def test_a_report_that_cannot_be_computed_with_prevents_no_command(name: str, content: dict[str, object]) -> None:
    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        vehicles.load = _Far(vehicles.load)  # type: ignore[assignment]
        await until_served(lambda: far(server))
        assert (await server.command(name, content))["error"] == ""
        wanted = {"fleet": "load", "name": name, "content": content}
        status, answer = await server.post("/api/v1/preview", wanted, **{TOKEN_HEADER: TOKEN})
        assert (status, answer["refused"]) == (200, "")
        assert 1 in vehicles.received(name)

    async def far(server: Served) -> bool:
        views = (await server.get("/api/v1/snapshot"))[1]["vehicles"]
        return any(v["slot_offset_enu_m"][0] == 1e200 for v in views)

    with_fleet(work)


def test_doctor_has_the_checks_of_each_vehicle_and_sends_nothing() -> None:
    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        result = await server.command("doctor", ids=(1, 3))
        assert [(a["vehicle_id"], a["kind"]) for a in result["answers"]] == [(1, "ready"), (3, "ready")]
        assert vehicles.commands == []

    with_fleet(work)


def test_abort_goes_out_at_once_and_ends_the_command_under_way() -> None:
    """No vehicle answers `hold`: its sender repeats it. The abort is answered meanwhile, and hold is not repeated after it."""
    asked, aborted = threading.Event(), threading.Event()
    late: list[Command] = []

    def answer(vehicle_id: int, command: Command) -> CommandReply | None:
        if command.name == "abort":
            aborted.set()
            return accept(vehicle_id, command)
        if aborted.is_set() and asked.is_set():
            late.append(command)
        asked.set()
        return None

    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        vehicles.answer = answer
        holding = asyncio.create_task(server.command("hold"))
        await asyncio.to_thread(asked.wait, 10.0)
        refused = await server.command("disarm")
        assert refused["error"] == "hold is being sent; wait for its answers"
        result = await server.command("abort")
        assert [a["kind"] for a in result["answers"]] == ["accepted"] * 3
        assert vehicles.received("abort") == [1, 2, 3]
        held = await holding
        assert "ended by abort" in held["error"]
        assert {(a["kind"], a["text"]) for a in held["answers"]} == {("missing", "no reply before abort")}
        late.clear()
        vehicles.answer = lambda i, command: late.append(command) or accept(i, command)  # type: ignore[func-returns-value]
        assert (await server.command("form"))["error"] == ""  # and the next command is sent
        assert {command.name for command in late} == {"form"}
        assert vehicles.received("disarm") == []

    with_fleet(work)


@pytest.mark.parametrize("urgent", ["hold", "land"])
def test_hold_and_land_end_the_command_under_way(urgent: str) -> None:
    """Vehicle 2 does not answer `disarm`; the other answers are kept."""
    asked = threading.Event()

    def answer(vehicle_id: int, command: Command) -> CommandReply | None:
        if command.name == "disarm" and vehicle_id == 2:
            asked.set()
            return None
        return accept(vehicle_id, command)

    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        vehicles.answer = answer
        disarming = asyncio.create_task(server.command("disarm"))
        await asyncio.to_thread(asked.wait, 10.0)
        result = await server.command(urgent)
        assert (result["error"], [a["kind"] for a in result["answers"]]) == ("", ["accepted"] * 3)
        disarmed = await disarming
        assert f"ended by {urgent}" in disarmed["error"]
        assert [(a["vehicle_id"], a["kind"]) for a in disarmed["answers"] if a["vehicle_id"] == 2] == [(2, "missing")]
        events = (await server.get("/api/v1/history"))[1]["events"]
        assert [e["code"] for e in events if "ended by" in e["text"]] == ["NO_REPLY"]

    with_fleet(work)


def test_land_ends_a_hold_of_the_same_vehicles_but_not_one_of_others_too() -> None:
    """Vehicle 3 does not answer `hold`."""
    asked = threading.Event()

    def answer(vehicle_id: int, command: Command) -> CommandReply | None:
        if command.name == "hold" and vehicle_id == 3:
            asked.set()
            return None
        return accept(vehicle_id, command)

    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        vehicles.answer = answer
        holding = asyncio.create_task(server.command("hold"))
        await asyncio.to_thread(asked.wait, 10.0)
        async with asyncio.timeout(2.0):  # hold would wait for 3 s
            assert (await server.command("land"))["error"] == ""
        assert "ended by land" in (await holding)["error"]
        asked.clear()
        holding = asyncio.create_task(server.command("hold"))
        await asyncio.to_thread(asked.wait, 10.0)
        assert (await server.command("land", ids=(2,)))["error"] == ""
        held = await holding
        assert (held["error"], [a["kind"] for a in held["answers"]]) == ("", ["accepted", "accepted", "missing"])
        assert [c.name for i, c in vehicles.commands if i == 2] == ["hold", "land", "hold", "land"]

    with_fleet(work)


def test_hold_does_not_wait_for_the_check_of_a_formation(monkeypatch: pytest.MonkeyPatch) -> None:
    """That loads scipy. Afterwards the formation is not sent: hold has ended it."""
    begun, loaded = threading.Event(), threading.Event()

    def check(wanted: FleetAction, fleet: FleetConfig) -> None:
        if wanted.formation:
            begun.set()
            loaded.wait(10.0)
        check_content(wanted, fleet)

    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        changing = asyncio.create_task(server.command("formation", {"shape": "line", "spacing_m": 4.0}))
        await asyncio.to_thread(begun.wait, 10.0)
        assert (await server.command("hold"))["error"] == ""
        assert not changing.done()
        loaded.set()
        assert "ended by hold" in (await changing)["error"]
        assert {command.name for _, command in vehicles.commands} == {"hold"}

    monkeypatch.setattr("companion.monitor.commander.check_content", check)
    with_fleet(work)


def test_scipy_is_not_loaded_in_the_event_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes seconds on a small computer; meanwhile no ABORT would go out."""
    threads: list[str] = []

    def check(*arguments: object) -> None:
        threads.append(threading.current_thread().name)
        check_content(*arguments)  # type: ignore[arg-type]

    async def work(server: Served, _vehicles: LinkedVehicles) -> None:
        wanted = {"fleet": "load", "name": "formation", "content": {"shape": "line", "spacing_m": 4.0}}
        await server.post("/api/v1/preview", wanted, **{TOKEN_HEADER: TOKEN})
        await server.command("formation", {"shape": "line", "spacing_m": 4.0})
        assert [name.rstrip("_0123456789") for name in threads] == ["preview", "preview"]

    monkeypatch.setattr("companion.monitor.commander.check_content", check)
    with_fleet(work)


def test_abort_needs_no_report_and_misses_no_vehicle_that_is_silent() -> None:
    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        vehicles.silent = {1, 2, 3}
        await until_served(lambda: none_reports(server))
        result = await server.command("abort")
        assert [a["kind"] for a in result["answers"]] == ["accepted"] * 3
        missing = await server.command("hold")
        assert {a["kind"] for a in missing["answers"]} == {"missing"}

    with_fleet(work)


async def none_reports(server: Served) -> bool:
    return all(v["silent"] for v in (await server.get("/api/v1/snapshot"))[1]["vehicles"])


def test_doctor_tells_warnings_of_a_vehicle_that_is_ready() -> None:
    checks = [Check("origin", (), ("in the fleet frame",)), Check("battery", (), ("unknown",), (Code.BATTERY_UNKNOWN,))]
    answer = readiness_view(2, checks)
    assert (answer.kind, answer.code, answer.text) == ("ready, with warnings", "BATTERY_UNKNOWN", "battery: unknown")
    assert readiness_view(2, checks[:1]).kind == "ready"
    failed = readiness_view(2, [Check("peers", (Code.PEER_STALE,), ("no fresh report",)), *checks])
    assert (failed.kind, failed.code) == ("not ready", "PEER_STALE")


def test_a_preview_has_the_vehicles_own_answers_and_what_they_would_accept() -> None:
    def refuse_wide(vehicle_id: int, check: Command) -> CommandReply:
        assert isinstance(check.content, FormationChange)
        width_m = max(abs(slot[1]) for _, slot in check.content.slots_enu_m)
        if vehicle_id == 1 or width_m < 40.01:
            return CommandReply(vehicle_id, check.number, True, Code.CHECK_PASSED, "would be accepted", check.operator)
        accepts = (("scale", 40.0 / width_m),)
        code = Code.SLOT_OUTSIDE_FENCE
        return CommandReply(vehicle_id, check.number, False, code, "formation: too wide", check.operator, accepts)

    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        vehicles.answer_check = refuse_wide
        content = {"shape": "line", "spacing_m": 200.0}
        wanted = {"fleet": "load", "name": "formation", "content": content}
        _, answer = await server.post("/api/v1/preview", wanted, **{TOKEN_HEADER: TOKEN})
        assert answer["refused"] == "vehicles 2, 3: SLOT_OUTSIDE_FENCE: formation: too wide"
        assert [one["kind"] for one in answer["answers"]] == ["accepted", "refused", "refused"]
        assert answer["instead"] == {"spacing_m": 40.0}
        content |= answer["instead"]
        _, answer = await server.post("/api/v1/preview", wanted, **{TOKEN_HEADER: TOKEN})
        assert (answer["refused"], answer["instead"]) == ("", {})
        assert [one["kind"] for one in answer["answers"]] == ["accepted"] * 3
        assert vehicles.commands == []

    with_fleet(work)


def test_a_preview_sends_nothing() -> None:
    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        headers = {TOKEN_HEADER: TOKEN}
        wanted = {"fleet": "load", "name": "formation", "content": {"shape": "v", "spacing_m": 4.0}}
        status, answer = await server.post("/api/v1/preview", wanted, **headers)
        assert (status, len(answer["paths"]), answer["refused"]) == (200, 3, "")
        status, answer = await server.post("/api/v1/preview", {"fleet": "load", "name": "land"}, **headers)
        assert (status, "no preview" in answer["refused"]) == (200, True)
        assert vehicles.commands == []

    with_fleet(work)


@pytest.mark.parametrize(
    "body", [b"", b"{}", b"[1]", b'{"fleet":"load"}', b'{"fleet":"load","name":1}', b"\xff", b"[" * 9000]
)
def test_a_body_that_is_no_request_is_refused_in_one_line(body: bytes) -> None:
    async def work(server: Served, vehicles: LinkedVehicles) -> None:
        headers = {TOKEN_HEADER: TOKEN, "Content-Type": "application/json"}
        async with server.http.post(server.url + "/api/v1/commands", data=body, headers=headers) as response:
            assert response.status == 400
            assert "CommandRequest" in (await response.json())["error"]
        headers["Content-Type"] = "text/plain"  # what another page may send without asking
        async with server.http.post(server.url + "/api/v1/commands", data=body, headers=headers) as response:
            assert response.status == 415
        headers["Content-Type"] = "application/json"
        async with server.http.post(server.url + "/api/v1/commands", data=b" " * 70_000, headers=headers) as response:
            assert response.status == 413
        assert vehicles.commands == []

    with_fleet(work)
