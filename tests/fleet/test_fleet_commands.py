"""`companion fleet` against a fleet of real agents: a whole mission, two operators, and recorded commands."""

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
import zenoh

from companion.cli.main import main
from companion.ground.commands import statuses_of
from companion.ground.session import FleetSession
from companion.link.fleet.zenoh_session import open_session
from companion.types.commands import Command, CommandName, CommandReply
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from companion.types.status import Status
from companion.wire.keys import command_key, reply_key
from companion.wire.messages import decode_reply, encode
from processes import free_fleet_offset
from sitl.flight.processes import FleetProcesses
from sitl.flight.scenario import scenario_from
from sitl.links.ports import zenoh_endpoint

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(280)]

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
stand_in: {sensors: ideal, armable_after_s: 1}
timeline: [{command: prepare}]
"""
ALL = (1, 2, 3)


class Ground:
    """A ground station in the fleet's folder: `companion fleet`, and the reports of the vehicles."""

    def __init__(self, folder: Path, port_offset: int) -> None:
        self.folder = folder
        self.endpoints = [zenoh_endpoint(i, port_offset) for i in ALL]

    def fleet(self, *arguments: str, operator: str = "anna", code: int = 0) -> str:
        """What `companion fleet` prints on stdout, then on stderr."""
        return "".join(self._run(*arguments, operator=operator, code=code))

    def _run(self, *arguments: str, operator: str, code: int) -> tuple[str, str]:
        output, errors = io.StringIO(), io.StringIO()
        common = ["--fleet", str(self.folder / "fleet.yaml"), "--connect", *self.endpoints, "--wait-s", "10"]
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
            try:
                ended = main(["fleet", *arguments, *common, "--as", operator])
            except SystemExit as usage:
                ended = int(usage.code or 0)
        printed = output.getvalue(), errors.getvalue()
        assert ended == code, printed
        return printed

    def answers(self, *arguments: str, operator: str = "anna", code: int = 0) -> dict[int, dict[str, Any]]:
        printed = self.printed(*arguments, operator=operator, code=code)
        return {vehicle["vehicle_id"]: vehicle for vehicle in printed["vehicles"]}

    def printed(self, *arguments: str, operator: str = "anna", code: int = 0) -> dict[str, Any]:
        output, _ = self._run(*arguments, "--json", operator=operator, code=code)
        printed: dict[str, Any] = json.loads(output)
        assert printed["operator"] == operator
        return printed

    def check(self, *arguments: str, operator: str = "anna", code: int = 0) -> set[str]:
        """The codes of the vehicles' answers to the check of a command."""
        answers = self.printed(*arguments, "--check", operator=operator, code=code)
        assert answers["check"]
        return {vehicle["code"] for vehicle in answers["vehicles"]}

    def until(self, phase: FlightPhase, condition: Callable[[Status], bool] = lambda _: True) -> None:
        """Until all vehicles are in this phase and the condition holds for each."""
        with FleetSession("commanded", self.endpoints) as session:
            end_s = time.monotonic() + 60.0
            while True:
                statuses = statuses_of(session.newest, ALL, 10.0)
                if len(statuses) == len(ALL) and all(s.phase is phase and condition(s) for s in statuses.values()):
                    return
                assert time.monotonic() < end_s, statuses
                time.sleep(0.05)


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ground]:
    folder, port_offset = tmp_path_factory.mktemp("commanded"), free_fleet_offset()
    with FleetProcesses.start(scenario_from(folder / "scenario.yaml", yaml.safe_load(SCENARIO)), folder, port_offset):
        yield Ground(folder, port_offset)


def ready(ground: Ground) -> None:
    end_s = time.monotonic() + 60.0
    while True:
        try:
            ground.fleet("doctor")
            return
        except AssertionError:
            assert time.monotonic() < end_s
            time.sleep(0.5)


def test_a_mission_from_one_terminal(ground: Ground) -> None:
    ready(ground)
    lines = ground.fleet("doctor").splitlines()
    assert [line.split(",")[0] for line in lines if line.startswith("vehicle")] == [f"vehicle {i}  ready" for i in ALL]
    assert sum("fresh: " in line for line in lines) == 3

    refused = ground.answers("takeoff", code=1)
    assert {(vehicle["answer"], vehicle["code"]) for vehicle in refused.values()} == {("not sent", "WRONG_PHASE")}

    assert ground.check("takeoff", code=1) == {"WRONG_PHASE"}  # by the vehicles, each for itself
    assert ground.check("arm") == {"CHECK_PASSED"}
    ground.until(FlightPhase.OBSERVE, lambda status: (status.command.holder, status.command.command_number) == ("", 0))

    ground.answers("arm", "--only", "1", "2")
    held_back = ground.answers("takeoff", code=1)  # one is not armed: none climbs
    assert {i: vehicle["code"] for i, vehicle in held_back.items()} == {1: "NOT_SENT", 2: "NOT_SENT", 3: "WRONG_PHASE"}

    assert "vehicle 9 is not in" in ground.fleet("land", "--only", "2", "9", code=2)
    assert "vehicle 9 is not in" in ground.fleet("leader", "9", code=2)

    armed = ground.answers("arm")
    assert {(vehicle["answer"], vehicle["finished"]) for vehicle in armed.values()} == {("accepted", True)}
    assert all(vehicle["after_s"] > 0.0 for vehicle in armed.values())
    assert {i: vehicle["code"] for i, vehicle in armed.items()} == {
        1: "ALREADY_DONE",
        2: "ALREADY_DONE",
        3: "PHASE_CHANGED",
    }
    ground.until(FlightPhase.ARMED)
    assert "3 of 3 vehicles in hold after takeoff (" in ground.fleet("takeoff")
    ground.until(FlightPhase.HOLD)
    again = ground.answers("takeoff")
    assert {(vehicle["code"], vehicle["finished"]) for vehicle in again.values()} == {("ALREADY_DONE", True)}
    assert "3 of 3 vehicles in formation (" in ground.fleet("form")
    ground.until(FlightPhase.FORMATION)

    stranger = ground.answers("hold", operator="boris", code=1)
    assert {vehicle["code"] for vehicle in stranger.values()} == {"OTHER_HOLDS_COMMAND"}
    ground.until(FlightPhase.FORMATION, lambda status: status.command.holder == "anna")

    assert ground.check("hold", operator="boris", code=1) == {"OTHER_HOLDS_COMMAND"}
    assert ground.check("leader", "2") == {"CHECK_PASSED"}
    assert ground.check("land") == {"CHECK_PASSED"}
    wide = ground.printed("formation", "line", "--spacing", "200", "--check", code=1)
    assert {(vehicle["answer"], vehicle["code"]) for vehicle in wide["vehicles"]} == {("refused", "SLOT_OUTSIDE_FENCE")}
    spacing = str(wide["instead"]["spacing_m"])
    assert ground.check("formation", "line", "--spacing", spacing) == {"CHECK_PASSED"}
    assert ground.check("reference", "point", "--at", "1", "-1", "3") == {"CHECK_PASSED"}
    lines = ground.fleet("formation", "line", "--spacing", "200", "--check", code=1)
    assert lines.endswith(f"accepted would be --spacing {float(spacing):g}\n")
    ground.until(FlightPhase.FORMATION, lambda s: (s.leadership.epoch, s.formation.slot.waiting) == (0, 0))

    ground.fleet("leader", "2")
    ground.until(FlightPhase.FORMATION, lambda status: status.leadership.epoch == 1)
    assert "NOT_A_LEADER: " in ground.fleet("leader", "3", code=1)
    together = ground.answers("leader", "1", "3", code=1)  # 3 may not: no vehicle follows it
    assert {i: vehicle["answer"] for i, vehicle in together.items()} == {1: "refused", 3: "refused"}
    ground.until(FlightPhase.FORMATION, lambda status: status.leadership.epoch == 1)

    assert "expected at least separation_m, 1 m" in ground.fleet("formation", "line", "--spacing", "0.4", code=2)
    ground.fleet("formation", "line", "--spacing", "3", "--heading", "0")
    ground.until(FlightPhase.FORMATION, lambda s: s.formation.slot.formation == 1 and not s.formation.slot.moves)
    assert "come within 0.60 m" in ground.fleet("formation", "--scale", "0.2", code=2)
    ground.fleet("formation", "--scale", "1.2")
    ground.until(FlightPhase.FORMATION, lambda s: s.formation.slot.formation == 2 and not s.formation.slot.moves)

    outside = ground.fleet("reference", "point", "--at", "101", "0", "3", code=2)
    assert outside.startswith("companion fleet reference: reference.point_enu_m: puts vehicle ")
    answers = ground.answers("reference", "point", "--at", "1", "-1", "3")
    assert answers.keys() == {1, 2}  # those that may lead
    assert {vehicle["answer"] for vehicle in answers.values()} == {"accepted"}
    ground.until(FlightPhase.FORMATION, lambda s: s.formation.reference is None or s.formation.reference.flown == 1)

    taken = ground.answers("take", operator="boris")
    assert {vehicle["code"] for vehicle in taken.values()} == {"COMMAND_TAKEN"}
    assert "OTHER_HOLDS_COMMAND: " in ground.fleet("form", code=1)
    shown = ground.fleet("status")
    assert "formation 2, reference 1, operator boris" in shown
    assert "formation 2, reference -, operator boris" in shown  # vehicle 3 may not lead

    ground.fleet("abort")  # by anna, who does not hold command
    ground.until(
        FlightPhase.HOLD,
        lambda status: status.command.holder == "boris" and status.autopilot.mode_name == "AUTO.LOITER",
    )
    landing = ground.answers("land", "--no-wait", operator="boris")
    assert {(vehicle["answer"], vehicle["finished"]) for vehicle in landing.values()} == {("accepted", None)}
    aborted = ground.answers("abort", operator="carla")  # the landing continues
    assert {(vehicle["code"], vehicle["finished"]) for vehicle in aborted.values()} == {("LANDING_CONTINUES", True)}
    ground.until(FlightPhase.OBSERVE, lambda status: not status.autopilot.armed)

    log = (ground.folder / "agent_2.log").read_text()
    assert " of boris: refused, OTHER_HOLDS_COMMAND: " in log
    assert ": check of takeoff, number " in log
    assert " of boris: accepted, COMMAND_TAKEN: " in log
    assert ": COMMAND_TAKEN: boris takes command from anna\n" in log  # as an event, too
    assert ": ABORT_BY_OTHER: " in log
    assert "Traceback" not in log


def test_a_recorded_command_has_no_effect(ground: Ground) -> None:
    ready(ground)
    ground.fleet("take")
    with (
        FleetSession("commanded", ground.endpoints) as session,
        closing(open_session((), ground.endpoints)) as network,
    ):
        status = statuses_of(session.newest, [2], 10.0)[2]
        received = network.declare_subscriber(reply_key("commanded", 2), zenoh.handlers.RingChannel(100))
        time.sleep(0.5)  # until the vehicle knows of the subscriber

        def give(command: Command) -> CommandReply:
            while received.try_recv():
                pass
            network.put(command_key("commanded", 2, "anna"), encode(command))
            end_s = time.monotonic() + 10.0
            while time.monotonic() < end_s:
                sample = received.try_recv()
                reply = decode_reply(sample.payload.to_bytes()) if sample else None
                if reply and (reply.operator, reply.number) == (command.operator, command.number):
                    return reply
                time.sleep(0.02)
            raise AssertionError(f"no reply to {command}")

        first = Command(CommandName.PREPARE, status.command.command_number + 1, "anna", status.agent.session)
        second = Command(CommandName.DISARM, status.command.command_number + 2, "anna", status.agent.session)
        answer = give(first)
        assert answer.accepted
        assert give(first) == answer  # its answer may have been lost
        assert give(second).accepted
        again = give(first)
        assert (again.accepted, again.code) == (False, Code.COMMAND_OLD)
        earlier = give(Command(CommandName.PREPARE, second.number + 1, "anna", status.agent.session ^ 1))
        assert (earlier.accepted, earlier.code) == (False, Code.WRONG_SESSION)
    ground.until(FlightPhase.OBSERVE)


def test_a_missing_vehicle_does_not_hold_back_a_disarm_of_the_others(ground: Ground, tmp_path: Path) -> None:
    more = yaml.safe_load((ground.folder / "fleet.yaml").read_text())
    more["vehicles"].append({"id": 4, "role": "follower", "slot_enu_m": [-9.0, 0.0, 0.0]})
    file = tmp_path / "fleet.yaml"
    file.write_text(yaml.safe_dump(more))
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        common = ["--fleet", str(file), "--connect", *ground.endpoints, "--wait-s", "3"]
        assert main(["fleet", "disarm", *common, "--as", "anna"]) == 1
        assert main(["fleet", "doctor", *common]) == 1
    lines = output.getvalue().splitlines()
    assert [line.split()[2] for line in lines[:4]] == ["accepted"] * 3 + ["missing"]
    assert "NO_REPLY: " in lines[3]
    assert sum("FLEET_FILE_DIFFERS: " in line for line in lines) == 3
    assert "vehicle 4  missing  NO_REPORT: no report for 3 s" in lines
