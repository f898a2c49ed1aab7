"""Link to one vehicle for bench commands (doctor, logs): the agent's MAVLink link, with mavsdk on the same bytes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Coroutine
from pathlib import Path
from typing import Any, Protocol, TypeVar

from companion.config.file import ConfigError
from companion.config.vehicle import AgentConfig
from companion.link.autopilot_link import AutopilotLink, AutopilotSilentError
from companion.link.endpoint import LinkError
from companion.link.mavsdk_bridge import MavsdkBridge
from companion.link.signing_key import read_signing_key
from companion.mavlink.translator import Translator

LISTEN_PERIOD_S = 0.05

Outcome = TypeVar("Outcome")


class Bench:
    """The link with mavsdk beside it. `link.receive()` must run meanwhile; the caller drains the telemetry."""

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
        """mavsdk's handle of the autopilot, for its plugins. None without a HEARTBEAT within this time."""
        give_up_s = time.monotonic() + wait_s
        while not self.link.is_connected:
            if time.monotonic() > give_up_s:
                return None
            await asyncio.sleep(LISTEN_PERIOD_S)
        return await self._bridge.system(wait_s)

    def silence(self, wait_s: float) -> AutopilotSilentError:
        """The error for an autopilot that did not answer."""
        return AutopilotSilentError(self._file, self._vehicle, wait_s, self.link.why_silent())

    def close(self) -> None:
        """Close the link, after mavsdk's plugins."""
        self._bridge.close()
        self.link.close()


class BenchSession(Protocol):
    """One command's use of a bench."""

    bench: Bench

    def jobs(self) -> tuple[Coroutine[None, None, None], ...]:
        """Background jobs that run until cancelled, among them `link.receive()`."""

    async def connect(self, wait_s: float) -> bool:
        """Whether the autopilot answers within this time."""


async def run_on_bench(session: BenchSession, wait_s: float, work: Callable[[], Awaitable[Outcome]]) -> Outcome:
    """Run `work` beside the session's jobs when the autopilot answers. Raises AutopilotSilentError if it does not."""
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(job) for job in session.jobs()]
        outcomes = [await work()] if await session.connect(wait_s) else []
        for task in tasks:
            task.cancel()
    if not outcomes:
        raise session.bench.silence(wait_s)
    return outcomes[0]
