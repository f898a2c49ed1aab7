"""What strangers, and participants at fault, can do to a flying fleet with identities. Real agents, TLS, real sockets.

`make attacks` writes the table of docs/attacks.md.
"""

from __future__ import annotations

import random
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

import pytest
import zenoh

from common import until
from companion.ground.commands import statuses_of
from companion.ground.session import FleetSession
from companion.security.provisioning import revoke
from companion.types.commands import CommandName
from companion.wire.keys import peer_key
from fault_table import FaultRow
from live_site import monitor, snapshot
from processes import companion
from secured_fleet import (
    IDS,
    MEASURED_S,
    SecuredFleet,
    Undisturbed,
    measured,
    publishing,
    running,
    secured_fleet,
    stranger,
    tls_of,
    tls_of_a_stranger,
)

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(240)]

FLOOD_HZ = 10_000
SILENT_CONNECTIONS, BEGUN_HANDSHAKES = 3000, 600
GIVEN_UP_AFTER_S = 10.0  # a TLS handshake that Zenoh has begun; it pauses 0.1 s after each
BACK_WITHIN_S = 5.0
NEW_SESSION_WITHIN_S = 120.0  # after an attack on the listeners


@pytest.fixture(scope="module")
def flying(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Undisturbed]:
    with secured_fleet(tmp_path_factory.mktemp("secured")) as fleet:
        yield Undisturbed.of(fleet)


@pytest.mark.parametrize(
    "who",
    [
        "no certificate",
        "foreign authority",
        *(pytest.param(who, marks=pytest.mark.every_fault) for who in ("expired certificate", "plain TCP")),
    ],
)
def test_a_stranger_is_not_connected(flying: Undisturbed, row: FaultRow, who: str, tmp_path: Path) -> None:
    fleet = flying.fleet
    tls, protocol = ({}, "tcp") if who == "plain TCP" else (tls_of_a_stranger(who, fleet, tmp_path), "tls")
    sessions = [stranger(endpoint, tls) for endpoint in fleet.endpoints(protocol)]
    with publishing(fleet, sessions):
        measured(flying, row, f"a stranger with {who} publishes false states, land and abort", "not connected")


@pytest.mark.parametrize(
    ("who", "attack"),
    [
        ("vehicle-2", "vehicle 2 publishes states, status, replies and liveliness of others, and commands"),
        ("monitor-tower", "a monitor publishes states and commands"),
        ("traffic-adsb", "a source of traffic publishes states and commands"),
        pytest.param(
            "mocap-hall", "a motion-capture system publishes states and commands", marks=pytest.mark.every_fault
        ),
    ],
)
def test_a_participant_does_not_speak_for_others(flying: Undisturbed, row: FaultRow, who: str, attack: str) -> None:
    fleet, own = flying.fleet, who.rpartition("-")[2]
    sessions = [
        stranger(endpoint, tls_of(fleet.identity_folder(who)))
        for i, endpoint in zip(IDS, fleet.endpoints(), strict=True)
        if str(i) != own
    ]
    if who == "vehicle-2":  # under its own key its states count as those of a duplicate id
        rejected = {i: dict(fleet.ground.newest[i].rejected) for i in IDS}
    with publishing(fleet, sessions, ("ground-anna", who)):
        measured(flying, row, attack, "denied by the access control")
    if who == "vehicle-2":
        for i in (1, 3, 4):
            others = [key for key in fleet.ground.newest[i].rejected if key.endswith((" 1", " 3", " 4"))]
            assert all(fleet.ground.newest[i].rejected[key] <= rejected[i].get(key, 0) + 5 for key in others)


def test_a_recorded_connection_has_no_effect(flying: Undisturbed, row: FaultRow) -> None:
    fleet, recorded = flying.fleet, bytearray()
    with (
        relay(fleet.port(1), recorded) as port,
        FleetSession("*", [f"tls/127.0.0.1:{port}"], identity=fleet.identity("ground-ben")) as ben,
    ):
        answered = ben.command([1], CommandName.HOLD, 5.0)[1]
        assert answered is not None  # refused: anna holds command
        assert not answered.accepted
    assert len(recorded) > 1000

    def replay() -> None:
        with suppress(OSError), socket.create_connection(("127.0.0.1", fleet.port(1)), 1.0) as connection:
            connection.sendall(recorded)

    with running(replay, 0.2):
        measured(flying, row, "the recorded bytes of a ground's connection, sent again", "the handshake fails")


@contextmanager
def relay(port: int, recorded: bytearray) -> Iterator[int]:
    """A TCP relay to a port of this machine that keeps what the client sends."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with suppress(OSError):
                client, _ = server.accept()
                there = socket.create_connection(("127.0.0.1", port))
                threading.Thread(target=copy, args=(there, client, bytearray()), daemon=True).start()
                copy(client, there, recorded)

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[1]


def copy(source: socket.socket, target: socket.socket, kept: bytearray) -> None:
    with suppress(OSError):
        while data := source.recv(65536):
            kept += data
            target.sendall(data)
        target.close()


def test_a_flood_from_inside_displaces_nothing(flying: Undisturbed, row: FaultRow) -> None:
    fleet = flying.fleet
    sessions = [stranger(endpoint, tls_of(fleet.identity_folder("vehicle-4"))) for endpoint in fleet.endpoints()[:3]]
    key, garbage = peer_key(fleet.scenario.fleet.name, 4), random.Random(1).randbytes(200)
    sent = count()

    def burst() -> None:
        for _ in range(FLOOD_HZ // 50 // len(sessions)):
            for session in sessions:
                next(sent)
                session.put(key, garbage, congestion_control=zenoh.CongestionControl.DROP)

    with ExitStack() as stack:
        for session in sessions:
            stack.enter_context(closing(session))
        stack.enter_context(running(burst, 0.02))
        measured(
            flying, row, "vehicle 4 floods the others with garbage, up to 10,000 messages a second", "its queue alone"
        )
    row.measured.append(f"{next(sent) / MEASURED_S:.0f} messages a second sent")


def test_a_revoked_ground_is_not_obeyed(flying: Undisturbed, row: FaultRow) -> None:
    fleet = flying.fleet
    with FleetSession("*", fleet.endpoints(), identity=fleet.identity("ground-ben")) as ben:
        assert len(statuses_of(ben.newest, IDS, NEW_SESSION_WITHIN_S)) == len(IDS)
        revoke(fleet.keys, ["ground-ben"], datetime.now(UTC))
        data = (fleet.keys / "authority" / "admitted.json").read_bytes()
        number = max(status.network.admission or 0 for status in fleet.ground.newest.values())
        began_s = time.monotonic()
        while not all((status.network.admission or 0) > number for status in fleet.ground.newest.values()):
            assert time.monotonic() < began_s + 30.0
            fleet.session.send_admission_list(data)
            fleet.ground.listen(0.5)
        effective_s = time.monotonic() - began_s
        taken = ben.command(IDS, CommandName.TAKE, 2.0)
        assert set(taken.values()) == {None}, taken
        measured(flying, row, "a revoked ground, still connected, takes command", "not used, not answered")
        row.measured.append(f"effective at all vehicles after {effective_s:.1f} s")


def test_the_live_page_shows_the_fleet_by_its_identity_and_a_monitor_may_not_command(flying: Undisturbed) -> None:
    fleet = flying.fleet
    reached = ("--connect", *fleet.endpoints(), "--fleet-file", str(fleet.folder / "fleet.yaml"))
    tower = ("--identity", str(fleet.identity_folder("monitor-tower")))
    with monitor(*reached, *tower) as (_, url):
        until(lambda: [v["phase"] for v in snapshot(url)["vehicles"]] == ["formation"] * len(IDS))
        assert {v["network"]["security"] for v in snapshot(url)["vehicles"]} == {"identity"}
    refused = companion("monitor", *reached, *tower, "--control")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "--control: monitor-tower may not command; expected the identity of a ground" in refused.stderr


def test_failing_handshakes_keep_only_new_sessions_out(flying: Undisturbed, row: FaultRow) -> None:
    fleet = flying.fleet

    def churn() -> None:
        for i in IDS:
            with suppress(OSError), socket.create_connection(("127.0.0.1", fleet.port(i)), 0.5) as connection:
                connection.sendall(b"\x16\x03\x01garbage")

    with running(churn, 0.02):
        outcome = "established sessions are not affected; new ones wait until it ends"
        measured(flying, row, "50 failing handshakes a second at every agent", outcome)
    # Zenoh 1.10 accepts one connection after the other and pauses 0.1 s after each that failed.
    began_s = time.monotonic()
    with FleetSession("*", fleet.endpoints(), identity=fleet.identity("monitor-tower")) as tower:
        assert len(statuses_of(tower.newest, IDS, NEW_SESSION_WITHIN_S)) == len(IDS)
    row.measured.append(f"a new session {time.monotonic() - began_s:.1f} s after its end")


def test_silent_connections_hold_nothing_up(flying: Undisturbed, row: FaultRow) -> None:
    """Nor a participant that connects while they are there, when handshakes end that were begun, or when they end."""
    fleet, began_s = flying.fleet, time.monotonic()
    with ExitStack() as stack:
        for number in range(SILENT_CONNECTIONS):
            address = ("127.0.0.1", fleet.port(IDS[number % len(IDS)]))
            stack.enter_context(socket.create_connection(address, 5.0))
        measured(flying, row, f"{SILENT_CONNECTIONS} connections that send nothing", "no effect")
        fleet.ground.listen(max(0.0, began_s + GIVEN_UP_AFTER_S + 1.0 - time.monotonic()))
        row.measured.append(f"a new session meanwhile {new_session_s(fleet):.1f} s")
    row.measured.append(f"{new_session_s(fleet):.1f} s after their end")


def test_begun_handshakes_hold_nothing_up(flying: Undisturbed, row: FaultRow) -> None:
    """Nor when Zenoh would give them up. Those that are broken off count as failing ones."""
    fleet, began_s, hello = flying.fleet, time.monotonic(), client_hello()
    with ExitStack() as stack:
        for number in range(BEGUN_HANDSHAKES):
            address = ("127.0.0.1", fleet.port(IDS[number % len(IDS)]))
            stack.enter_context(socket.create_connection(address, 5.0)).sendall(hello)
        measured(flying, row, f"{BEGUN_HANDSHAKES} TLS handshakes that are begun and do not go on", "no effect")
        fleet.ground.listen(max(0.0, began_s + GIVEN_UP_AFTER_S + 1.0 - time.monotonic()))
        row.measured.append(f"a new session meanwhile {new_session_s(fleet):.1f} s")


def new_session_s(fleet: SecuredFleet) -> float:
    """How long a monitor that connects now waits for the first report of the last vehicle."""
    connects_s = time.monotonic()
    with FleetSession("*", fleet.endpoints(), identity=fleet.identity("monitor-tower")) as tower:
        assert len(statuses_of(tower.newest, IDS, BACK_WITHIN_S)) == len(IDS)
    return time.monotonic() - connects_s


def client_hello() -> bytes:
    """The first bytes of a client, to which the server answers and then waits."""
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    with suppress(ssl.SSLWantReadError):
        ssl.create_default_context().wrap_bio(incoming, outgoing, server_hostname="vehicle").do_handshake()
    return outgoing.read()


def test_abort_is_answered_in_the_end(flying: Undisturbed) -> None:
    answers = flying.fleet.session.ask(IDS, CommandName.ABORT, 5.0)
    assert all(answer is not None and answer.reply.accepted for answer in answers.values()), answers
