"""Identities for the written files of a simulated fleet, as `companion provision` makes them for a real one."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from companion.security.names import parse_common_name
from companion.security.provisioning import provision_new
from sitl.flight.files import ids_of
from sitl.flight.scenario import Scenario

LINE = re.compile("^identity: .*$", re.MULTILINE)


def provision(
    scenario: Scenario, folder: Path, keys: Path, others: Sequence[str], age: timedelta = timedelta(0), days: int = 30
) -> None:
    """Identities in `keys`, made `age` ago, for the fleet whose files are in `folder`, and for `others`, a ground first."""
    keys.mkdir()
    (keys / "fleet.yaml").write_bytes((folder / "fleet.yaml").read_bytes())
    for i in ids_of(scenario):
        text = _naming(folder / f"vehicle_{i}.yaml", "identity")
        (keys / f"vehicle-{i}.yaml").write_text(text, encoding="utf-8")
    names = [parse_common_name(name) for name in others]
    provision_new(keys, names, names[0], days, datetime.now(UTC) - age)


def use_identities(scenario: Scenario, folder: Path, keys: Path) -> None:
    """Name the identities in the vehicle files. `keys` is within `folder`."""
    for i in ids_of(scenario):
        file, own = folder / f"vehicle_{i}.yaml", identity_folder(keys, f"vehicle-{i}").relative_to(folder)
        file.write_text(_naming(file, str(own)), encoding="utf-8")


def _naming(file: Path, identity: str) -> str:
    """The text of a vehicle file with this folder as its identity."""
    text = file.read_text(encoding="utf-8")
    named, count = LINE.subn(f"identity: {identity}", text)
    if count != 1:
        raise ValueError(f"{file}: expected one line with identity")
    return named


def identity_folder(keys: Path, name: str) -> Path:
    """Of one participant."""
    return keys / "copy" / name / "identity"
