"""Link to one vehicle for bench commands (doctor, logs): the agent's MAVLink link, with mavsdk on the same bytes.

mavsdk serves what is not on the 50 Hz path: parameters and flight logs. It opens no port itself, so that the agent and the
doctor use the same endpoints and report the same errors.
"""

from __future__ import annotations

import asyncio
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from mavsdk import Configuration, Mavsdk
from mavsdk.logging import log_subscribe
from mavsdk.plugins.log_files import Entry, LogFiles, LogFilesError, LogFilesResult, ProgressData
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
        self.link = open_autopilot_link(file, config.vehicle, key, lambda: None, lambda _reason: None)
        self._bridge = MavsdkBridge(config.vehicle.id, self.link.relay)
        self.link.pass_on_to(self._bridge.receive)

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
        """The value, or None after 3 s without an answer: an autopilot does not answer for an unknown parameter."""
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
                return value
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


LIST_TRIES = 3
POLL_PERIOD_S = 0.25
STALLED_AFTER_S = 20.0  # without a byte: mavsdk itself requests without end, and writes 8 KiB at a time
STOPPED_WITHIN_S = 2.0
FIRST_SET_YEAR = 2000  # an autopilot clock that was never set is in 1970 or 1980


class FlightLogsError(CompanionError):
    """A list or a log that could not be read. `str()` is the reason."""


class NothingCameError(FlightLogsError):
    """The autopilot did not answer, or stopped answering."""


@dataclass(frozen=True, slots=True)
class LogEntry:
    """One log of the autopilot's list (LOG_ENTRY). PX4 counts from 0, ArduPilot from 1.

    `date_utc` is the time of the last write; None where the autopilot's clock was not set. `file` is its copy after a download.
    """

    id: int
    date_utc: datetime | None
    size_bytes: int
    file: str = ""


class FlightLogs:
    """Logs of one autopilot. They are never erased."""

    def __init__(self, system: Any) -> None:
        """`system` is that of a Bench."""
        self._system = system
        self._plugin = LogFiles(system)
        self._listed: dict[int, Entry] = {}

    async def entries(self) -> tuple[LogEntry, ...]:
        """All logs in order of id; empty where the autopilot reports none. Raises NothingCameError without a whole list.

        A failed request is repeated from the start. If the first entry is lost, mavsdk requests one past the last, ArduPilot
        answers with logs that do not exist, and mavsdk concludes that there are none. So an empty list counts only when every
        attempt gives it. LOG_REQUEST_END of a new plugin ends such a list.
        """
        result = LogFilesResult.UNKNOWN
        for attempt in range(LIST_TRIES):
            if attempt:
                self._plugin.destroy()
                self._plugin = LogFiles(self._system)
            result, entries = await self._ask()
            if result is LogFilesResult.SUCCESS:
                self._listed = {entry.id: entry for entry in entries}
                return tuple(_entry(entry) for _, entry in sorted(self._listed.items()))
        if result is LogFilesResult.NO_LOGFILES:
            return ()
        raise NothingCameError("no answer to the request for its list")

    async def _ask(self) -> tuple[LogFilesResult, list[Entry]]:
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[tuple[LogFilesResult, list[Entry]]] = loop.create_future()

        def on_entries(result: LogFilesResult, entries: list[Entry], _: object) -> None:
            loop.call_soon_threadsafe(_settle, answer, (result, entries))

        self._plugin.get_entries_async(on_entries)
        return await answer

    async def download(self, log: LogEntry, path: Path) -> AsyncGenerator[int, None]:
        """Write a listed log to `path`, which must not exist. Yields the number of bytes written until the log is complete.

        If closed early it cancels the transfer and mavsdk removes the file. Raises FlightLogsError.
        """
        if not log.size_bytes:  # mavsdk would refuse it
            path.touch()
            return
        loop = asyncio.get_running_loop()
        ended: asyncio.Future[LogFilesResult] = loop.create_future()

        def on_progress(result: LogFilesResult, _progress: ProgressData, _: object) -> None:
            if result is not LogFilesResult.NEXT:
                loop.call_soon_threadsafe(_settle, ended, result)

        self._plugin.download_log_file_async(self._listed[log.id], str(path), on_progress)
        try:
            written, written_s = _written(path), time.monotonic()
            while not ended.done():
                yield written[0]
                await asyncio.wait([ended], timeout=POLL_PERIOD_S)
                if (now := _written(path)) != written:
                    written, written_s = now, time.monotonic()
                elif time.monotonic() - written_s > STALLED_AFTER_S:
                    raise NothingCameError(f"no data for {STALLED_AFTER_S:.0f} s")
            if ended.result() is not LogFilesResult.SUCCESS:
                raise FlightLogsError(ended.result().name.lower().replace("_", " "))
            yield _written(path)[0]
        finally:
            if not ended.done():
                await self._stop(ended)

    async def _stop(self, ended: asyncio.Future[LogFilesResult]) -> None:
        try:
            await asyncio.to_thread(self._plugin.cancel_download_log_file)
        except LogFilesError:
            return
        await asyncio.wait([ended], timeout=STOPPED_WITHIN_S)

    def close(self) -> None:
        self._plugin.destroy()


def _entry(entry: Entry) -> LogEntry:
    date = datetime.strptime(entry.date, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC)
    return LogEntry(entry.id, date if date.year >= FIRST_SET_YEAR else None, entry.size_bytes)


def _settle(future: asyncio.Future[Any], value: object) -> None:
    if not future.done():
        future.set_result(value)


def _written(path: Path) -> tuple[int, int]:
    """Size in bytes and time of the last write in ns; a write into a gap changes only the time."""
    try:
        stat = path.stat()
    except FileNotFoundError:
        return 0, 0
    return stat.st_size, stat.st_mtime_ns
