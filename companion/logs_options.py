"""The command line of `companion logs`. Light to import: what talks to the autopilot is imported when it does."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

HIGHEST_ID = 65535  # LOG_ENTRY carries 16 bits
ALL, LAST = "all", "last"

DESCRIPTION = """\
The autopilot's own flight logs: list them, or download some. A vehicle that is armed is left alone.
"""

MORE = """\
examples:
  companion logs --config /etc/companion/vehicle-1.yaml
  companion logs --config /etc/companion/vehicle-1.yaml --get last
  companion logs --config /etc/companion/vehicle-1.yaml --get 3 4 --out logs
  companion logs --config vehicle-1.yaml --json | jq '.logs[].size_bytes'

The autopilot's link is one program's alone: stop the agent first (systemctl stop companion@1). Ids are the autopilot's own:
PX4 counts from 0, ArduPilot from 1, and both count anew when a log is deleted. Dates are UTC, of when a log was last
written to; ArduPilot tells the present one for its newest log. `last` is the newest log. ArduPilot writes on for 15 s after
disarming: a download waits for that, because to read would end the log and begin another. A log of PX4's that is still
written to comes as long as it was when it was listed.

A log becomes DIR/vehicle-ID_DATE_TIME_log-ID.ulg (.bin of an ArduPilot) once it is whole; until then it has .part behind its
name. A file that is there already, with the size of the log, is not asked for again, and none is ever overwritten. Logs are
never deleted on the vehicle.

exit codes:
  0    listed, or every log that was wanted is in DIR
  1    there are no logs, one that is wanted is not there or did not come whole, or the vehicle is armed
  2    a file, a folder, an endpoint or an argument cannot be used, or the link is in use
  3    the autopilot never answered
  130  ended by Ctrl-C; no half log is left
"""


@dataclass(frozen=True, slots=True)
class LogsOptions:
    """What the command line says. `wanted` holds ids, `all` and `last`; nothing only lists."""

    file: Path
    wait_s: float
    wanted: tuple[int | str, ...]
    folder: Path
    as_json: bool


def add_logs_arguments(parser: argparse.ArgumentParser) -> None:
    """All but --config and --wait-s, which the doctor has as well."""
    parser.add_argument(
        "--get",
        nargs="+",
        type=_wanted,
        default=[],
        metavar="ID",
        help="download these logs, `last` or `all`, instead of listing them",
    )
    parser.add_argument(
        "--out", type=Path, default=Path(), metavar="DIR", help="where to (default: here; made where it is not there)"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output instead of the lines")


def logs_options(parsed: argparse.Namespace) -> LogsOptions:
    return LogsOptions(parsed.config, parsed.wait_s, tuple(parsed.get), parsed.out, parsed.json)


def _wanted(text: str) -> int | str:
    if text in (ALL, LAST):
        return text
    if not text.isdecimal() or len(text) > len(str(HIGHEST_ID)) or int(text) > HIGHEST_ID:
        raise argparse.ArgumentTypeError(f"{text!r}, expected `all`, `last` or a number from 0 to {HIGHEST_ID}")
    return int(text)
