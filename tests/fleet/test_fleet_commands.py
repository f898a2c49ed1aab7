"""`companion fleet` against a fleet of real agents: a whole mission, two operators, and what is recorded and given again."""

import contextlib
import io
import json
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import yaml

from companion.cli import main
from companion.ground.session import FleetSession
from companion.link.zenoh_session import open_session
from companion.types import Command, CommandName, CommandReply, FlightPhase, Status
from companion.wire.ground import decode_reply, encode
from companion.wire.keys import command_key
from sitl.fleet import Fleet, endpoint_of
from sitl.scenario import scenario_from

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(280)]

PORT_OFFSET = 2450
SCENARIO = """\
fleet:
  name: commanded
  origin: {latitude_deg: 47.397742, longitude_deg: 8.545594, altitude_amsl_m: 488.0}
  altitude_source: takeoff
  vehicles:
    - {id: 1, role: leader, slot_enu_m: [0.0, 0.0, 0.0]}
    - {id: 2, role: follower, slot_enu_m: [-3.0, 0.0, 0.0], may_lead: true}
    - {id: 3, role: follower, slot_enu_m: [-6.0, 0.0, 0.0]}
  neighbours: {kind: edges, edges: [[1, 2], [2, 3], [1, 3]]}
  law: {name: cooperative}
starts_enu_m: {1: [0.0, 0.0, 0.0], 2: [-3.0, 0.0, 0.0], 3: [-6.0, 0.0, 0.0]}
reference: {kind: point, point_enu_m: [0.0, 0.0, 2.5]}
stand_in: {sensors: ideal}
timeline: [{command: prepare}]
"""
ALL = (1, 2, 3)


class Ground:
    """A ground station in the fleet's folder: `companion fleet`, and an ear for what the vehicles say."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.endpoints = [endpoint_of(i, PORT_OFFSET) for i in ALL]

    def fleet(self, *arguments: str, operator: str = "anna", code: int = 0) -> str:
        """What `companion fleet` prints, on either stream."""
        said = io.StringIO()
        common = ["--fleet", str(self.folder / "fleet.yaml"), "--connect", *self.endpoints, "--wait-s", "10"]
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            try:
                ended = main(["fleet", *arguments, *common, "--as", operator])
            except SystemExit as usage:
                ended = int(usage.code or 0)
        assert ended == code, said.getvalue()
        return said.getvalue()

    def answers(self, *arguments: str, operator: str = "anna", code: int = 0) -> dict[int, dict[str, Any]]:
        told = json.loads(self.fleet(*arguments, "--json", operator=operator, code=code))
        assert told["operator"] == operator
        return {vehicle["vehicle_id"]: vehicle for vehicle in told["vehicles"]}

    def until(self, phase: FlightPhase, condition: Callable[[Status], bool] = lambda _: True) -> None:
        """All vehicles are in this phase, and are as wanted."""
        with FleetSession.open("commanded", self.endpoints) as session:
            end_s = time.monotonic() + 60.0
            while True:
                heard = session.hear(ALL, 10.0)
                if len(heard) == len(ALL) and all(s.phase is phase and condition(s) for s in heard.values()):
                    return
                assert time.monotonic() < end_s, heard
                time.sleep(0.05)


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ground]:
    folder = tmp_path_factory.mktemp("commanded")
    with Fleet.start(scenario_from(folder / "scenario.yaml", yaml.safe_load(SCENARIO)), folder, PORT_OFFSET):
        yield Ground(folder)


def ready(ground: Ground) -> None:
    end_s = time.monotonic() + 60.0
    while True:
        try:
            ground.fleet("ready")
            return
        except AssertionError:
            assert time.monotonic() < end_s
            time.sleep(0.5)


def test_a_mission_from_one_terminal(ground: Ground) -> None:
    ready(ground)
    lines = ground.fleet("ready").splitlines()
    assert [line for line in lines if line.startswith("vehicle")] == [f"vehicle {i}  ready" for i in ALL]
    assert sum("hears" in line for line in lines) == 3

    refused = ground.answers("takeoff", code=1)
    assert {vehicle["answer"] for vehicle in refused.values()} == {"refused"}
    assert all("not possible in phase observe" in vehicle["reason"] for vehicle in refused.values())

    assert "vehicle 9 is not in" in ground.fleet("land", "--only", "2", "9", code=2)
    assert "vehicle 9 is not in" in ground.fleet("leader", "9", code=2)

    armed = ground.answers("arm")
    assert {vehicle["answer"] for vehicle in armed.values()} == {"accepted"}
    assert all(vehicle["after_s"] > 0.0 for vehicle in armed.values())
    ground.until(FlightPhase.ARMED)
    ground.fleet("takeoff")
    ground.until(FlightPhase.HOLD)
    ground.fleet("form")
    ground.until(FlightPhase.FORMATION)

    stranger = ground.answers("hold", operator="boris", code=1)
    assert {vehicle["reason"] for vehicle in stranger.values()} == {
        "hold: anna holds command; take it over with: companion fleet take"
    }
    ground.until(FlightPhase.FORMATION, lambda status: status.holder == "anna")

    ground.fleet("leader", "2")
    ground.until(FlightPhase.FORMATION, lambda status: status.epoch == 1)
    assert "may lead" in ground.fleet("leader", "3", code=1)
    together = ground.answers("leader", "1", "3", code=1)  # 3 may not: nobody is told to follow it
    assert {i: vehicle["answer"] for i, vehicle in together.items()} == {1: "refused", 3: "refused"}
    ground.until(FlightPhase.FORMATION, lambda status: status.epoch == 1)

    assert "expected at least separation_m, 1 m" in ground.fleet("formation", "line", "--spacing", "0.4", code=2)
    ground.fleet("formation", "line", "--spacing", "3", "--heading", "0")
    ground.until(FlightPhase.FORMATION, lambda s: s.slot.formation == 1 and not s.slot.moves)
    assert "come within 0.60 m" in ground.fleet("formation", "--scale", "0.2", code=2)
    ground.fleet("formation", "--scale", "1.2")
    ground.until(FlightPhase.FORMATION, lambda s: s.slot.formation == 2 and not s.slot.moves)

    outside = ground.fleet("reference", "point", "--at", "101", "0", "3", code=2)
    assert outside.startswith("command line: reference.point_enu_m: puts vehicle ")
    answers = ground.answers("reference", "point", "--at", "1", "-1", "3")
    assert answers.keys() == {1, 2}  # those that may lead
    assert {vehicle["answer"] for vehicle in answers.values()} == {"accepted"}
    ground.until(FlightPhase.FORMATION, lambda s: s.reference is None or s.reference.flown == 1)

    taken = ground.answers("take", operator="boris")
    assert {vehicle["reason"] for vehicle in taken.values()} == {"boris takes command from anna"}
    assert "boris holds command" in ground.fleet("form", code=1)
    told = ground.fleet("status")
    assert "formation 2, reference 1, commanded by boris" in told
    assert "formation 2, reference -, commanded by boris" in told  # vehicle 3 may not lead

    ground.fleet("abort")  # anna's: for everybody
    ground.until(FlightPhase.HOLD, lambda status: status.holder == "boris" and status.mode_name == "AUTO.LOITER")
    landing = ground.answers("land", operator="boris")
    assert {vehicle["answer"] for vehicle in landing.values()} == {"accepted"}
    ground.fleet("abort", operator="carla")  # who lands goes on
    ground.until(FlightPhase.OBSERVE, lambda status: not status.armed)

    log = (ground.folder / "agent_2.log").read_text()
    assert " of boris: refused, hold: anna holds command" in log
    assert " of boris: accepted, boris takes command from anna" in log
    assert ": boris takes command from anna\n" in log  # as an event, too
    assert "carla aborts; boris holds command" in log
    assert "Traceback" not in log


def test_what_was_recorded_is_not_obeyed_again(ground: Ground) -> None:
    ready(ground)
    ground.fleet("take")
    with (
        FleetSession.open("commanded", ground.endpoints) as session,
        closing(open_session((), ground.endpoints)) as network,
    ):
        status = session.hear([2], 10.0)[2]

        def give(command: Command) -> CommandReply:
            channel = network.get(command_key("commanded", 2), payload=encode(command), timeout=10.0)
            replies = [decode_reply(reply.ok.payload.to_bytes()) for reply in channel if reply.ok]
            assert len(replies) == 1
            return replies[0]

        first = Command(CommandName.PREPARE, status.command_number + 1, "anna", status.session)
        second = Command(CommandName.DISARM, status.command_number + 2, "anna", status.session)
        answer = give(first)
        assert answer.accepted
        assert give(first) == answer  # its answer may have been lost
        assert give(second).accepted
        again = give(first)
        assert (again.accepted, again.reason) == (
            False,
            f"prepare: old command: number {first.number} is not newer than {second.number}",
        )
        elsewhen = give(Command(CommandName.PREPARE, second.number + 1, "anna", status.session ^ 1))
        assert not elsewhen.accepted
        assert "earlier start" in elsewhen.reason
    ground.until(FlightPhase.OBSERVE)


def test_who_is_not_there_is_missing_and_the_others_are_asked_all_the_same(ground: Ground, tmp_path: Path) -> None:
    more = yaml.safe_load((ground.folder / "fleet.yaml").read_text())
    more["vehicles"].append({"id": 4, "role": "follower", "slot_enu_m": [-9.0, 0.0, 0.0]})
    file = tmp_path / "fleet.yaml"
    file.write_text(yaml.safe_dump(more))
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        common = ["--fleet", str(file), "--connect", *ground.endpoints, "--wait-s", "3"]
        assert main(["fleet", "disarm", *common, "--as", "anna"]) == 1
        assert main(["fleet", "ready", *common]) == 1
    lines = said.getvalue().splitlines()
    assert [line.split()[2] for line in lines[:4]] == ["accepted"] * 3 + ["missing"]
    assert "no answer within 3 s" in lines[3]
    assert sum("another one than this (formation hash differs)" in line for line in lines) == 3
    assert lines[-1] == "vehicle 4  missing: nothing heard of it for 3 s"
