"""Flight logs of the autopilot by mavsdk: the list, and downloads one at a time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mavsdk.plugins.log_files import Entry, LogFiles, LogFilesError, LogFilesResult, ProgressData

LIST_TRIES = 3
POLL_PERIOD_S = 0.25
STALLED_AFTER_S = 20.0  # without a byte: mavsdk itself requests without end, and writes 8 KiB at a time
STOPPED_WITHIN_S = 2.0
FIRST_SET_YEAR = 2000  # an autopilot clock that was never set is in 1970 or 1980


class FlightLogsError(Exception):
    """A list or a log that could not be read. `str()` is the reason."""


class NothingCameError(FlightLogsError):
    """The autopilot did not answer, or stopped answering."""


@dataclass(frozen=True, slots=True)
class LogEntry:
    """One log of the autopilot's list (LOG_ENTRY). PX4 counts from 0, ArduPilot from 1.

    `date_utc` is the time of the last write; None where the autopilot's clock was not set.
    """

    id: int
    date_utc: datetime | None
    size_bytes: int


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
