"""Computers that go silent without a goodbye: out of range, asleep, without power. Each is a network namespace of its own.

Two vehicles, the leader and a follower, and the ground stay healthy. Nothing that the others do may delay what these three have
to say to each other.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest
from mcap.reader import NonSeekingReader

from common import until
from companion.cli.main import main
from companion.config.fleet import PeerLimits
from companion.security.names import parse_common_name
from companion.security.provisioning import provision_new
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from plugged_hosts import NEEDS, NETWORK, PluggedHosts, can_make_hosts, plugged_hosts
from tests.bench.processes import Program, module
from tests.bench.programs.fleet_ground import Answered

pytestmark = [
    pytest.mark.fleet,
    pytest.mark.timeout(180),
    pytest.mark.skipif(not can_make_hosts(), reason=NEEDS),
]

IDS, HEALTHY = (1, 2, 3, 4), (1, 2)
HOSTS = {i: 10 + i for i in IDS}
GROUND, LAPTOP, TABLET = 30, 31, 32
FOUR = (HOSTS[3], HOSTS[4], LAPTOP, TABLET)
WATCHED_S = 5.0  # Zenoh ends a silent connection after 2 s
ABORT_AFTER_S = 3.0
ANSWERED_WITHIN_S = 0.5
START_WITHIN_S = 60.0  # of all processes, on a busy machine
MAX_AGE_S = PeerLimits().max_age_s
TO_FORMATION = (
    (CommandName.PREPARE, FlightPhase.READY),
    (CommandName.ARM, FlightPhase.ARMED),
    (CommandName.TAKEOFF, FlightPhase.HOLD),
    (CommandName.FORM, FlightPhase.FORMATION),
)
TRANSPORTS = {
    "tcp": "security: none\n",
    "tls": "",
    "quic": "transport: quic\n",
    "multicast": "multicast: 239.255.77.1:7446\n",
}
AUTOPILOT = """\
id: {id}
world_origin: {{latitude_deg: 47.4, longitude_deg: 8.5, altitude_amsl_m: 400.0}}
start_enu_m: [{x}, 0, 0]
stand_in: {{sensors: ideal, parameters: {{COM_OBL_RC_ACT: 5, COM_RC_OVERRIDE: 3}}}}
"""


@dataclass(frozen=True)
class Files:
    """Of a fleet; identities by participant, empty where it has none."""

    folder: Path
    fleet: Path
    vehicles: dict[int, Path]
    identities: dict[str, Path]


def write_files(folder: Path, settings: str) -> Files:
    place = ["--address", NETWORK + ".{id+10}", "--mavlink", "udpin:127.0.0.1:{id+14539}"]
    shape = ["--vehicles", str(len(IDS)), "--spacing", "5", "--height", "4", "--origin", "47.4", "8.5", "400"]
    open_fleet = "security: none" in settings
    security = ["--security", "none"] if open_fleet else []
    assert main(["init", str(folder), *shape, "--may-lead", "2", *place, *security]) == 0
    fleet = folder / "fleet.yaml"
    over_zenoh = re.sub(r"^multicast:.*\n", "", fleet.read_text(), flags=re.MULTILINE)
    fleet.write_text(over_zenoh + ("" if open_fleet else settings))
    vehicles, identities = {i: folder / f"vehicle-{i}.yaml" for i in IDS}, {}
    if not open_fleet:
        names = [parse_common_name(name) for name in ("monitor-laptop", "monitor-tablet")]
        provision_new(folder, [*names, parse_common_name("ground-anna")], names[0], 1, datetime.now(UTC))
        vehicles = {i: folder / "copy" / f"vehicle-{i}" / f"vehicle-{i}.yaml" for i in IDS}
        identities = {str(name): folder / "copy" / str(name) / "identity" for name in (*names, "ground-anna")}
    for i, file in vehicles.items():
        file.write_text(f"{file.read_text()}recording: {{folder: {folder / f'recording-{i}'}}}\n")
        (folder / f"autopilot-{i}.yaml").write_text(AUTOPILOT.format(id=i, x=-5 * i))
    return Files(folder, fleet, vehicles, identities)


class Ground:
    """The connected ground computer."""

    def __init__(self, program: Program) -> None:
        self._program = program

    def phases(self) -> dict[int, FlightPhase]:
        self._program.begin("phases")
        return self._program.result(dict[int, FlightPhase])

    def ask(self, name: CommandName, *ids: int) -> dict[int, Answered | None]:
        self._program.begin(" ".join([name, *map(str, ids)]))
        return self._program.result(dict[int, Answered | None])

    def order(self, name: CommandName, phase: FlightPhase, *ids: int) -> None:
        """Again and again until all are in this phase."""
        until(lambda: self._ordered(name, phase, ids), START_WITHIN_S, lambda: time.sleep(0.2))

    def _ordered(self, name: CommandName, phase: FlightPhase, ids: Sequence[int]) -> bool:
        phases = self.phases()
        if others := [i for i in ids if phases.get(i) is not phase]:
            self.ask(name, *others)
        return not others

    def fly_to_formation(self) -> None:
        for name, phase in TO_FORMATION:
            self.order(name, phase, *IDS)


@dataclass
class Fleet:
    hosts: PluggedHosts
    files: Files
    ground: Ground
    agents: dict[int, subprocess.Popen[bytes]]

    def log(self, vehicle_id: int) -> str:
        return (self.files.folder / f"agent-{vehicle_id}.log").read_text()

    def end(self) -> None:
        """The agents end, and their recordings with them."""
        for agent in self.agents.values():
            agent.terminate()
        for agent in self.agents.values():
            agent.wait(10.0)


def background(stack: ExitStack, log: Path, command: list[str]) -> subprocess.Popen[bytes]:
    with log.open("wb") as out:
        process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
    stack.callback(process.wait)
    stack.callback(process.kill)
    return process


@contextmanager
def flying(folder: Path, settings: str) -> Iterator[Fleet]:
    """In formation."""
    files = write_files(folder / "field", settings)
    with plugged_hosts([*HOSTS.values(), GROUND, LAPTOP, TABLET]) as hosts, ExitStack() as stack:

        def start(name: str, host: int, *command: str) -> subprocess.Popen[bytes]:
            return background(
                stack, files.folder / f"{name}.log", [*hosts.inside(host), sys.executable, "-m", *command]
            )

        def identity(name: str) -> list[str]:
            return [str(files.identities[name])] if files.identities else []

        for i in IDS:
            start(
                f"autopilot-{i}", HOSTS[i], "sitl", "autopilot", "--config", str(files.folder / f"autopilot-{i}.yaml")
            )
        agents = {
            i: start(f"agent-{i}", HOSTS[i], "companion", "agent", "--config", str(files.vehicles[i])) for i in IDS
        }
        for name, host in (("monitor-laptop", LAPTOP), ("monitor-tablet", TABLET)):
            options = ["--identity", *identity(name)] if files.identities else []
            start(name, host, "companion", "monitor", "--json", "--fleet-file", str(files.fleet), *options)
        program = module("tests.bench.programs.fleet_ground", str(files.fleet), *identity("ground-anna"))
        ground = Ground(Program(stack, [*hosts.inside(GROUND), *program]))
        ground.fly_to_formation()
        yield Fleet(hosts, files, ground, agents)


def gaps_s(recordings: Path, sender: int, begin_unix_s: float, end_unix_s: float) -> list[float]:
    """Between one packet of this vehicle and the next, in this time, as the recordings of another one have them."""
    times = [begin_unix_s]
    for file in sorted(recordings.glob("*.mcap")):
        messages = NonSeekingReader(BytesIO(file.read_bytes())).iter_messages(topics=["/inbox"], log_time_order=False)
        for _, _, message in messages:
            at_s = message.log_time / 1e9
            senders = [packet[0] for _, packet, *_ in msgspec.json.decode(message.data).get("peers", [])]
            if sender in senders and begin_unix_s < at_s < end_unix_s:
                times.append(at_s)
    return [b - a for a, b in pairwise([*times, end_unix_s])]


def lose(fleet: Fleet, *hosts: int) -> tuple[float, float]:
    """They are silent for WATCHED_S; meanwhile an abort is given. Begin and end in seconds since 1970."""
    begin_s = time.time()
    fleet.hosts.unplug(*hosts)
    time.sleep(ABORT_AFTER_S)
    phases = fleet.ground.phases()
    assert {phases[i] for i in HEALTHY} == {FlightPhase.FORMATION}, [fleet.log(i) for i in HEALTHY]
    for i, answer in fleet.ground.ask(CommandName.ABORT, *HEALTHY).items():
        assert answer, f"no answer of vehicle {i}"
        assert answer.after_s < ANSWERED_WITHIN_S
    time.sleep(max(0.0, begin_s + WATCHED_S - time.time()))
    return begin_s, time.time()


@pytest.mark.parametrize(
    "transport", [name if name == "tls" else pytest.param(name, marks=pytest.mark.long) for name in TRANSPORTS]
)
def test_silent_computers_delay_no_packet_and_no_command_of_the_others(tmp_path: Path, transport: str) -> None:
    with flying(tmp_path, TRANSPORTS[transport]) as fleet:
        one = lose(fleet, LAPTOP)
        fleet.hosts.plug_in(LAPTOP)
        fleet.ground.order(CommandName.FORM, FlightPhase.FORMATION, *IDS)
        four = lose(fleet, *FOUR)
        fleet.end()
        for receiver, sender in ((1, 2), (2, 1)):
            for begin_s, end_s in (one, four):
                recordings = fleet.files.folder / f"recording-{receiver}"
                assert max(gaps_s(recordings, sender, begin_s, end_s)) < MAX_AGE_S, fleet.log(receiver)
