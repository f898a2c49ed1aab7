"""`companion doctor`: the command line of the check of one vehicle before flight."""

from __future__ import annotations

import argparse

from companion.cli.options import add_vehicle_file, fail
from companion.cli.vehicle_link import EXIT_FILE, exit_code_of

NAME = "doctor"
SUMMARY = "checks a vehicle before flight, or its companion computer (--host), and names what to set"
DESCRIPTION = """\
Check whether a vehicle can fly in formation. Connects to its autopilot as the agent does and
checks the link, the message rates, the estimator, the origin, the battery, the mode and the
parameters. One line for each: ok, warning or refusal, the value found, the value wanted, how to
set it. The agent refuses formation flight by the same table.

With --host it checks the companion computer instead: serial console, UART speed, supply voltage,
temperature, CPU governor, Wi-Fi power saving, clock, disk, kernel and Python. It needs no
autopilot and changes nothing. With --config it also checks the serial port of the vehicle file.
"""

MORE = """\
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_vehicle_file(parser, required=False)
    parser.add_argument("--host", action="store_true", help="check this companion computer instead of the vehicle")
    parser.add_argument(
        "--fix", action="store_true", help="set the parameters that are safe to set, after showing them"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the lines")


def run(options: argparse.Namespace) -> int:
    """The exit code."""
    if options.host and not options.fix:
        from companion.tools.host_checks import run_host

        return exit_code_of(lambda: run_host(options.config, options.json))
    if options.host:
        return fail("companion doctor: --host changes nothing: leave out --fix", EXIT_FILE)
    if options.config is None:
        return fail("companion doctor: --config FILE is needed, or --host for this computer alone", EXIT_FILE)
    from companion.tools.doctor import DoctorOptions, run_doctor

    return exit_code_of(lambda: run_doctor(DoctorOptions(options.config, options.wait_s, options.fix, options.json)))
