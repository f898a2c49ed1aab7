"""Identities of a small fleet, and sessions of strangers who use other programs than ours."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import zenoh

from companion.link.fleet.identity import load
from companion.link.fleet.zenoh_session import SETTINGS
from companion.security.identity import Identity
from companion.security.names import parse_common_name
from companion.security.provisioning import provision_new, revoke

FLEET_NAME = "secured"
VEHICLES = (1, 2, 3)
OTHERS = ("ground-anna", "ground-ben", "monitor-tower", "target-beacon", "traffic-adsb")
GROUND = parse_common_name("ground-anna")
FLEET = (
    f"name: {FLEET_NAME}\norigin: indoor\nvehicles:\n"
    + "".join(
        f"  - {{id: {i}, role: {'leader' if i == 1 else 'follower'}, slot_enu_m: [{-1.5 * i}, 0.0, 0.0]}}\n"
        for i in VEHICLES
    )
    + "neighbours: {kind: edges, edges: [[1, 2], [2, 3]]}\n"
)
VEHICLE = "id: {id}\nfleet: fleet.yaml\nmavlink: udpin:127.0.0.1:14540\nhover_thrust_norm: 0.5\n"
REFERENCE = "reference: {kind: point, point_enu_m: [0.0, 0.0, 2.0]}\n"


@dataclass(frozen=True)
class Identities:
    """A provisioned fleet in `folder`; folders of the identities by name."""

    folder: Path

    def folder_of(self, name: str) -> Path:
        return self.folder / "copy" / name / "identity"

    def of(self, name: str) -> Identity:
        return load(self.folder_of(name), {})

    def revoke(self, *names: str) -> Path:
        """The new admission list."""
        revoke(self.folder, names, datetime.now(UTC))
        return self.folder / "authority" / "admitted.json"


def provisioned(folder: Path, age: timedelta = timedelta(0), days: int = 30) -> Identities:
    """A fleet whose certificates were made `age` ago."""
    folder.mkdir(parents=True)
    (folder / "fleet.yaml").write_text(FLEET, encoding="utf-8")
    for i in VEHICLES:
        text = VEHICLE.format(id=i) + (REFERENCE if i == 1 else "")
        (folder / f"vehicle-{i}.yaml").write_text(text, encoding="utf-8")
    provision_new(folder, [parse_common_name(name) for name in OTHERS], GROUND, days, datetime.now(UTC) - age)
    return Identities(folder)


def stranger(endpoint: str, tls: Mapping[str, Any] | None = None) -> zenoh.Session:
    """A session without access control of its own, as another program opens it."""
    config = zenoh.Config()
    for path, value in {**SETTINGS, **({"transport/link/tls": dict(tls)} if tls else {})}.items():
        config.insert_json5(path, json.dumps(value))
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    return zenoh.open(config)


def tls_of(own: Path, authority: Path | None = None) -> dict[str, Any]:
    """TLS with the key in a folder; `authority` is the certificate that it trusts."""
    return {
        "root_ca_certificate": str(authority or own / "authority.pem"),
        "connect_private_key": str(own / "private.key"),
        "connect_certificate": str(own / "certificate.pem"),
        "enable_mtls": True,
        "verify_name_on_connect": False,
    }
