"""A recorded flight, replayed: bit for bit with its own settings, compared with others; what cannot be used is said."""

import csv
import json
import os
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from itertools import islice
from pathlib import Path

import pytest
from msgspec.structs import replace

from common import ROOT
from companion.cli.main import main
from companion.core.agent import Agent
from companion.recording.codec import encode_outbox
from companion.recording.reader import Recording, recordings
from companion.recording.records import SOFTWARE, Header
from companion.replay.command import replayed_lines
from companion.replay.comparison import FirstDifference, ReplayResult
from companion.types.autopilot import AttitudeTarget
from companion.types.status import Status
from companion.types.tick import Inbox, Outbox
from lockstep_fleet import director_of
from recordings import RecordingFile
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import Scenario, scenario_from
from sitl.flight.watch import watch_of

Change = Callable[[int, Inbox, Outbox], tuple[Inbox, Outbox | None] | None]
"""Number, input and output of a tick -> those to be recorded; None leaves the tick out."""


PLATOON = {
    "fleet": {
        "name": "platoon",
        "origin": {"latitude_deg": 47.4, "longitude_deg": 8.5, "altitude_amsl_m": 488.0},
        "vehicles": [
            {"id": 1, "role": "leader", "slot_enu_m": [0.0, 0.0, 0.0]},
            {"id": 2, "role": "follower", "slot_enu_m": [-2.0, 0.0, 0.0], "may_lead": True},
        ],
        "neighbours": {"kind": "edges", "edges": [[1, 2]]},
        "takeoff_height_m": 1.0,
    },
    "starts_enu_m": {1: [0.0, 0.0, 0.0], 2: [-2.0, 0.0, 0.0]},
    "reference": {"kind": "point", "point_enu_m": [0.5, 0.0, 1.0]},
    "stand_in": {"sensors": "default", "armable_after_s": 1},
    "timeline": [
        {"command": "prepare"},
        {"command": "arm"},
        {"command": "takeoff"},
        {"command": "form", "for_s": 2.0},
        {"command": "lead", "leaders": [2], "for_s": 1.0},
        {"command": "formation", "formation": {"shape": "line", "spacing_m": 2.5}},
        {"command": "hold"},
        {"command": "land"},
    ],
}


def scenario() -> Scenario:
    return scenario_from(Path("platoon"), PLATOON)


def fly(folder: Path) -> None:
    """Leaves the recordings of both vehicles in the folder."""
    flown = scenario()
    lockstep = Lockstep(flown, folder)
    director = director_of(lockstep, watch_of(flown, lockstep.now_s()))
    assert not director.fly_and_land(flown.timeline)
    lockstep.close()


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flight")
    fly(folder)
    return folder


def recording_of(folder: Path, vehicle_id: int) -> Recording:
    return next(one for one in recordings(folder, print) if one.vehicle_id == vehicle_id)


def rewritten(
    flight: Path, folder: Path, change: Change, header: Callable[[Header], Header] = lambda same: same
) -> Path:
    """The recording of vehicle 2 with changes, up to a second after its first setpoint, in another folder."""
    recording = recording_of(flight, 2)
    file = RecordingFile(folder / "2.mcap", header(recording.header), 50_000)
    for tick in islice(recording.ticks(print), first_setpoint(flight) + 50):
        if (changed := change(tick.number, tick.inbox, tick.outbox())) is not None:
            file.tick(tick.number, tick.now_s, *changed)
    file.close()
    return folder


def unchanged(_number: int, inbox: Inbox, outbox: Outbox) -> tuple[Inbox, Outbox]:
    return inbox, outbox


def replayed(folder: Path, capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of `companion replay`."""
    code = main(["replay", str(folder), *arguments])
    out, err = capsys.readouterr()
    return code, out, err


@cache
def first_setpoint(flight: Path) -> int:
    """Number of the first tick of vehicle 2 with a setpoint."""
    return next(tick.number for tick in recording_of(flight, 2).ticks(print) if tick.outbox().attitude_target)


# ------------------------------------------------------------ the recorded settings


def test_the_flight_has_what_is_to_be_replayed(flight: Path) -> None:
    codes = {e.code for tick in recording_of(flight, 2).ticks(print) for e in tick.outbox().events}
    assert {"ROLE_CHANGED", "FORMATION_CHANGED", "PHASE_CHANGED"} <= codes


def test_a_flight_replays_bit_for_bit_in_another_process(flight: Path) -> None:
    """Another seed of the hashes: no set decides about the order of anything."""
    environment = os.environ | {"PYTHONHASHSEED": "12345", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "companion", "replay", str(flight), "--json"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["equal"] is True
    assert [vehicle["vehicle_id"] for vehicle in result["vehicles"]] == [1, 2]
    assert all(vehicle["ticks"] > 800 and vehicle["not_recorded"] == 0 for vehicle in result["vehicles"])
    assert not done.stderr


def test_equal_ticks_are_one_line(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = replayed(flight, capsys, "--vehicle", "2")
    count = sum(1 for _ in recording_of(flight, 2).ticks(print))
    assert (code, out, err) == (0, f"vehicle 2: {count} ticks, all equal\n", "")


def test_a_file_that_cannot_be_read_is_named_and_not_passed_over(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (rewritten(flight, tmp_path, unchanged) / "3.mcap").write_bytes(b"no recording")
    code, out, err = replayed(tmp_path, capsys)
    assert code == 2
    assert "all equal" in out
    assert "3.mcap: not an MCAP file" in err


def test_one_bit_in_a_command_is_found(flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    number = first_setpoint(flight) + 10
    values: list[float] = []

    def change(tick: int, inbox: Inbox, outbox: Outbox) -> tuple[Inbox, Outbox]:
        if tick == number:
            target = outbox.attitude_target
            assert target
            values.append(target.pitch_rad)
            outbox = replace(outbox, attitude_target=replace(target, pitch_rad=target.pitch_rad * (1.0 + 2.3e-16)))
            assert outbox.attitude_target.pitch_rad != target.pitch_rad
        return inbox, outbox

    code, out, _ = replayed(rewritten(flight, tmp_path, change), capsys)
    assert code == 1
    lines = out.splitlines()
    assert lines[0].startswith(f"vehicle 2: tick {number} differs, ")
    assert lines[0].endswith(" s after the first: attitude_target.pitch_rad")  # virtual time has no date
    assert lines[2] == f"  computed {values[0]!r}"
    assert lines[1] != lines[2].replace("computed", "recorded")


def test_another_input_gives_another_output(flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The order of telemetry and each packet count: without the packets of one tick something differs from then on."""
    number = first_setpoint(flight) + 5

    def change(tick: int, inbox: Inbox, outbox: Outbox) -> tuple[Inbox, Outbox]:
        return (replace(inbox, telemetry=()) if tick == number else inbox), outbox

    code, out, _ = replayed(rewritten(flight, tmp_path, change), capsys, "--json")
    difference = json.loads(out)["vehicles"][0]["difference"]
    assert code == 1
    assert difference["tick"] == number
    assert difference["recorded"] != difference["computed"]


def test_an_event_that_is_missing_is_found(flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def change(_: int, inbox: Inbox, outbox: Outbox) -> tuple[Inbox, Outbox]:
        return inbox, replace(outbox, events=())

    code, out, _ = replayed(rewritten(flight, tmp_path, change), capsys, "--json")
    assert code == 1
    difference = json.loads(out)["vehicles"][0]["difference"]
    assert difference["field"] == "events"
    assert difference["recorded"] == "()"


def test_messages_refused_before_the_agent_are_no_difference(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They count in the status, and are no part of the input of the agent."""

    def with_more(status: Status) -> Status:
        return replace(status, rejected=status.rejected | {"PEER_MALFORMED": 3})

    def more(_: int, inbox: Inbox, outbox: Outbox) -> tuple[Inbox, Outbox]:
        return inbox, replace(outbox, status=outbox.status and with_more(outbox.status))

    assert replayed(rewritten(flight, tmp_path, more), capsys)[0] == 0


def test_the_first_difference_of_another_version_names_it(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def change(_: int, inbox: Inbox, outbox: Outbox) -> tuple[Inbox, Outbox]:
        return inbox, replace(outbox, attitude_target=AttitudeTarget(0.0, 0.0, 0.0, 0.5))

    code, out, _ = replayed(rewritten(flight, tmp_path, change, lambda h: replace(h, software="other 9.9")), capsys)
    assert code == 1
    assert "attitude_target\n  recorded AttitudeTarget(" in out
    assert "computed none" in out
    assert "recorded by other 9.9, computed by formation-companion" in out


def test_a_difference_of_a_vehicle_whose_clock_is_set_has_its_date() -> None:
    difference = FirstDifference(tick=5, time_s=0.08, utc_s=1.7e9, field="status.phase", recorded="a", computed="b")
    result = ReplayResult(vehicle_id=1, session=1, software=SOFTWARE, ticks=5, difference=difference)
    first = next(iter(replayed_lines("vehicle 1", result)))
    assert first == (
        "vehicle 1: tick 5 differs, 0.080 s after the first (2023-11-14 22:13:20.000000 UTC): status.phase"
    )


def test_an_agent_that_fails_is_a_difference(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A defect that is in this version of the agent, or that ended the agent in flight."""

    def failing(agent: Agent, now_s: float, inbox: Inbox) -> Outbox:
        outbox = step(agent, now_s, inbox)
        if any(event.code == "PHASE_CHANGED" for event in outbox.events):
            raise ZeroDivisionError("division by zero")
        return outbox

    step = Agent.step
    monkeypatch.setattr(Agent, "step", failing)
    code, out, _ = replayed(rewritten(flight, tmp_path, unchanged), capsys)
    assert code == 1
    assert (
        " s after the first: the agent\n  recorded an output\n  computed ZeroDivisionError: division by zero\n" in out
    )
    code, out, _ = replayed(tmp_path, capsys, "--law", "weighted")
    assert code == 2
    assert "the agent fails at tick" in out


# ------------------------------------------------------------ what cannot be replayed


def test_a_tick_that_is_not_recorded_ends_the_replay(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = rewritten(flight, tmp_path, lambda tick, i, o: None if 200 <= tick < 210 else (i, o))
    code, out, _ = replayed(folder, capsys)
    assert code == 2
    assert out == "vehicle 2: 199 ticks, all equal; it ends there: ticks 200 to 209 are not recorded\n"


def test_a_missing_output_is_counted(flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = rewritten(flight, tmp_path, lambda tick, i, o: (i, None if tick == 200 else o))
    code, out, _ = replayed(folder, capsys)
    assert code == 0
    assert "all equal, 1 of them without a recorded output" in out


def test_without_the_first_part_there_is_no_replay(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = rewritten(flight, tmp_path, unchanged, lambda header: replace(header, part=2))
    code, out, _ = replayed(folder, capsys)
    assert code == 2
    assert out == "vehicle 2: cannot be replayed: part 1 of the recording is not here\n"


def test_a_recording_without_ticks_is_not_equal(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = replayed(rewritten(flight, tmp_path, lambda _tick, _i, _o: None), capsys)
    assert code == 2
    assert out == "vehicle 2: cannot be replayed: no ticks are recorded\n"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"fleet_file": "["}, "its fleet file is not valid JSON"),
        ({"fleet_file": "[" * 100_000}, "its fleet file is not valid JSON"),
        ({"vehicle_file": '{"id": 2}'}, "vehicle.mavlink: missing"),
        ({"vehicle_id": 1}, "vehicle.id: 2 is not the vehicle that was recorded; expected 1"),
    ],
)
def test_a_header_that_is_not_valid_is_one_line(
    change: dict[str, object], reason: str, flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = rewritten(flight, tmp_path, unchanged, lambda header: replace(header, **change))
    code, out, _ = replayed(folder, capsys)
    assert code == 2
    assert reason in out
    assert "cannot be replayed" in out


def test_no_file_of_a_recorded_configuration_is_opened(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its paths are those of the vehicle."""

    def with_paths(header: Header) -> Header:
        file = json.loads(header.vehicle_file)
        file |= {"fleet": "/missing/fleet.yaml", "identity": "/missing", "signing": {"key_file": "/missing/key"}}
        return replace(header, vehicle_file=json.dumps(file))

    assert replayed(rewritten(flight, tmp_path, unchanged, with_paths), capsys)[0] == 0


def test_arguments_that_cannot_be_used(flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "expected one of 1, 2" in replayed(flight, capsys, "--vehicle", "9")[2]
    assert "no recordings here" in replayed(tmp_path, capsys)[2]
    assert "needs --law or --set" in replayed(flight, capsys, "--csv", "x.csv")[2]
    code, _, err = replayed(flight, capsys, "--law", "weighted", "--csv", str(tmp_path / "missing" / "x.csv"))
    assert code == 2
    assert "No such file" in err


# ------------------------------------------------------------ other settings


def test_another_law_shows_how_far_its_commands_are(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "commands.csv"
    code, out, _ = replayed(flight, capsys, "--law", "weighted", "--vehicle", "2", "--csv", str(file), "--json")
    (result,) = json.loads(out)["vehicles"]
    assert code == 0
    rows = list(csv.DictReader(file.open()))
    assert len(rows) == result["ticks"]
    both = [row for row in rows if row["recorded_pitch_deg"] and row["other_pitch_deg"]]
    assert len(both) == result["commands"] > 100
    apart = [abs(float(row["recorded_pitch_deg"]) - float(row["other_pitch_deg"])) for row in both]
    assert max(apart) == pytest.approx(result["pitch_deg"]["largest"])
    assert max(apart) > 0.1
    assert 0.0 < result["pitch_deg"]["rms"] < result["pitch_deg"]["largest"]
    assert result["first_tick"] >= first_setpoint(flight)


def test_the_same_settings_have_no_difference(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also with a fleet file that differs from that of the others in something that does not matter here."""
    code, out, _ = replayed(flight, capsys, "--set", "fleet.land_below_percent=1.0", "--json")
    assert code == 0
    for result in json.loads(out)["vehicles"]:
        assert result["first_tick"] is None
        assert result["commands"] > 100
        assert result["only_recorded"] == result["only_computed"] == 0


def test_the_table_of_other_settings(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = replayed(
        flight, capsys, "--set", "fleet.law.parameters.position_gain_1_s2=0.5", "--set", "vehicle.drag_1_s=0.1"
    )
    assert code == 0
    heading, columns, *vehicles = out.splitlines()
    assert heading.startswith("with fleet.law.parameters.position_gain_1_s2=0.5, vehicle.drag_1_s=0.1, against")
    assert len(vehicles) == 2
    assert all(line.startswith("vehicle ") and " tick " in line for line in vehicles)
    assert max(map(len, (columns, *vehicles))) <= 120


@pytest.mark.parametrize(
    ("override", "reason"),
    [
        ("fleet.law.nam=weighted", '--set: fleet.law.nam: unknown key; did you mean "name"?'),
        ("law=weighted", "--set: law: unknown key"),
        ("fleet.law", "expected KEY=VALUE, like fleet.law.name=average_22"),
        ("vehicle.drag_1_s=-1", "--set: vehicle.drag_1_s: -1: expected"),
        ("vehicle.reference.point_enu_m=[0, 0, 400]", "--set: vehicle.reference"),
        ("fleet.vehicles=[]", "--set: fleet.vehicles: is empty"),
    ],
)
def test_a_setting_that_cannot_be_used_is_refused(
    override: str, reason: str, flight: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = replayed(flight, capsys, "--set", override)
    assert (code, out) == (2, "")
    assert reason in err


def test_what_is_recorded_is_what_the_codec_writes(flight: Path) -> None:
    """The comparison is of bytes first."""
    for tick in recording_of(flight, 1).ticks(print):
        assert encode_outbox(tick.now_s, tick.outbox()) == tick.output
