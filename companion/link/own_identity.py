"""The identity of this agent or ground program, with the newest admission list that this computer holds."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from companion.config.file import ConfigError
from companion.config.vehicle import AgentConfig
from companion.security.admission import Admitted
from companion.security.certificates import read_certificate
from companion.security.identity import ADMITTED_FILE, Identity, load_identity, read_admitted
from companion.security.names import ParticipantRole


def vehicle_identity(vehicle_file: Path, config: AgentConfig, environment: Mapping[str, str] = os.environ) -> Identity:
    """The identity that the vehicle file names. Raises ConfigError."""
    assert config.vehicle.identity is not None
    identity = load(vehicle_file.parent / config.vehicle.identity, environment)
    if identity.role is not ParticipantRole.VEHICLE or identity.id != str(config.vehicle.id):
        problem = f"is that of {identity.common_name}; expected that of vehicle {config.vehicle.id}"
        raise ConfigError(vehicle_file, "identity", problem)
    if identity.fleet != config.fleet.name:
        problem = f'is of fleet "{identity.fleet}"; the fleet file is that of "{config.fleet.name}"'
        raise ConfigError(vehicle_file, "identity", problem)
    return identity


def load(folder: Path, environment: Mapping[str, str] = os.environ) -> Identity:
    """The identity in a folder. Raises ConfigError."""
    credentials = environment.get("CREDENTIALS_DIRECTORY", "")
    identity = load_identity(folder, datetime.now(UTC), Path(credentials) if credentials else None)
    kept = list_file(folder, environment)
    if kept.parent == folder or not kept.exists():
        return identity
    authority = read_certificate(identity.authority_file.read_bytes())
    return replace(identity, admitted=newer(identity.admitted, read_admitted(kept, authority)))


def list_file(folder: Path, environment: Mapping[str, str]) -> Path:
    """Where a newer admission list is kept: in the state folder of the systemd unit, else with the identity."""
    state = environment.get("STATE_DIRECTORY", "")
    return (Path(state) if state else folder) / ADMITTED_FILE


def newer(one: Admitted, other: Admitted) -> Admitted:
    return other if other.number > one.number else one
