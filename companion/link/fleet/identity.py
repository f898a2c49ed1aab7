"""The identity of this agent or ground program, with the newest admission list: from this computer and over the network."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from companion.config.atomic import write_file
from companion.config.file import ConfigError, read_regular
from companion.config.vehicle import AgentConfig
from companion.security.admission import MAX_LIST_BYTES, AdmissionError, accept
from companion.security.identity import ADMITTED_FILE, Identity, IdentityError, load_identity, read_admitted
from companion.security.names import ParticipantRole

if TYPE_CHECKING:
    from companion.link.fleet.zenoh_link import ZenohLink


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


CHECK_S = 0.4  # what a revoked participant sends is used for less than a second

_log = logging.getLogger(__name__)


class Admissions:
    """Looks for a newer list every CHECK_S. `kept` is the file for a list from the network.

    A list is verified in a thread: that takes up to 10 ms. A list that is refused changes nothing.
    """

    def __init__(self, identity: Identity, kept: Path, link: ZenohLink) -> None:
        self._authority = identity.authority
        self._copied = identity.authority_file.with_name(ADMITTED_FILE)
        self._kept = kept
        self._link = link
        self._held = identity.admitted
        self._seen: tuple[int, int] | None = self._stamp()

    async def run(self) -> None:
        """Until cancelled."""
        while True:
            await asyncio.sleep(CHECK_S)
            for data in self._link.admission_lists():
                if await self._consider(data, "from the network"):
                    await asyncio.to_thread(self._keep, data)
            if (stamp := self._stamp()) != self._seen:
                self._seen = stamp
                with contextlib.suppress(OSError):
                    content, _ = await asyncio.to_thread(read_regular, self._copied, MAX_LIST_BYTES)
                    await self._consider(content, f"in {self._copied}")

    async def _consider(self, data: bytes, where: str) -> bool:
        """Whether a list is newer than that held; then it holds from now on."""
        try:
            admitted = await asyncio.to_thread(accept, data, self._authority, self._held)
        except AdmissionError as error:
            _log.warning("admission list %s: %s", where, error)
            return False
        if admitted.number == self._held.number:
            return False
        gone = [one.name for one in self._held.participants if admitted.participant(one.name) is None]
        self._held = admitted
        self._link.admit(admitted)
        _log.warning("admission list %d %s; no longer admitted: %s", admitted.number, where, ", ".join(gone) or "-")
        return True

    def _keep(self, data: bytes) -> None:
        try:
            write_file(self._kept, data)
        except OSError as error:
            _log.warning("%s cannot be written: %s; the list holds until a restart", self._kept, error.strerror)

    def _stamp(self) -> tuple[int, int] | None:
        try:
            state = self._copied.stat()
        except OSError:
            return None
        return state.st_mtime_ns, state.st_size
