"""The identity of this agent or ground program, with the newest admission list that this computer holds."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from companion.config.file import ConfigError
from companion.config.vehicle import AgentConfig
from companion.security.identity import ADMITTED_FILE, Identity, IdentityError, load_identity, read_admitted
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
    """The identity in a folder. Raises ConfigError.

    A list in the state folder that this authority did not sign is left alone: it is that of an earlier authority.
    """
    credentials = environment.get("CREDENTIALS_DIRECTORY", "")
    identity = load_identity(folder, datetime.now(UTC), Path(credentials) if credentials else None)
    kept = list_file(folder, environment)
    if kept.parent == folder or not kept.exists():
        return identity
    try:
        admitted = read_admitted(kept, identity.authority)
    except IdentityError as error:
        logging.getLogger(__name__).warning("%s; the list in %s is used", error, folder)
        return identity
    return replace(identity, admitted=admitted) if admitted.number > identity.admitted.number else identity


def list_file(folder: Path, environment: Mapping[str, str]) -> Path:
    """Where a newer admission list is kept: in the state folder of the systemd unit, else with the identity."""
    state = environment.get("STATE_DIRECTORY", "")
    return (Path(state) if state else folder) / ADMITTED_FILE
