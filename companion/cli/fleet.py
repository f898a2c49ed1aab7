"""`companion fleet`: commands to a fleet, its reports, the current fleet and its admission list."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from companion.cli.fleet_changes import (
    FORMATION,
    FORMATION_EXAMPLES,
    REFERENCE,
    REFERENCE_EXAMPLES,
    add_formation_options,
    add_reference_options,
    formation_request,
    reference_request,
)
from companion.cli.options import add_identity, add_json, number, operator, seconds, vehicle_id
from companion.cli.program import CliCommand
from companion.types.errors import UnusableError

if TYPE_CHECKING:
    from companion.ground.operate import FleetRequest

SEE = "`companion fleet --help` explains the fleet file, the endpoints, holding command, and the exit codes."
REPORTS = {
    "status": "phase, position, formation and reference of each vehicle, and the operator who holds command",
    "doctor": "checks before flight, while the agents run: autopilot, estimator, battery, origin, peers, fleet file, distances",
}
SIMPLE_COMMANDS = {
    "arm": "prepares vehicles in phase observe, then arms",
    "takeoff": "climbs vertically to takeoff_height_m, then the autopilot's hold mode",
    "form": "from hold into the formation",
    "hold": "from formation into the autopilot's hold mode",
    "land": "vertically, at the present position",
    "return": "to the takeoff position of each vehicle and down, by the autopilot's return mode",
    "disarm": "on the ground",
}
UNCHECKED_COMMANDS = {
    "abort": "in any phase: disarms on the ground, the autopilot's hold mode in the air",
    "take": "takes command over from another operator",
}
CHANGES = {
    "formation": (
        "changes the slots, in flight as well: a shape, a file, or scaling",
        FORMATION,
        FORMATION_EXAMPLES,
        add_formation_options,
    ),
    "reference": (
        "changes the reference, in flight as well: a point, waypoints, a circle, ...",
        REFERENCE,
        REFERENCE_EXAMPLES,
        add_reference_options,
    ),
}
USE = """\
Save a fleet file, endpoints and an identity as the current fleet; without FILE, show the current fleet and
where it comes from.
"""
ADMIT = """\
Send an admission list to all vehicles. Each one verifies that the authority of the fleet has signed
it and that it is newer than its own, keeps it, and from then on uses nothing of a participant that
is no longer admitted. A new identity is connected when the agents start again.
"""


def _add_fleet(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION", title="actions")
    use = actions.add_parser(
        "use", help="saves or shows the current fleet: a fleet file and endpoints", description=USE
    )
    _add_use(use)
    connection, vehicles = _connection_options(), _vehicle_options()
    waiting, check = _waiting_options(), _check_options()
    command = [connection, waiting, check]
    for summaries, parents in (
        (REPORTS, [connection, vehicles]),
        (SIMPLE_COMMANDS, [*command, vehicles]),
        (UNCHECKED_COMMANDS, [connection, waiting, vehicles]),
    ):
        for name, summary in summaries.items():
            actions.add_parser(name, parents=parents, help=summary, description=summary, epilog=SEE)
    summary = "sends a new admission list to the vehicles, as after companion provision revoke"
    admit = actions.add_parser("admit", parents=[connection], help=summary, description=ADMIT, epilog=SEE)
    admit.add_argument("file", type=Path, metavar="FILE", help="admitted.json of the own identity, or of any other")
    summary = "changes the leader, in flight as well"
    leader = actions.add_parser("leader", parents=command, help=summary, description=summary, epilog=SEE)
    leader.add_argument(
        "leaders", nargs="+", type=vehicle_id, metavar="ID", help="the new leaders; all other vehicles follow"
    )
    raw = argparse.RawDescriptionHelpFormatter
    for name, (summary, description, examples, add_options) in CHANGES.items():
        one = actions.add_parser(
            name, parents=command, help=summary, description=description, epilog=examples, formatter_class=raw
        )
        add_options(one)


def _add_use(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", nargs="?", type=Path, metavar="FILE", help="the fleet file of the vehicles")
    parser.add_argument(
        "--connect", nargs="+", action="extend", default=[], metavar="ENDPOINT", help="Zenoh endpoints of vehicles"
    )
    parser.add_argument("--identity", type=Path, metavar="DIR", help="folder of the own certificate")
    parser.add_argument("--clear", action="store_true", help="delete the saved current fleet")


def _run_fleet(options: argparse.Namespace) -> int:
    from companion.ground.commands import OperateError
    from companion.ground.operate import run_fleet

    if options.action == "use":
        return _run_use(options)
    try:
        return run_fleet(fleet_request(options))
    except OperateError as error:
        raise UnusableError(f"companion fleet {options.action}: {error}") from error


def _run_use(options: argparse.Namespace) -> int:
    from companion.config.fleet_check import load_fleet
    from companion.ground.current_fleet import forget_current, save_current, select
    from companion.link.fleet.identity import load
    from companion.link.fleet.zenoh_session import check_endpoints

    if options.clear:
        forget_current(os.environ)
    elif options.file:
        load_fleet(options.file)
        check_endpoints("connect", options.connect)
        if options.identity:
            load(options.identity)
        print(f"saved in {save_current(options.file, options.connect, options.identity, os.environ)}")
    print(select(None, (), None, os.environ))
    return 0


def fleet_request(parsed: argparse.Namespace) -> FleetRequest:
    """Options, environment and saved current fleet as a request. Raises ConfigError.

    A fleet file that is not an option is named on standard error.
    """
    from companion.config.file import ConfigError
    from companion.ground.changes import FleetAction, command_line
    from companion.ground.current_fleet import FLEET_VARIABLE, select
    from companion.ground.operate import FleetRequest

    selection = select(parsed.fleet, parsed.connect or (), parsed.identity, os.environ)
    if selection.fleet is None:
        raise ConfigError(
            command_line(parsed.action),
            "--fleet",
            f"missing; give it, set {FLEET_VARIABLE}, or save one: companion fleet use FILE",
        )
    if parsed.fleet is None:
        print(selection, file=sys.stderr)
    action = FleetAction(
        name=parsed.action,
        only=tuple(getattr(parsed, "only", ())),
        leaders=tuple(getattr(parsed, "leaders", ())),
        formation=formation_request(parsed) if parsed.action == "formation" else None,
        reference=reference_request(parsed) if parsed.action == "reference" else None,
    )
    return FleetRequest(
        action=action,
        fleet=selection.fleet,
        connect=selection.connect,
        identity=selection.identity,
        operator=parsed.operator or "",
        wait_s=parsed.wait_s,
        as_json=parsed.json,
        check=getattr(parsed, "check", False),
        wait=getattr(parsed, "wait", False),
        timeout_s=getattr(parsed, "timeout", None),
        admission_list=parsed.file if parsed.action == "admit" else None,
    )


def _connection_options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument(
        "--fleet", type=Path, metavar="FILE", help="the fleet file of the vehicles (default: the current fleet)"
    )
    parser.add_argument("--connect", nargs="+", action="extend", metavar="ENDPOINT", help="Zenoh endpoints of vehicles")
    add_identity(parser)
    parser.add_argument(
        "--as", dest="operator", type=operator, metavar="NAME", help="the operator (default: user@host)"
    )
    parser.add_argument(
        "--wait-s",
        type=number("seconds from 0.1 to 60", 0.1, 60.0),
        default=3.0,
        metavar="S",
        help="how long to wait for reports and replies (default 3)",
    )
    add_json(parser, "one JSON object instead of the lines")
    return parser


def _waiting_options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument(
        "--wait",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="wait until all vehicles have finished the action (default: --wait)",
    )
    parser.add_argument("--timeout", type=seconds, metavar="S", help="end that wait after S seconds")
    return parser


def _check_options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument(
        "--check", action="store_true", help="only ask what each vehicle would answer now; nothing changes"
    )
    return parser


def _vehicle_options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument(
        "--only",
        nargs="+",
        type=vehicle_id,
        default=[],
        metavar="ID",
        help="these vehicles (default: all of the fleet)",
    )
    return parser


FLEET = CliCommand(
    name="fleet",
    summary="commands a whole fleet from the ground",
    description="""\
Command a fleet from the ground. The command goes to all vehicles at the same time; each vehicle
decides for itself. One line per vehicle: accepted, refused, missing or not sent, with a code, the
reason and the time to its reply. Then waits until all vehicles have finished the action. takeoff
and return are for all vehicles or none: where the report of one shows that it cannot begin, none
gets the command.
""",
    more="""\
examples:
  companion fleet use fleet.yaml --identity identity                 saves the current fleet
  companion fleet doctor
  companion fleet arm && companion fleet takeoff && companion fleet form
  companion fleet form --only 2 3 --no-wait
  companion fleet leader 2
  companion fleet formation diamond --spacing 4 --heading 90
  companion fleet reference point --at 10 -5 4
  companion fleet formation line --spacing 30 --check                nothing is sent but the question
  companion fleet land --fleet fleet.yaml --json | jq '.vehicles[] | select(.finished | not)'

Finished is: armed; in hold after takeoff; in formation, in its slot; in hold; on the ground and
disarmed (land, return, disarm); with the new leader, formation or reference. Progress goes to
standard error. --timeout ends the wait (default 60 s; 300 s for land, return, abort, formation
and reference), --no-wait skips it. The action itself goes on, also after Ctrl-C.

The fleet file is --fleet, else the environment variable COMPANION_FLEET, else the current fleet
saved by `use`. The endpoints are --connect, else COMPANION_CONNECT (separated by commas or
spaces), else those saved with the current fleet, else the addresses in the fleet file, else
tcp/127.0.0.1:7447+ID for each vehicle, as in a simulation. Each endpoint reaches one vehicle.

A fleet with identities needs that of a ground: --identity, else COMPANION_IDENTITY, else that
saved with the current fleet. The operator is then the name in its certificate, like ground-anna.

The first operator who sends a command holds command of the vehicle; other operators are refused,
with the name of the holder, until they take command. Without an identity an operator is
user@host, or --as NAME.
Vehicles refuse commands for an earlier start of the agent and commands that are not newer than
the last one, so that a recorded command has no effect.

abort works for every operator, also without command, and in every phase. A vehicle that lands
continues to land; one that its pilot flies is left to the pilot. In the air all vehicles stop at
their present positions, also two that are passing each other. `hold` takes a vehicle from its
pilot, `abort` does not.

return works in formation and in hold. The autopilots climb first, to RTL_RETURN_ALT (PX4) or
RTL_ALT (ArduCopter), fly straight home and land; they need neither agent nor network for it, and
do not avoid each other. A vehicle refuses where its straight path home is closer than
separation_m to another vehicle or to the path home of that vehicle, and where its home is
unknown, as after a restart of its agent in the air. Land the vehicles that refuse, send the
command again after others are home, or first bring the formation back to its takeoff position.
`hold`, `land` and `abort` end a return; `abort` not for vehicles that already descend at home.

--check asks each vehicle what it would answer now, by its own checks and in its own state. Nothing
changes: no command is taken and none becomes old. Where a vehicle knows a value that it would
accept, it is named. arm is checked as far as its first step that is still to come.

exit codes:
  0    every vehicle accepted and finished; with --check: would accept; with status: reported; with
       doctor: is ready
  1    some vehicles refused, are missing, did not finish or are not ready
  2    the fleet file, an endpoint or an argument cannot be used; no command was sent
  130  ended by Ctrl-C
""",
    add_arguments=_add_fleet,
    run=_run_fleet,
)
