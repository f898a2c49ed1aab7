"""Commands over the link to one autopilot: `companion doctor` and `companion logs`."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.cli.options import add_json, add_vehicle_file, whole_number
from companion.cli.program import command
from companion.types.errors import UnusableError

MAX_LOG_ID = 65535  # LOG_ENTRY.id has 16 bits


def _add_doctor(parser: argparse.ArgumentParser) -> None:
    add_vehicle_file(parser, required=False)
    parser.add_argument("--host", action="store_true", help="check this companion computer instead of the vehicle")
    parser.add_argument(
        "--fix", action="store_true", help="set the parameters that are safe to set, after showing them"
    )
    add_json(parser, "one JSON object instead of the lines")


def _run_doctor(options: argparse.Namespace) -> int:
    """Check whether a vehicle can fly in formation. Connects to its autopilot as the agent does and
    checks the link, the message rates, the estimator, the origin, the battery, the mode and the
    parameters. One line for each: ok, warning or refusal, the value found, the value wanted, how to
    set it. The agent refuses formation flight by the same table.

    With --host it checks the companion computer instead: serial console, UART speed, supply voltage,
    temperature, CPU governor, Wi-Fi power saving, clock, disk, kernel and Python. It needs no
    autopilot and changes nothing. With --config it also checks the serial port of the vehicle file.

    examples:
      companion doctor --config /etc/companion/vehicle-1.yaml
      companion doctor --config /etc/companion/vehicle-1.yaml --fix
      companion doctor --config vehicle-1.yaml --json | jq '.findings[] | select(.verdict != "ok")'
      companion doctor --host --config /etc/companion/vehicle-1.yaml

    Only one program can use the autopilot's link: stop the agent first (systemctl stop companion@1).
    --fix shows all findings, sets the parameters that are safe to set, reads them again and shows
    what is left. It sets nothing while the vehicle is armed, never relaxes a failsafe and never takes
    a control from the pilot; those findings name how to set the parameter.

    exit codes:
      0    ready for formation flight; there may be warnings
      1    a refusal is left, or --fix could not set a parameter; with --host: there is a problem
      2    a file, an endpoint in it or an argument cannot be used, or the link is in use
      3    the autopilot never answered
      130  ended by Ctrl-C
    """

    if options.host and options.fix:
        raise UnusableError("companion doctor: --host changes nothing: leave out --fix")
    if options.host:
        from companion.tools.host_checks import run_host

        return run_host(options.config, options.json)
    if options.config is None:
        raise UnusableError("companion doctor: --config FILE is needed, or --host for this computer alone")
    from companion.tools.doctor import DoctorOptions, run_doctor

    return run_doctor(DoctorOptions(options.config, options.wait_s, options.fix, options.json))


def _add_logs(parser: argparse.ArgumentParser) -> None:
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
    add_json(parser, "one JSON object on standard output instead of the lines")


def _run_logs(options: argparse.Namespace) -> int:
    """List the flight logs of the autopilot, or download some. Refused while the vehicle is armed.

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

    from companion.tools.logs import LogsOptions, run_logs

    return run_logs(LogsOptions(options.config, options.wait_s, tuple(options.get), options.out, options.json))


def _requested_log(text: str) -> int | str:
    return text if text in ("all", "last") else whole_number(0, MAX_LOG_ID, "`all`, `last` or a number")(text)


DOCTOR = command(
    "doctor",
    "checks a vehicle before flight, or its companion computer (--host), and names what to set",
    _add_doctor,
    _run_doctor,
)


LOGS = command("logs", "lists and downloads the flight logs of a vehicle's autopilot", _add_logs, _run_logs)
