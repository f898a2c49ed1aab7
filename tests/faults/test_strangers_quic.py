"""Strangers, and a participant at fault, against a flying fleet with QUIC and multicast. `make attacks` runs them."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator
from contextlib import closing
from itertools import count, cycle
from pathlib import Path

import pytest

from companion.types.notices import Code
from fault_table import FaultRow
from processes import free_port
from secured_fleet import (
    IDS,
    MEASURED_S,
    Undisturbed,
    measured,
    publishing,
    running,
    secured_fleet,
    stranger,
    tls_of,
    tls_of_a_stranger,
)

pytestmark = [pytest.mark.fleet, pytest.mark.every_fault, pytest.mark.timeout(240)]

FLOOD_HZ = 10_000
GROUP = "239.255.77.9"
RECORDED = 200


@pytest.fixture(scope="module")
def flying(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Undisturbed]:
    multicast = f"{GROUP}:{free_port(socket.SOCK_DGRAM)}"
    overrides = ("fleet.transport=quic", "links.peer_transport=udp", f"fleet.multicast={multicast}")
    with secured_fleet(tmp_path_factory.mktemp("quic"), *overrides) as fleet:
        yield Undisturbed.of(fleet)


@pytest.mark.parametrize("who", ["no certificate", "foreign authority", "expired certificate"])
def test_a_stranger_is_not_connected(flying: Undisturbed, row: FaultRow, who: str, tmp_path: Path) -> None:
    fleet = flying.fleet
    tls = tls_of_a_stranger(who, fleet, tmp_path)
    with publishing(fleet, [stranger(endpoint, tls) for endpoint in fleet.endpoints()]):
        measured(flying, row, f"QUIC: a stranger with {who} publishes false states, land and abort", "not connected")


def test_a_vehicle_does_not_speak_for_others(flying: Undisturbed, row: FaultRow) -> None:
    fleet = flying.fleet
    tls = tls_of(fleet.identity_folder("vehicle-2"))
    sessions = [stranger(endpoint, tls) for i, endpoint in zip(IDS, fleet.endpoints(), strict=True) if i != 2]
    attack = "QUIC: vehicle 2 publishes states, status, replies and liveliness of others, and commands"
    with publishing(fleet, sessions, ("ground-anna", "vehicle-2")):
        measured(flying, row, attack, "denied by the access control")


def test_a_flood_of_datagrams_delays_nothing(flying: Undisturbed, row: FaultRow) -> None:
    fleet, sent, garbage = flying.fleet, count(), random.Random(1).randbytes(1200)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as attacker, closing(attacker):

        def burst() -> None:
            for number in range(FLOOD_HZ // 50):
                next(sent)
                attacker.sendto(garbage, ("127.0.0.1", fleet.port(IDS[number % len(IDS)])))

        with running(burst, 0.02):
            measured(flying, row, "QUIC: a stranger sends garbage to the ports of all agents", "dropped")
    row.measured.append(f"{next(sent) / MEASURED_S:.0f} datagrams a second sent")


@pytest.mark.parametrize(("changed", "outcome"), [(0, "old: not used"), (1, "the tag is wrong")])
def test_recorded_datagrams_have_no_effect(flying: Undisturbed, row: FaultRow, changed: int, outcome: str) -> None:
    fleet, multicast = flying.fleet, flying.fleet.scenario.fleet.multicast
    assert multicast is not None
    group = (GROUP, int(multicast.rpartition(":")[2]))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as attacker:
        attacker.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        own = socket.inet_aton("127.0.0.1")
        attacker.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + own)
        attacker.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, own)
        attacker.bind(group)
        attacker.settimeout(5.0)
        recorded = [attacker.recv(4096) for _ in range(RECORDED)]
        false = [datagram[:-1] + bytes((datagram[-1] ^ changed,)) for datagram in recorded]
        again = cycle(false)

        def replay() -> None:
            for _ in range(40):
                attacker.sendto(next(again), group)

        attack = "multicast: the fleet's own datagrams, recorded and sent again" + (", with one bit changed" * changed)
        with running(replay, 0.02):
            measured(flying, row, attack, outcome)
    refused = Code.PEER_NOT_AUTHENTICATED if changed else Code.PEER_OUT_OF_ORDER
    assert any(key.startswith(refused) for key in fleet.ground.newest[1].rejected), fleet.ground.newest[1].rejected
