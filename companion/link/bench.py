"""Link to one vehicle for bench commands (doctor, logs): the agent's MAVLink link, with mavsdk on the same bytes.

mavsdk serves parameters, which are not on the 50 Hz path. It opens no port itself, so that the agent and the
doctor use the same endpoints and report the same errors.
"""

from __future__ import annotations

import asyncio
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar

from mavsdk import Configuration, Mavsdk
from mavsdk.logging import log_subscribe
from mavsdk.plugins.param import Param, ParamError, ParamResult

from companion.config.vehicle import AgentConfig
from companion.link.autopilot_link import AutopilotSilentError, open_autopilot_link, read_signing_key
from companion.mavlink.codec import mavlink
from companion.types.errors import CompanionError


class MavsdkBridge:
    """mavsdk as onboard computer of the vehicle's system. It sends no ground station heartbeat."""

    def __init__(self, vehicle_id: int, send: Callable[[bytes], None]) -> None:
        """`send` is called in the running loop and by `close`, for packets of any mavsdk thread."""
        log_subscribe(lambda *_: True)  # keep mavsdk's log lines off the terminal
        self._send = send
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[bytes] = deque()
        self._mavsdk = Mavsdk(Configuration.create_manual(vehicle_id, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, False))
        self._mavsdk.add_any_connection("raw://")
        self._mavsdk.subscribe_raw_bytes_to_be_sent(self._send_soon)

    def receive(self, packets: Sequence[bytes]) -> None:
        """Pass received packets to mavsdk."""
        for packet in packets:
            self._mavsdk.pass_received_raw_bytes(packet)

    async def system(self, wait_s: float) -> Any | None:
        """mavsdk's handle of the autopilot, for its plugins; None where it finds none within this time."""
        return await asyncio.to_thread(self._mavsdk.first_autopilot, wait_s)

    def close(self) -> None:
        """End mavsdk, then send what it sent last: an autopilot whose transfer is not ended would go on with it."""
        self._mavsdk.destroy()
        self._send_waiting()

    def _send_soon(self, packet: bytes) -> None:
        """In a thread of mavsdk."""
        self._waiting.append(packet)
        self._loop.call_soon_threadsafe(self._send_waiting)

    def _send_waiting(self) -> None:
        while self._waiting:
            self._send(self._waiting.popleft())


LISTEN_PERIOD_S = 0.05

Outcome = TypeVar("Outcome")


class Bench(ABC):
    """One command's use of the link, with mavsdk beside it."""

    def __init__(self, file: Path, config: AgentConfig) -> None:
        """Opens the link. Raises ConfigError."""
        self._file, self._vehicle = file, config.vehicle
        key = read_signing_key(file, config.vehicle.signing)
        self.link = open_autopilot_link(file, config.vehicle, key, lambda _arrived_s: None, lambda _reason: None)
        self._bridge = MavsdkBridge(config.vehicle.id, self.link.relay)
        self.listeners = [self._bridge.receive]  # all get the packets of the link
        self.link.pass_on_to(self._pass_on)

    @abstractmethod
    def jobs(self) -> tuple[Coroutine[None, None, None], ...]:
        """Background jobs that run until cancelled: `link.receive()`, and one that drains the telemetry."""

    @abstractmethod
    async def connected(self, system: Any) -> None:
        """The autopilot answers. `system` is mavsdk's handle of it, for its plugins."""

    async def run(self, wait_s: float, work: Callable[[], Awaitable[Outcome]]) -> Outcome:
        """Run `work` beside the jobs when the autopilot answers. Raises AutopilotSilentError if it does not in this time."""
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(job) for job in self.jobs()]
            outcomes = []
            if (system := await self._system(wait_s)) is not None:
                await self.connected(system)
                outcomes.append(await work())
            for task in tasks:
                task.cancel()
        if not outcomes:
            raise AutopilotSilentError(self._file, self._vehicle, wait_s, self.link.why_silent())
        return outcomes[0]

    def _pass_on(self, packets: Sequence[bytes]) -> None:
        for listener in self.listeners:
            listener(packets)

    async def _system(self, wait_s: float) -> Any | None:
        """None without a HEARTBEAT within this time."""
        give_up_s = time.monotonic() + wait_s
        while not self.link.is_connected:
            if time.monotonic() > give_up_s:
                return None
            await asyncio.sleep(LISTEN_PERIOD_S)
        return await self._bridge.system(wait_s)

    def close(self) -> None:
        """Close the link, after mavsdk's plugins."""
        self._bridge.close()
        self.link.close()


class ParameterError(CompanionError):
    """A parameter that could not be set. `str()` names it and the reason."""


class Parameters:
    """Reads and sets parameters of one autopilot. The autopilot reports which are integers."""

    def __init__(self, system: Any) -> None:
        """`system` is that of a MavsdkBridge."""
        self._param = Param(system)
        self._integers: dict[str, bool] = {}
        self.shortest_read_s: float | None = None  # of all reads that were answered

    async def read_all(self, names: Iterable[str]) -> dict[str, float | None]:
        """Values by name; None for a parameter without an answer."""
        return {name: await self.read(name) for name in names}

    async def read(self, name: str) -> float | None:
        """The value, or None after 3 s without an answer: an autopilot does not answer for an unknown parameter.

        A value that is not a finite number counts as none.
        """
        for is_integer, get in ((True, self._param.get_param_int), (False, self._param.get_param_float)):
            asked_s = time.monotonic()
            try:
                value = float(await asyncio.to_thread(get, name))
            except ParamError as error:
                if error.result is not ParamResult.WRONG_TYPE:
                    break
            else:
                self._integers[name] = is_integer
                read_s = time.monotonic() - asked_s
                self.shortest_read_s = min(read_s, self.shortest_read_s or read_s)
                return value if isfinite(value) else None
        return None

    async def set(self, name: str, value: float) -> None:
        """Set a parameter that was read before, and read it back. Raises ParameterError."""
        set_param, as_number = (
            (self._param.set_param_int, int) if self._integers[name] else (self._param.set_param_float, float)
        )
        try:
            await asyncio.to_thread(set_param, name, as_number(value))
        except ParamError as error:
            reason = error.result.name.lower().replace("_", " ")
            raise ParameterError(f"{name} could not be set to {value:g}: {reason}") from error
        read_back = await self.read(name)
        if read_back is None or abs(read_back - value) > 1e-6:
            shown = "nothing" if read_back is None else f"{read_back:g}"
            raise ParameterError(f"{name} was set to {value:g}, but the autopilot reports {shown}")

    def close(self) -> None:
        self._param.destroy()
