"""Fleets that were provisioned as an operator does it, and the parts of them that tests need."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from companion.cli.main import main
from companion.security.names import ParticipantName, ParticipantRole, participant_name
from companion.security.provisioning import Provisioned, provision_new

NOW = datetime(2026, 11, 22, 12, 0, 0, tzinfo=UTC)
GROUND = participant_name(ParticipantRole.GROUND, "anna")


def fleet_files(folder: Path, vehicles: int = 2, name: str = "alpha") -> Path:
    """The files of real vehicles, by `companion init`."""
    arguments = [str(folder), "--vehicles", str(vehicles), "--origin", "47.4", "8.5", "488", "--name", name]
    assert main(["init", *arguments]) == 0
    return folder


def provisioned(
    folder: Path, *wanted: ParticipantName, vehicles: int = 2, name: str = "alpha", now: datetime = NOW
) -> Provisioned:
    """A new fleet with identities for its vehicles, the wanted participants, and ground-anna where no ground is wanted."""
    return provision_new(fleet_files(folder, vehicles, name), wanted, GROUND, 365, now)


def tree(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Permissions and content of every file and folder, by path."""
    return {
        str(path.relative_to(folder)): (path.stat().st_mode, path.read_bytes() if path.is_file() else b"")
        for path in sorted(folder.rglob("*"))
    }
