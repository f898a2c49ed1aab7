"""Log on standard error: one line per event, never one per tick, and few of each code."""

from __future__ import annotations

import logging
import os
import queue
import select
import sys
import threading
from collections.abc import Mapping
from typing import Any

from companion.mavlink.codec import mavlink
from companion.types.commands import Command, CommandReply
from companion.types.flight import HealthFlag
from companion.types.notices import Notice
from companion.types.rejections import rejection_text
from companion.types.values import printable_lines

REPEAT_AFTER_S = 1.0  # a key is logged again after this time
BURST = 20  # lines of one code at once
LINES_PER_S = 1.0  # then at most this many lines of one code
LINES_KEPT = 500  # that wait for the stream
FLUSH_S = 1.0
COMMAND, CHECK = "command", "check of"  # before the name of a command
FLAGS = frozenset(str(flag) for flag in HealthFlag)

_log = logging.getLogger(__name__)


class PrintableFormatter(logging.Formatter):
    """Log lines without the control characters of foreign text."""

    def format(self, record: logging.LogRecord) -> str:
        return printable_lines(super().format(record))


class DroppingHandler(logging.Handler):
    """Writes lines to a file descriptor in a thread of its own. A line that finds the queue full is dropped.

    So a stopped terminal, a full pipe or a journal that hangs never stops the caller. The next line that is kept has the
    number of those dropped before it. `flush`, and with it the end of the process, waits for FLUSH_S at most.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._waiting: queue.Queue[Any] = queue.Queue(LINES_KEPT)
        self.dropped = 0
        threading.Thread(target=self._write_all, name="log", daemon=True).start()

    def emit(self, record: logging.LogRecord) -> None:
        """Put a line into the queue, or count it."""
        text = self.format(record)
        if self.dropped:
            text += f" ({self.dropped} lines dropped before, while the log took none)"
        try:
            self._waiting.put_nowait(self._make(record, text))
            self.dropped = 0
        except queue.Full:
            self.dropped += 1

    def flush(self) -> None:
        """Wait until all lines are written, FLUSH_S at most."""
        with self._waiting.all_tasks_done:
            self._waiting.all_tasks_done.wait_for(lambda: not self._waiting.unfinished_tasks, FLUSH_S)

    def _write_all(self) -> None:
        while True:
            self._write(self._waiting.get())
            self._waiting.task_done()

    def _make(self, _record: logging.LogRecord, text: str) -> Any:
        """What waits in the queue for `_write`; made by the caller's thread."""
        return text

    def _write(self, made: Any) -> None:
        write_line(self._descriptor, made)


def write_line(descriptor: int, text: str) -> None:
    """Wait until the line is written, or there is no reader any more.

    Not by sys.stderr: a thread that hangs in its buffer would abort the interpreter at its end.
    """
    left = f"{text}\n".encode(errors="replace")
    while left:
        try:
            left = left[os.write(descriptor, left) :]
        except BlockingIOError:
            select.select([], [descriptor], [])
        except OSError:  # there is no reader any more
            break


def log_to_stderr(vehicle_id: int) -> None:
    """Log lines like "12:00:01.234 vehicle 3: takeoff -> hold", in local time."""
    line = f"%(asctime)s.%(msecs)03d vehicle {vehicle_id}: %(message)s"
    log_to(DroppingHandler(sys.stderr.fileno()), PrintableFormatter(line, "%H:%M:%S"))


def log_to(handler: logging.Handler, formatter: logging.Formatter) -> None:
    """The only handler of this process."""
    handler.setFormatter(formatter)
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    # pymavlink has a line for each packet with an old signature.
    logging.getLogger(mavlink.logger.name).setLevel(logging.WARNING)


def flush_log() -> None:
    """Wait until what was logged is written, FLUSH_S at most: what is printed now comes last, such as why the agent ends."""
    for handler in logging.getLogger().handlers:
        handler.flush()


class LogLimiter:
    """Limits the lines of each code: a stranger on the network can cause any of them, as often as it sends.

    The first line after a pause is followed by up to BURST - 1 others, then by LINES_PER_S. A line that follows others that
    were left out has their number.
    """

    def __init__(self) -> None:
        self._kept: dict[str, tuple[float, float, int]] = {}  # by code: lines left, at this time, and lines left out

    def line(self, level: int, code: str, text: str, now_s: float) -> None:
        """Log a line of this code, or count it."""
        lines, before_s, left_out = self._kept.get(code, (float(BURST), now_s, 0))
        lines = min(BURST, lines + LINES_PER_S * (now_s - before_s))
        if lines < 1.0:
            self._kept[code] = (lines, now_s, left_out + 1)
            return
        self._kept[code] = (lines - 1.0, now_s, 0)
        more = f" ({left_out} more of {code} left out before)" if left_out else ""
        _log.log(level, "%s%s", text, more, extra=field_of(code))


def field_of(code: str) -> dict[str, str]:
    """`extra` of a log call: the code becomes a field of the journal."""
    return {"companion_code": code}


class AgentEventLog(LogLimiter):
    """Logs the events of the agent."""

    def log(self, event: Notice, now_s: float) -> None:
        """Log one event: a health flag as a warning."""
        level = logging.WARNING if event.code in FLAGS else logging.INFO
        self.line(level, event.code, str(event), now_s)


class RejectionLog(LogLimiter):
    """Logs counted rejections: once a second those that were added, by code."""

    def __init__(self) -> None:
        super().__init__()
        self._logged: dict[str, tuple[int, float]] = {}  # key -> (count, time)

    def update(self, counts: Mapping[str, int], now_s: float) -> None:
        """Log what was added. `counts` are totals since the start by key (see `rejection_key`)."""
        for key, count in counts.items():
            before, logged_s = self._logged.get(key, (0, float("-inf")))
            if count > before and now_s - logged_s >= REPEAT_AFTER_S:
                self._logged[key] = (count, now_s)
                text = f"rejected {count - before} ({count} in all): {key}: {rejection_text(key)}"
                self.line(logging.WARNING, key.partition(" ")[0], text, now_s)


class CommandLog(LogLimiter):
    """Logs every command, and every check of one, with its reply."""

    def log(self, kind: str, command: Command, reply: CommandReply, now_s: float) -> None:
        """Log one with its reply. `kind` is what it was, before its name."""
        outcome = "accepted" if reply.accepted else "refused"
        given = f"{kind} {command.name}, number {command.number} of {command.operator}"
        self.line(logging.INFO, reply.code, f"{given}: {outcome}, {reply.code}: {reply.reason}", now_s)
