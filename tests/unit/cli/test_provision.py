"""`companion provision` as an operator types it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from companion.cli.main import main
from companion.security.provisioning import open_provisioned
from secured_fleet import fleet_files, tree


@pytest.fixture
def field(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Path:
    """The files of a fleet of two, and a login user whose name is no id."""
    monkeypatch.setenv("LOGNAME", "_Anna.Müller")
    folder = fleet_files(tmp_path / "field")
    capsys.readouterr()
    return folder


def provision(*arguments: str | Path) -> int:
    return main(["provision", *map(str, arguments)])


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """The one line on standard error."""
    capsys.readouterr()
    assert provision(*arguments) == 2
    output = capsys.readouterr()
    assert output.out == ""
    (line,) = output.err.splitlines()
    return line


def test_new_names_the_ground_after_the_login_user_and_says_what_is_next(
    field: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert provision("new", field) == 0
    output = capsys.readouterr().out
    assert "  new: ground-anna-m-ller, valid until 20" in output
    assert f"scp -r {field}/copy/vehicle-1 ADDRESS-OF-VEHICLE-1:\n" in output
    assert "sudo cp -r vehicle-N/. /etc/companion/" in output
    assert "mavlink.key in it is used only with signing:" in output
    assert "companion fleet admit" not in output
    assert f"Back up {field}/authority" in output


def test_every_kind_of_participant_is_listed(field: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("--ground", "anna", "ben", "--monitor", "tower", "--target", "beacon", "--traffic", "ADSB")
    assert provision("new", field, *arguments, "--days", "20") == 0
    assert provision("new", field) == 0
    assert "nothing new" in capsys.readouterr().out
    assert provision("list", field) == 0
    head, titles, *rows = capsys.readouterr().out.splitlines()
    assert head.startswith("fleet alpha, admission list 1 of 20")
    assert titles.split() == ["name", "serial", "valid", "until", "days", "left", "state"]
    assert [row.split()[0] for row in rows] == [
        "vehicle-1", "vehicle-2", "ground-anna", "ground-ben", "monitor-tower", "target-beacon", "traffic-ADSB"
    ]  # fmt: skip
    for row in rows:
        name, serial, _, days, state = row.split(maxsplit=4)
        entry = open_provisioned(field).admitted.participant(name)
        assert entry is not None
        assert entry.serial.startswith(serial)
        assert (days, state) == ("20", "admitted, renew soon")


def test_revoked_and_renewed_participants_are_listed(field: Path, capsys: pytest.CaptureFixture[str]) -> None:
    provision("new", field)
    assert provision("revoke", field, "vehicle-2") == 0
    output = capsys.readouterr().out
    assert f"companion fleet admit {field}/authority/admitted.json" in output
    assert "/etc/companion/identity/admitted.json" in output
    assert provision("new", field) == 0
    assert "  new: vehicle-2.2, valid until" in capsys.readouterr().out
    assert provision("renew", field, "vehicle-2", "--days", "100") == 0
    assert "  renewed: vehicle-2.2, valid until" in capsys.readouterr().out
    provision("list", field)
    rows = [row.split(maxsplit=4) for row in capsys.readouterr().out.splitlines()[2:]]
    assert [(row[0], row[3], row[4].split()[0]) for row in rows] == [
        ("vehicle-1", "365", "admitted"),
        ("ground-anna-m-ller", "365", "admitted"),
        ("vehicle-2.2", "100", "admitted"),
        ("vehicle-2", "-", "revoked"),
    ]


def test_every_refusal_is_one_line_with_the_file_and_what_to_do(
    field: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nowhere = tmp_path / "nowhere"
    assert refused(capsys, "new", nowhere) == (
        f"{nowhere}/fleet.yaml: no such file; companion init writes it, with the vehicle files"
    )
    assert refused(capsys, "renew", nowhere, "--all") == f"{nowhere}: No such file or directory; check the path"
    for action in (["list"], ["renew", "--all"], ["revoke", "vehicle-1"]):
        line = refused(capsys, action[0], field, *action[1:])
        assert line == f"{field}/authority: no such folder; companion provision new {field} creates it"
    file = field / "fleet.yaml"
    for arguments in (["list", file], ["new", file], ["renew", file, "--all"], ["revoke", file, "vehicle-1"]):
        assert refused(capsys, *arguments).startswith(f"{file}: is a file; expected the folder of the fleet file")
    provision("new", field)
    assert "expected names, or --all" in refused(capsys, "renew", field)
    assert "expected names, or --all" in refused(capsys, "renew", field, "vehicle-1", "--all")
    assert "vehicle-7: is not admitted" in refused(capsys, "revoke", field, "vehicle-7")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--days", "0"], "expected days from 1 to 3650"),
        (["--days", "1e3"], "expected days from 1 to 3650"),
        (["--ground", "Anna"], "'Anna', expected at most 32 lower-case letters"),
        (["--traffic", "a/b"], "'a/b', expected at most 32 letters"),
    ],
)
def test_wrong_arguments_are_refused(
    field: Path, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = tree(field)
    with pytest.raises(SystemExit) as caught:
        provision("new", field, *arguments)
    assert caught.value.code == 2
    assert words in capsys.readouterr().err
    assert tree(field) == before


def test_ctrl_c_leaves_nothing_that_is_not_admitted(field: Path) -> None:
    """A hundred participants take a while to write; the run ends as soon as it has begun to."""
    names = [f"t{number}" for number in range(100)]
    command = [sys.executable, "-m", "companion", "provision", "new", str(field), "--target", *names]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while run.poll() is None and not (field / "copy").exists():
        time.sleep(0.001)
    os.kill(run.pid, signal.SIGINT)
    _, errors = run.communicate(timeout=60)
    assert (run.returncode, errors) == (130, "interrupted\n")
    assert list(field.rglob("*.part")) == []
    assert list((field / "copy").iterdir()) == []
    assert open_provisioned(field).admitted.number == 0
    assert provision("new", field, "--target", *names) == 0
    assert len(open_provisioned(field).admitted.participants) == 103
