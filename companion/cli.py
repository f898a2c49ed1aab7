"""The `companion` command. Each subcommand imports what it needs itself: the agent stays small."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from companion import __version__
from companion.ending import ending_quietly
from companion.fleet_options import DESCRIPTION as FLEET
from companion.fleet_options import MORE as FLEET_MORE
from companion.fleet_options import add_fleet_arguments, fleet_options
from companion.logs_options import DESCRIPTION as LOGS
from companion.logs_options import MORE as LOGS_MORE
from companion.logs_options import add_logs_arguments, logs_options

EXIT_CANNOT_CONVERGE, EXIT_FILE, EXIT_NO_AUTOPILOT = 1, 2, 3

DESCRIPTION = """\
Formation flight for quadrotors that carry a computer of their own.

  companion agent     runs on each vehicle, beside its autopilot
  companion doctor    says whether a vehicle is fit for it, and what to set, before it flies
  companion logs      lists and downloads the flight logs of a vehicle's autopilot
  companion fleet     commands a whole fleet from the ground
  companion monitor   shows it
  companion analyze   works out what a formation will do, before anyone flies it
"""

AGENT = """\
Run the agent of one vehicle: telemetry from its autopilot over MAVLink and the states of its peers over Zenoh in,
attitude and thrust out, 50 times a second. It starts as an observer and sends no setpoint until it is commanded to.
"""

AGENT_MORE = """\
examples:
  companion agent --config config/vehicles/simulation-1.yaml
  companion agent --config /etc/companion/vehicle-3.yaml --wait-s 60

The vehicle file says which autopilot and which peers; see config/vehicles/ for a serial line and for UDP:
  mavlink: udpin:0.0.0.0:14540             listen where the autopilot sends (PX4's onboard link)
  mavlink: tcp:192.168.1.20:5760           connect
  mavlink: serial:/dev/ttyAMA0:921600      a telemetry port of the flight controller
Its HEARTBEAT says whether it is a PX4 or an ArduCopter; `autopilot: px4` or `autopilot: ardupilot` insists on one.

SIGTERM and SIGINT (Ctrl-C) end it. A vehicle in formation is first handed over to the autopilot's own hold, for at
most 2 s. It logs one line per event to standard error.

exit codes:
  0  ended by a signal
  2  a file, an endpoint in it or an argument cannot be used; the one line on standard error says which and why
  3  the autopilot never answered
"""


DOCTOR = """\
Is this vehicle fit to fly in formation? Connects to its autopilot as the agent would, looks at the link, the rates that
it achieves, the estimator, the origin, the battery, the mode and the parameters that matter, and prints one line for each:
ok, warning or refusal, what it found, what it wants, how to set it. The agent refuses formation by the same table.
"""

DOCTOR_MORE = """\
examples:
  companion doctor --config /etc/companion/vehicle-1.yaml
  companion doctor --config /etc/companion/vehicle-1.yaml --fix
  companion doctor --config vehicle-1.yaml --json | jq '.findings[] | select(.verdict != "ok")'

The autopilot's link is one program's alone: stop the agent first (systemctl stop companion@1). --fix shows all, then sets
what is safe to set, reads it again and shows what is left. It sets nothing while the vehicle is armed, loosens no failsafe,
and takes no means from the pilot: what the pilot must decide stays a line that says how to set it.

exit codes:
  0    fit to fly in formation; there may be warnings
  1    a refusal stands, or --fix could not set what it meant to
  2    a file, an endpoint in it or an argument cannot be used, or the link is in use
  3    the autopilot never answered
  130  ended by Ctrl-C
"""


MONITOR = """\
Show every vehicle of a fleet, from Zenoh alone: phase, mode, altitude, PrC, error to its slot, age of its data.
A vehicle that says nothing for a second is shown as SILENT and stays in the table.
"""

MONITOR_MORE = """\
examples:
  companion monitor                                          the first eight vehicles of a simulation on this machine
  companion monitor --connect tcp/192.168.1.11:7447          a real fleet, through any one vehicle
  companion monitor --fleet platoon --once                   one table, for scripts
  companion monitor --once --json | jq '.[].error_to_slot_m'

One vehicle's endpoint (zenoh.listen in its vehicle file) leads to all that it is connected with; more endpoints help
where one vehicle may be away. On a terminal the table is live; into a pipe or a file it is printed once a second.

columns:
  PrC    cooperation priority: 1 is a leader, 2 hears one, 3 hears a 2, and so on
  error  metres from its place in the formation; - where it does not fly or no leader reports
  data   age of its position, with the way to here
  rej    messages that the vehicle has refused so far

exit codes:
  0  ended by Ctrl-C, or --once has heard at least one vehicle
  1  --once heard nobody for 3 s
  2  an argument cannot be used, or the live table's package is missing
"""


ANALYZE = """\
Work out what a formation will do, before anyone flies it: who hears whom, the interaction matrix G under each law, its
eigenvalues, rate, damping and delay margin, the largest and smallest distances to expect, and a verdict in words.
"""

ANALYZE_MORE = """\
examples:
  companion analyze config/scenarios/platoon.yaml
  companion analyze /etc/companion/fleet.yaml --json | jq '.laws.weighted.lambda_min'

A scenario says where the vehicles start and where they go; a fleet file alone is worked out for a step of 1 m. The
predictions come from a linear model with an attitude lag of 0.2 s and a delay of 50 ms, without noise and limits.

exit codes:
  0    the formation converges, whatever else the verdict says
  1    it cannot converge: a vehicle has no path to a leader, or the law is unstable with that lag and delay
  2    the file cannot be used
  130  ended by Ctrl-C
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code; `companion --help` explains it."""
    with ending_quietly():
        options = _parser().parse_args(arguments)
        run: Callable[[argparse.Namespace], int] = options.run
        try:
            return run(options)
        except KeyboardInterrupt:
            if options.run not in (_agent, _monitor):
                raise
            return 0  # their usual end, also before they are ready


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="companion",
        description=DESCRIPTION,
        epilog="`companion COMMAND --help` shows examples and exit codes.",
        formatter_class=raw,
    )
    parser.add_argument("--version", action="version", version=f"companion {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="agent|doctor|logs|fleet|monitor|analyze")

    agent = commands.add_parser("agent", description=AGENT, epilog=AGENT_MORE, formatter_class=raw)
    agent.add_argument("--config", type=Path, required=True, metavar="FILE", help="the vehicle file (YAML)")
    agent.add_argument(
        "--wait-s", type=_seconds, default=15.0, metavar="S", help="how long to wait for the autopilot (default 15)"
    )

    agent.set_defaults(run=_agent)

    doctor = commands.add_parser("doctor", description=DOCTOR, epilog=DOCTOR_MORE, formatter_class=raw)
    doctor.add_argument("--config", type=Path, required=True, metavar="FILE", help="the vehicle file (YAML)")
    doctor.add_argument("--fix", action="store_true", help="set what is safe to set, after showing it")
    doctor.add_argument("--json", action="store_true", help="one JSON object instead of the lines")
    doctor.add_argument(
        "--wait-s", type=_seconds, default=15.0, metavar="S", help="how long to wait for the autopilot (default 15)"
    )
    doctor.set_defaults(run=_doctor)

    logs = commands.add_parser("logs", description=LOGS, epilog=LOGS_MORE, formatter_class=raw)
    logs.add_argument("--config", type=Path, required=True, metavar="FILE", help="the vehicle file (YAML)")
    add_logs_arguments(logs)
    logs.add_argument(
        "--wait-s", type=_seconds, default=15.0, metavar="S", help="how long to wait for the autopilot (default 15)"
    )
    logs.set_defaults(run=_logs)

    fleet = commands.add_parser("fleet", description=FLEET, epilog=FLEET_MORE, formatter_class=raw)
    add_fleet_arguments(fleet)
    fleet.set_defaults(run=_fleet)

    monitor = commands.add_parser("monitor", description=MONITOR, epilog=MONITOR_MORE, formatter_class=raw)
    monitor.add_argument("--fleet", default="*", metavar="NAME", help="only this fleet (default: every fleet heard)")
    monitor.add_argument(
        "--connect",
        nargs="+",
        metavar="ENDPOINT",
        help="Zenoh endpoints of vehicles (default: tcp/127.0.0.1:7448 to 7455, vehicles 1 to 8 of a simulation)",
    )
    monitor.add_argument("--once", action="store_true", help="print one table after at most 3 s and end")
    monitor.add_argument("--json", action="store_true", help="one JSON array per table instead of the table")
    monitor.set_defaults(run=_monitor)

    analyze = commands.add_parser("analyze", description=ANALYZE, epilog=ANALYZE_MORE, formatter_class=raw)
    analyze.add_argument("file", type=Path, metavar="FILE", help="a scenario or fleet file (YAML)")
    analyze.add_argument("--json", action="store_true", help="all figures as one JSON object instead of the text")
    analyze.set_defaults(run=_analyze)
    return parser


def _agent(options: argparse.Namespace) -> int:
    from companion.app import Settings, run_agent

    def run() -> int:
        run_agent(Settings(options.config, options.wait_s))
        return 0

    return _on_a_vehicle(run)


def _doctor(options: argparse.Namespace) -> int:
    from companion.doctor import Options, run_doctor

    return _on_a_vehicle(lambda: run_doctor(Options(options.config, options.wait_s, options.fix, options.json)))


def _logs(options: argparse.Namespace) -> int:
    from companion.logs import run_logs

    return _on_a_vehicle(lambda: run_logs(logs_options(options)))


def _on_a_vehicle(run: Callable[[], int]) -> int:
    """What stands in the way of a command that needs an autopilot is one line and an exit code."""
    from companion.config_file import ConfigError
    from companion.link.autopilot_link import AutopilotSilentError

    try:
        return run()
    except ConfigError as error:
        return _fail(str(error), EXIT_FILE)
    except AutopilotSilentError as error:
        return _fail(str(error), EXIT_NO_AUTOPILOT)


def _fleet(options: argparse.Namespace) -> int:
    from companion.config_file import ConfigError
    from companion.ground.operate import OperateError, run_fleet
    from companion.link.zenoh_session import EndpointError

    try:
        return run_fleet(fleet_options(options))
    except ConfigError as error:
        return _fail(str(error), EXIT_FILE)
    except EndpointError as error:
        return _fail(f'companion fleet: --connect "{error.endpoint}": {error}', EXIT_FILE)
    except OperateError as error:
        return _fail(f"companion fleet {options.action}: {error}", EXIT_FILE)


def _monitor(options: argparse.Namespace) -> int:
    from companion.ground.monitor import MonitorError, run_monitor
    from companion.link.zenoh_session import EndpointError

    try:
        return run_monitor(options.fleet, options.connect, once=options.once, as_json=options.json)
    except EndpointError as error:
        return _fail(f'companion monitor: --connect "{error.endpoint}": {error}', EXIT_FILE)
    except MonitorError as error:
        return _fail(f"companion monitor: {error}", EXIT_FILE)


def _analyze(options: argparse.Namespace) -> int:
    import os

    os.environ.setdefault("OMP_NUM_THREADS", "1")  # numpy's matrices are small: threads only wait for each other

    import msgspec

    from companion.analysis import analyse, load_subject
    from companion.analysis_report import report, verdict
    from companion.config_file import ConfigError

    try:
        analysis = analyse(load_subject(options.file))
    except ConfigError as error:
        return _fail(str(error), EXIT_FILE)
    if options.json:
        figures = msgspec.to_builtins(analysis) | {"verdict": verdict(analysis)}
        print(msgspec.json.format(msgspec.json.encode(figures), indent=2).decode())
    else:
        print(report(analysis))
    return 0 if analysis.converges else EXIT_CANNOT_CONVERGE


def _fail(line: str, code: int) -> int:
    print(line, file=sys.stderr)
    return code


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value <= 3600:
        raise argparse.ArgumentTypeError(f"{text!r}, expected seconds above 0, up to 3600")
    return value
