"""`companion logs`: the command line of the autopilot's flight logs."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.cli.options import add_vehicle_file
from companion.cli.vehicle_link import exit_code_of

NAME = "logs"
SUMMARY = "lists and downloads the flight logs of a vehicle's autopilot"
MAX_LOG_ID = 65535  # LOG_ENTRY.id has 16 bits
DESCRIPTION = """\
List the flight logs of the autopilot, or download some. Refused while the vehicle is armed.
"""

MORE = """\
examples:
  companion logs --config /etc/companion/vehicle-1.yaml
  companion logs --config /etc/companion/vehicle-1.yaml --get last
  companion logs --config /etc/companion/vehicle-1.yaml --get 3 4 --out logs
  companion logs --config vehicle-1.yaml --json | jq '.logs[].size_bytes'

Only one program can use the autopilot's link: stop the agent first (systemctl stop companion@1).
Ids are those of the autopilot: PX4 counts from 0, ArduPilot from 1, and both restart the count
when a log is deleted. Dates are UTC, of the last write to a log; ArduPilot reports the present
date for its newest log. `last` is the newest log. ArduPilot writes for 15 s after disarming, and
reading would end the log and begin another: a download waits for that. A PX4 log that is still
being written has the length it had when it was listed.

A log becomes DIR/vehicle-ID_DATE_TIME_log-ID.ulg (.bin of an ArduPilot) once it is complete;
until then its name ends in .part. A file that exists with the size of the log is not downloaded
again, and no file is overwritten. Logs are never deleted on the vehicle.

exit codes:
  0    listed, or every requested log is in DIR
  1    there are no logs, a requested log is missing or incomplete, or the vehicle is armed
  2    a file, a folder, an endpoint or an argument cannot be used, or the link is in use
  3    the autopilot never answered
  130  ended by Ctrl-C; no incomplete log is left
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_vehicle_file(parser)
    parser.add_argument(
        "--get",
        nargs="+",
        type=_requested_log,
        default=[],
        metavar="ID",
        help="download these logs, `last` or `all`, instead of listing them",
    )
    parser.add_argument(
        "--out", type=Path, default=Path(), metavar="DIR", help="folder for downloads, created if missing (default: .)"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output instead of the lines")


def run(options: argparse.Namespace) -> int:
    """The exit code."""
    from companion.tools.logs import LogsOptions, run_logs

    chosen = LogsOptions(options.config, options.wait_s, tuple(options.get), options.out, options.json)
    return exit_code_of(lambda: run_logs(chosen))


def _requested_log(text: str) -> int | str:
    from companion.tools.logs import ALL, LAST

    if text in (ALL, LAST):
        return text
    if not text.isdecimal() or len(text) > len(str(MAX_LOG_ID)) or int(text) > MAX_LOG_ID:
        raise argparse.ArgumentTypeError(f"{text!r}, expected `all`, `last` or a number from 0 to {MAX_LOG_ID}")
    return int(text)
