"""One line per event on standard error, never one per tick."""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping

from companion.mavlink.codec import mavlink
from companion.types import Command, CommandReply

REPEAT_AFTER_S = 1.0
COMMANDS_A_SECOND = 20

_log = logging.getLogger(__name__)


def log_to_stderr(vehicle_id: int) -> None:
    """Lines like "12:00:01.234 vehicle 3: takeoff -> hold", in local time."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter(f"%(asctime)s.%(msecs)03d vehicle {vehicle_id}: %(message)s", "%H:%M:%S"))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    logging.getLogger(mavlink.logger.name).setLevel(
        logging.WARNING
    )  # it has a line for each packet with an old signature


class RejectionLog:
    """Logs counted rejections: at most one line per reason and second, with how many there were since the last one."""

    def __init__(self) -> None:
        self._logged: dict[str, tuple[int, float]] = {}  # reason -> (count, when)

    def update(self, counts: Mapping[str, int], now_s: float) -> None:
        """`counts` are totals since the start, by reason."""
        for reason, count in counts.items():
            before, logged_s = self._logged.get(reason, (0, float("-inf")))
            if count > before and now_s - logged_s >= REPEAT_AFTER_S:
                self._logged[reason] = (count, now_s)
                _log.warning("rejected %d (%d in all): %s", count - before, count, reason)


class CommandLog:
    """A line for every command with its answer; of more than COMMANDS_A_SECOND only how many there were."""

    def __init__(self) -> None:
        self._second = 0
        self._lines = 0
        self._left_out = 0

    def answered(self, command: Command, reply: CommandReply, now_s: float) -> None:
        if int(now_s) != self._second:
            if self._left_out:
                _log.warning("%d more commands", self._left_out)
            self._second, self._lines, self._left_out = int(now_s), 0, 0
        if self._lines >= COMMANDS_A_SECOND:
            self._left_out += 1
            return
        self._lines += 1
        outcome = "accepted" if reply.accepted else "refused"
        _log.info(
            "command %s, number %d of %s: %s, %s", command.name, command.number, command.operator, outcome, reply.reason
        )
