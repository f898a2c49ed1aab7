"""A law file that fails in flight, in virtual time: the vehicle is handed over to its autopilot, the others fly on.

tests/protocol/test_failing_law.py has a real process, also with a law that takes long.
"""

from __future__ import annotations

import json
from math import dist
from pathlib import Path
from shutil import copyfile

import pytest

from common import ROOT
from companion.cli.main import main
from companion.config.file import ConfigError
from companion.types.autopilot import AutopilotKind
from companion.types.flight import FlightPhase
from lockstep_fleet import CommandedFlight
from sitl.flight.scenario import load_scenario
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.report.progress import FlightProgress
from tests.helpers.bad_laws import BAD_LAWS, fails_later, write_law

FOUR = ROOT / "config" / "scenarios" / "four_in_line.yaml"
LAST = 4  # the vehicle in the westernmost slot
DEFECTS = {
    "raises": ("raise ValueError('no idea')", "the law raises ValueError: no idea"),
    "not_a_number": ("return (float('nan'), 0.0, 0.0)", "the law gives an acceleration of (nan, 0.0, 0.0) m/s^2"),
    "huge": ("return (1e9, 0.0, 0.0)", "the law gives an acceleration of (1000000000.0, 0.0, 0.0) m/s^2"),
    "wrong_shape": ("return (1.0, 2.0)", "the law raises ValueError: not enough values to unpack"),
}


def scenario_with(folder: Path, name: str, source: str) -> tuple[Path, str]:
    """A copy of the scenario beside a law file, and the setting that names it."""
    write_law(folder, name, source)
    copyfile(FOUR, folder / FOUR.name)
    return folder / FOUR.name, f"fleet.law={{name: {name}, file: {name}.py}}"


@pytest.mark.parametrize("defect", list(DEFECTS))
def test_it_ends_in_hold_and_the_others_fly_on(defect: str, tmp_path: Path) -> None:
    body, text = DEFECTS[defect]
    make = AutopilotKind.ARDUPILOT if defect == "huge" else AutopilotKind.PX4
    flight = CommandedFlight(
        *scenario_with(tmp_path, defect, fails_later(body, west_of_m=-8.0)),
        f"stand_in.autopilot={make}",
        "timeline[3].for_s=1",
    )
    flight.go_on(8.0)
    assert (LAST, "AGENT_FAILED") in {
        (i, flight.newest[i].last_event.code) for i in (LAST,) if flight.newest[i].last_event
    }
    assert any(text in event for event in flight.events_of(LAST))
    sent_s = max(packet.motion.sent_s for packet in flight.packets if packet.sender.vehicle_id == LAST)
    assert flight.lockstep.now_s() - sent_s > 2.0  # its process has ended
    stand_in = flight.lockstep.stand_ins[LAST - 1]
    assert stand_in.autopilot.mode.name == ("BRAKE" if make is AutopilotKind.ARDUPILOT else "LOITER")
    places = stand_in.track().position_enu_m
    assert dist(places[-1], places[-100]) < 0.3
    assert {flight.newest[i].phase for i in (1, 2, 3)} == {FlightPhase.FORMATION}


def test_the_failure_of_a_flight_and_its_report_begin_with_the_cause(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Vehicle 2 fails, and leaves those behind it without a leader."""
    body, text = DEFECTS["raises"]
    law = fails_later(f"if own.slot_enu_m[0] > -4.0: {body}", west_of_m=-2.0)
    path, setting = scenario_with(tmp_path, "raises", law)
    quiet = FlightProgress("", quiet=True, began_s=0.0)
    flown = fly_in_virtual_time(load_scenario(path, [setting]), quiet, recordings=tmp_path)
    assert flown.failure is not None
    assert flown.failure.startswith(f"vehicle 2: AGENT_FAILED: {text}; vehicle 3 left phase formation: LEADER_LOST: ")
    assert flown.failure.count(text) == 1
    assert main(["replay", str(tmp_path), "--vehicle", "2"]) == 1
    replayed = capsys.readouterr().out
    assert replayed.startswith("vehicle 2: tick ") and "UTC" not in replayed  # virtual time has no date
    assert replayed.endswith(f"  recorded no output\n  computed LawError: {text}\n")
    assert main(["report", str(tmp_path), "--json"]) == 1
    worst = json.loads(capsys.readouterr().out)["findings"][0]
    assert (worst["code"], worst["vehicle_id"], worst["text"]) == ("AGENT_FAILED", 2, text)


@pytest.mark.parametrize("name", list(BAD_LAWS))
def test_a_law_with_a_defect_that_shows_at_once_never_flies(name: str, tmp_path: Path) -> None:
    path, setting = scenario_with(tmp_path, name, BAD_LAWS[name])
    with pytest.raises(ConfigError) as caught:
        load_scenario(path, [setting])
    (line,) = caught.value.lines
    assert f"{name}.py" in line
