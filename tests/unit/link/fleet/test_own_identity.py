"""Which admission list a participant uses: the newest that its own authority signed."""

import shutil
from pathlib import Path

import pytest

from companion.link.fleet.identity import load
from companion.security.identity import ADMITTED_FILE
from secured_fleet import provisioned


def test_the_newer_of_two_lists_is_used(tmp_path: Path) -> None:
    fleet = provisioned(tmp_path / "fleet")
    own, state = fleet.folder_of("vehicle-1"), {"STATE_DIRECTORY": str(tmp_path)}
    first = shutil.copy(own / ADMITTED_FILE, tmp_path / "first.json")
    newer = fleet.revoke("ground-ben").read_bytes()
    for copied, kept in ((newer, first.read_bytes()), (first.read_bytes(), newer)):
        (own / ADMITTED_FILE).write_bytes(copied)
        (tmp_path / ADMITTED_FILE).write_bytes(kept)
        assert load(own, state).admitted.revocation("ground-ben")


def test_a_list_of_an_earlier_authority_is_left_alone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    earlier, fleet = provisioned(tmp_path / "earlier"), provisioned(tmp_path / "fleet")
    (tmp_path / ADMITTED_FILE).write_bytes(earlier.revoke("ground-ben").read_bytes())
    own = fleet.folder_of("vehicle-1")
    assert load(own, {"STATE_DIRECTORY": str(tmp_path)}).admitted == load(own, {}).admitted
    assert f"the list in {own} is used" in caplog.text
