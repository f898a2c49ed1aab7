"""The `sitl` command: one entry per subcommand, each loaded only when it is called."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from math import inf
from pathlib import Path
from typing import NoReturn

from companion import __version__
from companion.ending import ending_quietly
from companion.types import AutopilotKind

MAX_PORT_OFFSET = 40_000  # vehicle 250's ports are then still ports


def main() -> NoReturn:
    with ending_quietly():
        sys.exit(_main())


def _main() -> int:
    """The exit code. Imports what takes a while itself, for Ctrl-C may come meanwhile."""
    from sitl.ending import exit_code_of
    from sitl.needed import check_installed

    arguments = _parser().parse_args()
    run: Callable[[argparse.Namespace], int] = arguments.run

    def installed_and_run() -> int:
        check_installed(arguments.command)
        return run(arguments)

    return exit_code_of(installed_and_run)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="sitl", description="Stand-in vehicles, and whole fleets of real processes.")
    parser.add_argument("--version", action="version", version=f"sitl {__version__}")
    subcommands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_autopilot(subcommands)
    _add_fly(subcommands)
    _add_fleet(subcommands)
    _add_run(subcommands)
    _add_paper(subcommands)
    _add_sweep(subcommands)
    _add_study(subcommands)
    _add_switching(subcommands)
    return parser


def _add_autopilot(subcommands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subcommands.add_parser(
        "autopilot",
        help="one stand-in quadrotor with PX4's or ArduCopter's manners behind UDP and TCP",
        description="One stand-in quadrotor with PX4's or ArduCopter's manners behind sockets of this machine.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="""\
With id N (instance i = N - 1, K the port offset) it listens for a companion on UDP 14580+i+K and sends to 14540+i+K; for a
ground station it listens on 18570+i+K and sends to 14550. With ArduCopter's manners it also listens on TCP 5760+10i+K, for one
client at a time. It lets itself be armed about 4 s after its start, with ArduCopter's manners after 42 s, as they do;
stand_in.armable_after_s in the file changes that.

examples:
  sitl autopilot                                        vehicle 1 with the default airframe and sensor noise
  sitl autopilot --autopilot ardupilot                  the same with ArduCopter's manners
  sitl autopilot --id 3 --truth truth.csv               vehicle 3; where it truly was, at 50 Hz
  sitl autopilot --config autopilot.yaml --seconds 60   as the file says, for a minute

exit codes: 0 ended as asked, 2 bad file or port in use""",
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="YAML file: id, start_enu_m, stand_in, ...")
    parser.add_argument("--id", type=int, help="vehicle id (MAVLink system id), instead of the file's")
    parser.add_argument(
        "--autopilot",
        type=AutopilotKind,
        choices=list(AutopilotKind),
        help="whose manners it has, instead of the file's (default px4)",
    )
    parser.add_argument("--port-offset", type=_offset, default=0, metavar="K", help="added to all ports (default 0)")
    parser.add_argument("--truth", type=Path, metavar="CSV", help="write true states at 50 Hz")
    parser.add_argument("--seconds", type=_seconds, metavar="S", help="end after S seconds")
    parser.set_defaults(run=_run_autopilot)


def _offset(text: str) -> int:
    if not text.isdecimal() or int(text) > MAX_PORT_OFFSET:
        raise argparse.ArgumentTypeError(f"{text!r}, expected 0 to {MAX_PORT_OFFSET}")
    return int(text)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < inf:
        raise argparse.ArgumentTypeError(f"{text!r}, expected seconds above 0")
    return value


def _run_autopilot(arguments: argparse.Namespace) -> int:
    from sitl.autopilot_file import load_autopilot_file
    from sitl.ports import ports_of
    from sitl.realtime import run

    file = load_autopilot_file(arguments.config, arguments.id, arguments.autopilot)
    run(file, ports_of(file.id, arguments.port_offset), arguments.truth, arguments.seconds)
    return 0


def _add_fly(subcommands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from sitl.fly_options import DESCRIPTION, MORE, add_fly_arguments

    parser = subcommands.add_parser(
        "fly",
        help="a whole fleet of real processes through a scenario, with figures at its end",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=MORE,
    )
    add_fly_arguments(parser)
    parser.set_defaults(run=_run_fly)


def _run_fly(arguments: argparse.Namespace) -> int:
    from sitl.fly import run_fly
    from sitl.fly_options import fly_options

    return run_fly(fly_options(arguments))


def _add_fleet(subcommands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from sitl.waiting_options import DESCRIPTION, MORE, add_waiting_arguments

    parser = subcommands.add_parser(
        "fleet",
        help="a fleet of real processes that waits on the ground for `companion fleet`",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=MORE,
    )
    add_waiting_arguments(parser)
    parser.set_defaults(run=_run_fleet)


def _run_fleet(arguments: argparse.Namespace) -> int:
    from sitl.waiting_fleet import run_fleet
    from sitl.waiting_options import waiting_options

    return run_fleet(waiting_options(arguments))


def _add_run(subcommands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from sitl.run_options import DESCRIPTION, MORE, add_run_arguments

    parser = subcommands.add_parser(
        "run",
        help="the same in virtual time, in one process and many times faster, the same to the last bit each time",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=MORE,
    )
    add_run_arguments(parser)
    parser.set_defaults(run=_run_run)


def _run_run(arguments: argparse.Namespace) -> int:
    from sitl.run import run
    from sitl.run_options import run_options

    return run(run_options(arguments))


def _add_switching(subcommands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from sitl.switching.options import DESCRIPTION, MORE, add_switching_arguments

    parser = subcommands.add_parser(
        "switching",
        help="neighbour sets that change with range: who stays connected, from a thousand random starts, under each law",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=MORE,
    )
    add_switching_arguments(parser)
    parser.set_defaults(run=_run_switching)


def _run_switching(arguments: argparse.Namespace) -> int:
    from sitl.switching.command import run_switching

    return run_switching(arguments)


def _add_study(subcommands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from sitl.study.options import DESCRIPTION, MORE, add_study_arguments

    parser = subcommands.add_parser(
        "study",
        help="what lies past the paper: every setting of the law on formations of 4 to 100 vehicles",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=MORE,
    )
    add_study_arguments(parser)
    parser.set_defaults(run=_run_study)


def _run_study(arguments: argparse.Namespace) -> int:
    from sitl.study.command import run_study_command

    return run_study_command(arguments)


def _add_sweep(subcommands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from sitl.sweep.options import DESCRIPTION, MORE, add_sweep_arguments

    parser = subcommands.add_parser(
        "sweep",
        help="statistics: many flights of one formation, with varied keys and seeds, side by side in arrays",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=MORE,
    )
    add_sweep_arguments(parser)
    parser.set_defaults(run=_run_sweep)


def _run_sweep(arguments: argparse.Namespace) -> int:
    from sitl.sweep.options import sweep_options
    from sitl.sweep.run import run

    return run(sweep_options(arguments))


def _add_paper(subcommands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from sitl.paper.command import DESCRIPTION, MORE, add_paper_arguments

    parser = subcommands.add_parser(
        "paper",
        help="every claim of the paper computed or flown again, on one page",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=MORE,
    )
    add_paper_arguments(parser)
    parser.set_defaults(run=_run_paper)


def _run_paper(arguments: argparse.Namespace) -> int:
    from sitl.paper.command import paper_options, run_paper

    return run_paper(paper_options(arguments))
