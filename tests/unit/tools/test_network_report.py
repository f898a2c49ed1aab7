"""What `companion doctor` says of the network."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path

import pytest

from companion.config.vehicle import load_agent
from companion.tools.doctor import network_line
from secured_fleet import provisioned


def line(folder: Path, vehicle: str = "", fleet: str = "") -> str:
    file = folder / "vehicle-2.yaml"
    file.write_text(file.read_text() + vehicle)
    (folder / "fleet.yaml").write_text((folder / "fleet.yaml").read_text() + fleet)
    return network_line(file, load_agent(file))


@pytest.mark.parametrize(
    ("vehicle", "fleet", "expected"),
    [
        ("", "", "ok       network: reached from this computer only"),
        ("", "security: none\n", "warning  network: UNSECURED: strangers"),
        ("identity: copy/vehicle-2/identity\n", "", "warning  network: identity vehicle-2, valid until "),
        ("identity: copy/vehicle-1/identity\n", "", "REFUSAL  network: "),
        ("identity: nowhere\n", "", "REFUSAL  network: "),
    ],
)
def test_the_protection_is_named(tmp_path: Path, vehicle: str, fleet: str, expected: str) -> None:
    folder = provisioned(tmp_path / "fleet", days=20).folder
    assert line(folder, vehicle, fleet).startswith(expected)


def test_an_identity_that_lasts_is_in_order(tmp_path: Path) -> None:
    folder = provisioned(tmp_path / "fleet", timedelta(0), 300).folder
    assert line(folder, "identity: copy/vehicle-2/identity\n").startswith(
        "ok       network: identity vehicle-2, valid "
    )


def test_an_expired_identity_is_refused_as_the_agent_refuses_it(tmp_path: Path) -> None:
    folder = provisioned(tmp_path / "fleet", timedelta(days=30), 20).folder
    assert "has expired" in line(folder, "identity: copy/vehicle-2/identity\n")
