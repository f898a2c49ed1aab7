"""Flights with a law of one's own in a file: with memory, with values of its own in the packets; recorded and replayed."""

from __future__ import annotations

from pathlib import Path
from shutil import copyfile

import pytest

from common import ROOT
from companion.cli.main import main
from companion.config import code_file
from companion.config.file import ConfigError
from lockstep_fleet import CommandedFlight
from sitl.api import load
from sitl.flight.scenario import Scenario, load_scenario
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.report.progress import FlightProgress
from tests.helpers.bad_laws import write_law

FOUR = ROOT / "config" / "scenarios" / "four_in_line.yaml"
SHARES = """\
from companion.laws import Law
from companion.laws.cooperative import Cooperative


class Shares(Law, frozen=True):
    memory = 1
    publishes = 1

    def acceleration(self, own, neighbours, reference):
        x, y, z = Cooperative().acceleration(own, neighbours, reference)
        return (x, y, z + 0.001 * sum(other.values[0][0] for other in neighbours))

    def remember(self, own, neighbours, reference):
        return ((own.memory[0][0] + own.step_s, 0.0, 0.0),)

    def publish(self, own, neighbours, reference):
        return ((own.memory[0][0], float(len(neighbours)), own.slot_enu_m[0]),)
"""


def written(folder: Path, source: str = SHARES) -> Path:
    """A scenario that names the law beside it."""
    write_law(folder, "shares", source)
    copyfile(FOUR, folder / "four.yaml")
    text = (folder / "four.yaml").read_text(encoding="utf-8")
    path = folder / "four.yaml"
    path.write_text(text.replace("law: {name: cooperative}", "law: {name: shares, file: shares.py}"), encoding="utf-8")
    return path


def fly(scenario: Scenario, recordings: Path) -> None:
    quiet = FlightProgress("", True, began_s=0.0)
    with quiet:
        result = fly_in_virtual_time(scenario, quiet, recordings=recordings)
    assert result.failure is None


def test_neighbours_receive_what_a_vehicle_publishes(tmp_path: Path) -> None:
    flight = CommandedFlight(written(tmp_path), "timeline[3].for_s=3")
    flight.go_on(1.0)
    newest = {packet.sender.vehicle_id: packet.law_values for packet in flight.packets}
    for vehicle_id, neighbours, slot_m in ((1, 1, 0.0), (2, 2, -3.0), (3, 2, -6.0), (4, 1, -9.0)):
        (time_s, count, slot_east_m) = newest[vehicle_id][0]
        assert (count, slot_east_m) == (neighbours, slot_m)
        assert 4.0 < time_s < 5.0  # in formation


def test_a_recorded_flight_replays_with_its_file_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, recordings = written(tmp_path), tmp_path / "recordings"
    settings = ["stand_in.sensors=ideal", "timeline[3].for_s=2", "timeline[4].for_s=0"]
    fly(load_scenario(path, settings), recordings)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir(mode=0o755)
    copy = write_law(elsewhere, "copy", SHARES)
    monkeypatch.setattr(code_file, "LOADED", {})  # as in a process of its own
    assert main(["replay", str(recordings)]) == 2
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 4
    assert all(line.endswith(f"companion replay {recordings} --code {tmp_path / 'shares.py'}") for line in said)
    assert main(["replay", str(recordings), "--code", str(copy)]) == 0
    assert capsys.readouterr().out.count("all equal") == 4
    assert main(["replay", str(recordings), "--law", "cooperative"]) == 0
    assert "4 " in capsys.readouterr().out
    monkeypatch.setattr(code_file, "LOADED", {})
    beside = write_law(recordings, "shares", f"{SHARES}\n# changed\n")
    assert main(["replay", str(recordings)]) == 2
    assert "a recording has no code" in capsys.readouterr().out
    beside.write_text(copy.read_text(encoding="utf-8"), encoding="utf-8")
    assert main(["replay", str(recordings), "--vehicle", "2"]) == 2
    assert f"--code {beside}" in capsys.readouterr().out  # named, and not run unasked
    assert main(["replay", str(recordings), "--vehicle", "2", "--code", str(beside)]) == 0


def test_a_flight_with_another_file_is_another_formation(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("one", "two", "three")]
    for folder in folders:
        folder.mkdir()
    paths = [written(folders[0]), written(folders[1]), written(folders[2], f"{SHARES}\n# changed\n")]
    one, two, other = (load_scenario(path).fleet.formation_hash() for path in paths)
    assert one == two != other


def test_a_file_of_another_content_than_wanted_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path)
    with pytest.raises(ConfigError, match=r"fleet\.law\.sha256: shares\.py has [0-9a-f]{64}, which is another one"):
        load_scenario(path, [f"fleet.law.sha256='{'0' * 64}'"])


def test_another_law_leaves_the_file_and_its_parameters_behind(tmp_path: Path) -> None:
    path = written(tmp_path)
    assert load(path, law="cooperative").fleet.law.file is None
    named = load_scenario(path, ["fleet.law.name=cooperative"]).fleet.law
    assert (named.file, named.sha256, named.parameters) == (None, None, {})
    back = load(FOUR, {"fleet.law.name": str(path.parent / "shares.py")}).fleet.law
    assert (back.name, back.file) == ("shares", str(path.parent / "shares.py"))
