"""Attacks on a fleet in flight with identities, and what must hold meanwhile."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from datetime import timedelta
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import zenoh
from msgspec.structs import replace

from companion.types.commands import Command, CommandName
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.peers import PeerPacket
from companion.wire.keys import abort_key, command_key, peer_key, reply_key, status_key
from companion.wire.messages import encode
from companion.wire.peer import encode_peer
from fault_table import FaultRow
from identities import tls_of
from secured_fleet import IDS, OTHERS, SecuredFleet
from sitl.flight.identities import identity_folder, provision

MEASURED_S = 3.0
LARGEST_ERROR_M = 0.1  # more than in undisturbed flight
DEMANDED = "in formation, error 0.1 m at most above the undisturbed one, operator answered"
FAR_M = (30.0, 30.0, 5.0)


@dataclass(frozen=True)
class Undisturbed:
    """A fleet in formation and its error before any attack."""

    fleet: SecuredFleet
    error_m: float

    @classmethod
    def of(cls, fleet: SecuredFleet) -> Undisturbed:
        """Measured now."""
        since_s = time.monotonic()
        fleet.ground.listen(MEASURED_S)
        return cls(fleet, fleet.largest_error_m(since_s))


def false_messages(fleet: SecuredFleet, operators: tuple[str, ...]) -> Iterator[tuple[str, bytes]]:
    """Packets that put every vehicle 30 m away, and `land` and `abort` to all, under the keys of all."""
    name, formation_hash = fleet.scenario.fleet.name, next(iter(fleet.ground.newest.values())).formation_hash
    sessions = {i: status.session for i, status in fleet.ground.newest.items()}
    packet = PeerPacket(
        1, 1, 1, formation_hash, FlightPhase.FORMATION, Role.FOLLOWER, FAR_M, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0, 2,
        None, FlownSlot((0.0, 0.0, 0.0)),
    )  # fmt: skip
    for number in count(1):
        for i in IDS:
            false = replace(packet, vehicle_id=i, session=sessions[i], sequence=10**6 + number, sent_s=time.monotonic())
            yield peer_key(name, i), encode_peer(false)
            yield status_key(name, i), b"\x08nonsense"
            yield reply_key(name, i), b"\x08nonsense"
            for operator in operators:
                land = Command(CommandName.LAND, 900 + number % 90, operator, sessions[i])
                yield command_key(name, i, operator), encode(land)
                yield abort_key(name, i, operator), encode(replace(land, name=CommandName.ABORT))


@contextmanager
def running(attack: Callable[[], object], period_s: float) -> Iterator[None]:
    """Calls the attack again and again in a thread."""
    stop = threading.Event()

    def repeat() -> None:
        while not stop.wait(period_s):
            attack()

    thread = threading.Thread(target=repeat)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@contextmanager
def publishing(
    fleet: SecuredFleet, sessions: list[zenoh.Session], operators: tuple[str, ...] = ("ground-anna", "mallory")
) -> Iterator[None]:
    """These sessions publish false messages, and liveliness tokens for all vehicles."""
    messages = false_messages(fleet, operators)

    def some() -> None:
        for _ in range(44):
            key, payload = next(messages)
            for session in sessions:
                session.put(key, payload, congestion_control=zenoh.CongestionControl.DROP)

    with ExitStack() as stack:
        for session in sessions:
            stack.enter_context(closing(session))
            for i in IDS:
                session.liveliness().declare_token(peer_key(fleet.scenario.fleet.name, i))
        stack.enter_context(running(some, 0.02))
        yield


def measured(flying: Undisturbed, row: FaultRow, attack: str, outcome: str) -> None:
    """Let the attack run; then the fleet must be in formation, with all ticks, and the operator heard."""
    fleet = flying.fleet
    row.fault, row.demanded, row.outcome = attack, DEMANDED, outcome
    fleet.ground.received.clear()
    since_s = time.monotonic()
    fleet.ground.listen(MEASURED_S)
    error_m = fleet.largest_error_m(since_s)
    gaps_s = _gaps_s(fleet)
    began_s = time.monotonic()
    taken = fleet.session.command(IDS, CommandName.TAKE, 3.0)
    answered_s = time.monotonic() - began_s
    row.measured.append(f"error {error_m:.2f} m, {flying.error_m:.2f} m undisturbed")
    row.measured.append(f"longest time between two reports {gaps_s:.2f} s")
    row.measured.append(f"operator answered by all after {answered_s:.2f} s")
    assert fleet.ground.phases(IDS) == {FlightPhase.FORMATION}, fleet.ground.newest
    assert error_m <= flying.error_m + LARGEST_ERROR_M, row
    assert all(reply is not None and reply.accepted for reply in taken.values()), taken


def _gaps_s(fleet: SecuredFleet) -> float:
    """Between two reports of one vehicle, which come every 0.1 s."""
    longest_s = 0.0
    for i in IDS:
        times = [at_s for at_s, status in fleet.ground.received if status.vehicle_id == i]
        longest_s = max([longest_s, *(b - a for a, b in pairwise(times))])
    return longest_s


def tls_of_a_stranger(who: str, fleet: SecuredFleet, folder: Path) -> dict[str, Any]:
    """TLS of one whom the fleet does not admit; `folder` is for its keys."""
    authority = fleet.keys / "authority" / "authority.pem"
    if who == "no certificate":
        return {"root_ca_certificate": str(authority), "verify_name_on_connect": False}
    age, days = (timedelta(days=10), 1) if who == "expired certificate" else (timedelta(0), 30)
    provision(fleet.scenario, fleet.folder, folder / "keys", OTHERS, age, days)
    return tls_of(identity_folder(folder / "keys", "vehicle-2"), authority)
