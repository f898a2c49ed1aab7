"""One vehicle on the bench: the agent's own link with nobody else on it, and mavsdk on the same bytes."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any

from companion.config.vehicle import AgentConfig
from companion.config_file import ConfigError
from companion.link.autopilot_link import AutopilotLink, AutopilotSilentError
from companion.link.endpoint import LinkError
from companion.link.mavsdk_bridge import MavsdkBridge
from companion.link.signing_key import read_signing_key
from companion.mavlink.translator import Translator

LISTEN_PERIOD_S = 0.05


class Bench:
    """`link.receive()` must run meanwhile; what came since the last `link.drain()` is its caller's."""

    def __init__(self, file: Path, config: AgentConfig) -> None:
        """Opens the link. Raises ConfigError."""
        self._file, self._vehicle = file, config.vehicle
        vehicle = config.vehicle
        key = read_signing_key(file, vehicle.signing) if vehicle.signing else None
        try:
            self.link = AutopilotLink(
                vehicle.id,
                vehicle.mavlink,
                Translator(vehicle.id, vehicle.autopilot, key),
                position_arrived=lambda: None,
                reject=lambda _reason: None,
            )
        except LinkError as error:
            raise ConfigError(file, "mavlink", f'"{vehicle.mavlink}": {error}') from error
        self._bridge = MavsdkBridge(vehicle.id, self.link.relay)
        self.link.pass_on_to(self._bridge.receive)

    async def system(self, wait_s: float) -> Any | None:
        """mavsdk's handle of the autopilot, for its plugins; None where no HEARTBEAT comes within this time."""
        give_up_s = time.monotonic() + wait_s
        while not self.link.heard:
            if time.monotonic() > give_up_s:
                return None
            await asyncio.sleep(LISTEN_PERIOD_S)
        return await self._bridge.system(wait_s)

    def silence(self, wait_s: float) -> AutopilotSilentError:
        """What to raise where `system` came to nothing."""
        return AutopilotSilentError(self._file, self._vehicle, wait_s, self.link.why_silent())

    def close(self) -> None:
        """After the plugins."""
        self._bridge.close()
        self.link.close()
