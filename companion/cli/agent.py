"""`companion agent`: the command line of the onboard agent."""

from __future__ import annotations

import argparse

from companion.cli.options import add_vehicle_file, fail
from companion.cli.vehicle_link import EXIT_DEFECT, exit_code_of
from companion.cli.without_openssl import leave_out_openssl

NAME = "agent"
SUMMARY = "runs on each vehicle, beside its autopilot"
DESCRIPTION = """\
Run the agent of one vehicle. It reads telemetry from the autopilot over MAVLink and the states of
the peers over Zenoh, and sends attitude and thrust setpoints at 50 Hz. It starts in phase observe
and sends no setpoint before a command.
"""

MORE = """\
examples:
  companion agent --config config/vehicles/simulation-1.yaml
  companion agent --config /etc/companion/vehicle-3.yaml --wait-s 60

The vehicle file names the autopilot and the peers (examples: config/vehicles/):
  mavlink: udpin:0.0.0.0:14540             listen where the autopilot sends (PX4's onboard link)
  mavlink: tcp:192.168.1.20:5760           connect
  mavlink: serial:/dev/ttyAMA0:921600      a telemetry port of the flight controller
The HEARTBEAT identifies PX4 or ArduCopter; `autopilot: px4` or `autopilot: ardupilot` in the
vehicle file requires one of them.

SIGTERM and SIGINT (Ctrl-C) end the agent. A vehicle in formation is first handed over to the
autopilot's hold mode, for at most 2 s. Each event is one line on standard error.

exit codes:
  0  ended by a signal
  2  a file, an endpoint in it or an argument cannot be used; standard error has the reason
  3  the autopilot never answered
  4  a defect: level attitude and the autopilot's hold mode were sent first; standard error has the reason
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_vehicle_file(parser)


def run(options: argparse.Namespace) -> int:
    """The exit code."""
    leave_out_openssl()
    return exit_code_of(lambda: _run(options))


def _run(options: argparse.Namespace) -> int:
    """Raises ConfigError and AutopilotSilentError."""
    try:
        from companion.app import Settings, run_agent
        from companion.link.control_loop import AgentFailedError
    except KeyboardInterrupt:  # the usual end, here before the agent handles signals itself
        return 0
    try:
        run_agent(Settings(options.config, options.wait_s))
    except KeyboardInterrupt:
        return 0
    except AgentFailedError as error:
        return fail(str(error), EXIT_DEFECT)
    return 0
