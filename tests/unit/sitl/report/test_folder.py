"""Each results folder is used by one run."""

import subprocess
import sys
from pathlib import Path

import pytest

from sitl.report.folder import FolderInUseError, open_folder, results_folder

HOLD = """
import sys
from pathlib import Path
from sitl.report.folder import open_folder
with open_folder(Path(sys.argv[1]), "x"):
    print("open", flush=True)
    input()
"""


def test_default_folders_of_one_second_differ(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folders = [results_folder(None, "platoon-weighted") for _ in range(20)]
    assert len(set(folders)) == 20
    assert all(folder.is_dir() and folder.name.startswith("platoon-weighted-") for folder in folders)


def test_recordings_of_a_failed_run_without_tracks_are_removed(tmp_path: Path) -> None:
    """As with external autopilots, whose estimated tracks are written at the end of a flight."""
    for name in ("scenario.yaml", "agent_1.log", "vehicle_1_0001_001.mcap", "notes.txt"):
        (tmp_path / name).touch()
    with open_folder(tmp_path, "x"):
        assert [file.name for file in tmp_path.iterdir()] == ["notes.txt"]


def test_files_of_a_running_run_are_kept(tmp_path: Path) -> None:
    for name in ("scenario.yaml", "truth_1.csv"):
        (tmp_path / name).touch()
    with open_folder(tmp_path, "x"):
        assert list(tmp_path.iterdir()) == []  # files of an older run are removed
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == "open\n"
        for name in ("scenario.yaml", "truth_1.csv"):
            (tmp_path / name).touch()
        with pytest.raises(FolderInUseError, match="another run writes into it"), open_folder(tmp_path, "x"):
            pass
        assert len(list(tmp_path.iterdir())) == 2
        running.kill()
    with open_folder(tmp_path, "x"):  # the system has released the lock
        assert list(tmp_path.iterdir()) == []
