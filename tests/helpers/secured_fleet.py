"""A process fleet with identities: provisioned files, TLS between the processes, and attacks on them."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import zenoh
from cryptography.hazmat.primitives.asymmetric import ec
from msgspec.structs import replace

from common import AT_REST, ROOT, with_fields
from companion.cli.main import main
from companion.config.vehicle import protocol_of
from companion.ground.session import FleetSession
from companion.link.fleet.identity import load
from companion.link.fleet.zenoh_session import SETTINGS
from companion.security.admission import Admitted, AdmittedParticipant, key_der
from companion.security.identity import Identity
from companion.security.names import ParticipantName, ParticipantRole, parse_common_name, participant_name
from companion.security.provisioning import Provisioned, provision_new, revoke
from companion.types.commands import Command, CommandName
from companion.types.flight import FlightPhase
from companion.wire.keys import abort_key, command_key, peer_key, reply_key, status_key
from companion.wire.messages import encode, encode_peer
from fault_table import FaultRow
from process_fleet import IDS, Ground, largest_error_m, tracks_since
from processes import free_fleet_offset
from sitl.flight.files import write_files
from sitl.flight.processes import FleetProcesses, stand_ins_together
from sitl.flight.scenario import Scenario, load_scenario
from sitl.links.ports import ports_of
from tests.bench.provisioned import identity_folder, provision, use_identities

NOW = datetime(2026, 11, 22, 12, 0, 0, tzinfo=UTC)
GROUND_ANNA = participant_name(ParticipantRole.GROUND, "anna")


def fleet_files(folder: Path, vehicles: int = 2, name: str = "alpha") -> Path:
    """The files of real vehicles, by `companion init`."""
    arguments = [str(folder), "--vehicles", str(vehicles), "--origin", "47.4", "8.5", "488", "--name", name]
    assert main(["init", *arguments]) == 0
    return folder


def provisioned_by_operator(
    folder: Path, *wanted: ParticipantName, vehicles: int = 2, name: str = "alpha", now: datetime = NOW
) -> Provisioned:
    """A new fleet with identities for its vehicles, the wanted participants, and ground-anna where no ground is wanted."""
    return provision_new(fleet_files(folder, vehicles, name), wanted, GROUND_ANNA, 365, now)


def tree(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Permissions and content of every file and folder, by path."""
    return {
        str(path.relative_to(folder)): (path.stat().st_mode, path.read_bytes() if path.is_file() else b"")
        for path in sorted(folder.rglob("*"))
    }


def admitted_vehicles(fleet: str, keys: Mapping[int, ec.EllipticCurvePrivateKey]) -> Admitted:
    """A list of vehicles with these keys, that no authority has signed."""
    entries = [
        AdmittedParticipant(
            name=f"vehicle-{i}", serial=f"{i:x}", public_key=key_der(keys[i].public_key()), expires_at=NOW
        )
        for i in keys
    ]
    return Admitted(fleet=fleet, number=1, issued_at=NOW, participants=tuple(entries))


FLEET_NAME = "secured"
VEHICLES = (1, 2, 3)
OTHERS = ("ground-anna", "ground-ben", "monitor-tower", "target-beacon", "traffic-adsb", "mocap-hall")
GROUND = parse_common_name("ground-anna")
FLEET = (
    f"name: {FLEET_NAME}\norigin: indoor\nvehicles:\n"
    + "".join(
        f"  - {{id: {i}, role: {'leader' if i == 1 else 'follower'}, slot_enu_m: [{-1.5 * i}, 0.0, 0.0]}}\n"
        for i in VEHICLES
    )
    + "neighbours: {kind: edges, edges: [[1, 2], [2, 3]]}\n"
)
VEHICLE = "id: {id}\nfleet: fleet.yaml\nmavlink: udpin:127.0.0.1:14540\nhover_thrust_norm: 0.5\n"
REFERENCE = "reference: {kind: point, point_enu_m: [0.0, 0.0, 2.0]}\n"


@dataclass(frozen=True)
class Identities:
    """A provisioned fleet in `folder`; folders of the identities by name."""

    folder: Path

    def folder_of(self, name: str) -> Path:
        return self.folder / "copy" / name / "identity"

    def of(self, name: str) -> Identity:
        return load(self.folder_of(name), {})

    def revoke(self, *names: str) -> Path:
        """The new admission list."""
        revoke(self.folder, names, datetime.now(UTC))
        return self.folder / "authority" / "admitted.json"


def provisioned(folder: Path, age: timedelta = timedelta(0), days: int = 30) -> Identities:
    """A fleet whose certificates were made `age` ago."""
    folder.mkdir(parents=True)
    (folder / "fleet.yaml").write_text(FLEET, encoding="utf-8")
    for i in VEHICLES:
        text = VEHICLE.format(id=i) + (REFERENCE if i == 1 else "")
        (folder / f"vehicle-{i}.yaml").write_text(text, encoding="utf-8")
    provision_new(folder, [parse_common_name(name) for name in OTHERS], GROUND, days, datetime.now(UTC) - age)
    return Identities(folder)


def stranger(endpoint: str, tls: Mapping[str, Any] | None = None) -> zenoh.Session:
    """A session without access control of its own, as another program opens it."""
    config = zenoh.Config()
    for path, value in {**SETTINGS, **({"transport/link/tls": dict(tls)} if tls else {})}.items():
        config.insert_json5(path, json.dumps(value))
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    return zenoh.open(config)


def tls_of(own: Path, authority: Path | None = None) -> dict[str, Any]:
    """TLS with the key in a folder; `authority` is the certificate that it trusts."""
    return {
        "root_ca_certificate": str(authority or own / "authority.pem"),
        "connect_private_key": str(own / "private.key"),
        "connect_certificate": str(own / "certificate.pem"),
        "enable_mtls": True,
        "verify_name_on_connect": False,
    }


OTHERS_IN_FLIGHT = ("ground-anna", "ground-ben", "monitor-tower", "target-main", "traffic-adsb", "mocap-hall")
OVERRIDES = (
    "fleet.law.name=cooperative",
    "fleet.takeoff_height_m=2.0",
    "stand_in.armable_after_s=1",
    "links.peer_transport=tcp",  # what is attacked is Zenoh
    "fleet.separation_m=1.0",
    "reference={kind: circle, centre_enu_m: [-6.0, 0.0, 2.0], radius_m: 6.0, period_s: 30.0}",
)


@dataclass(frozen=True)
class SecuredFleet:
    """A flying fleet. `keys` is the provisioned folder."""

    scenario: Scenario
    folder: Path
    keys: Path
    port_offset: int
    protocol: str  # Zenoh's name: tls or quic
    session: FleetSession
    ground: Ground

    def identity(self, name: str) -> Identity:
        return load(self.identity_folder(name), {})

    def identity_folder(self, name: str) -> Path:
        return identity_folder(self.keys, name)

    def port(self, vehicle_id: int) -> int:
        return ports_of(vehicle_id, self.port_offset).zenoh

    def endpoints(self, protocol: str | None = None) -> list[str]:
        return [f"{protocol or self.protocol}/127.0.0.1:{self.port(i)}" for i in IDS]

    def largest_error_m(self, since_s: float) -> float:
        """Largest true error of a follower's place beside the leader since this time of the monotonic clock."""
        return largest_error_m(self.scenario, tracks_since(self.folder, since_s), at_least=50)  # a second of truth


@contextmanager
def secured_fleet(
    folder: Path, *overrides: str, processes: type[FleetProcesses] = FleetProcesses
) -> Iterator[SecuredFleet]:
    """The processes of a fleet in formation, ended with the block. `overrides` are those of the scenario."""
    scenario = load_scenario(ROOT / "config" / "scenarios" / "platoon.yaml", (*OVERRIDES, *overrides))
    protocol = protocol_of(scenario.fleet, secured=True)
    offset, keys = free_fleet_offset(), folder / "keys"
    write_files(scenario, folder, offset)
    provision(scenario, folder, keys, OTHERS_IN_FLIGHT)
    use_identities(scenario, folder, keys)
    endpoints = [f"{protocol}/127.0.0.1:{ports_of(i, offset).zenoh}" for i in IDS]
    with (
        processes.start_written(scenario, folder, offset, stand_ins_together(scenario)),
        FleetSession("*", endpoints, identity=load(identity_folder(keys, OTHERS_IN_FLIGHT[0]), {})) as session,
    ):
        fleet = SecuredFleet(scenario, folder, keys, offset, protocol, session, Ground(session))
        fleet.ground.listen(0.5)
        fleet.ground.fly_to_formation(IDS)
        fleet.ground.listen(3.0)
        yield fleet


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
    name, formation_hash = fleet.scenario.fleet.name, next(iter(fleet.ground.newest.values())).agent.formation_hash
    sessions = {i: status.agent.session for i, status in fleet.ground.newest.items()}
    packet = with_fields(AT_REST, formation_hash=formation_hash, position_enu_m=FAR_M)
    for number in count(1):
        for i in IDS:
            false = with_fields(
                packet, vehicle_id=i, session=sessions[i], sequence=10**6 + number, sent_s=time.monotonic()
            )
            yield peer_key(name, i), encode_peer(false)
            yield status_key(name, i), b"\x09nonsense"
            yield reply_key(name, i), b"\x09nonsense"
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
        times = [at_s for at_s, status in fleet.ground.received if status.agent.vehicle_id == i]
        longest_s = max([longest_s, *(b - a for a, b in pairwise(times))])
    return longest_s


def tls_of_a_stranger(who: str, fleet: SecuredFleet, folder: Path) -> dict[str, Any]:
    """TLS of one whom the fleet does not admit; `folder` is for its keys."""
    authority = fleet.keys / "authority" / "authority.pem"
    if who == "no certificate":
        return {"root_ca_certificate": str(authority), "verify_name_on_connect": False}
    age, days = (timedelta(days=10), 1) if who == "expired certificate" else (timedelta(0), 30)
    provision(fleet.scenario, fleet.folder, folder / "keys", OTHERS_IN_FLIGHT, age, days)
    return tls_of(identity_folder(folder / "keys", "vehicle-2"), authority)
