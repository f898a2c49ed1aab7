"""Flights of one scenario: `sitl run` in virtual time, `sitl fly` and `sitl fleet` with real processes."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from companion.cli.options import add_law, add_overrides, law_argument
from companion.cli.program import command
from companion.config.file import ConfigError
from companion.config.law import USUAL
from sitl.cli.options import (
    add_autopilot,
    add_binary,
    add_out,
    add_out_and_quiet,
    add_port_offset,
    add_scenario,
    options_of,
    overrides_of,
)

if TYPE_CHECKING:
    from sitl.flight.flights import FlightOptions


def add_flight_arguments(parser: argparse.ArgumentParser) -> None:
    """What `sitl run` and `sitl fly` have in common."""
    add_scenario(parser)
    add_law(parser, "fly with this law")
    add_autopilot(parser)
    parser.add_argument(
        "--compare",
        dest="others",
        nargs="*",
        type=law_argument,
        metavar="LAW",
        help="fly with the scenario's law, then with these (default: with those of the paper and cooperative), and compare",
    )
    add_overrides(parser, "change one key of the scenario")
    parser.add_argument("--anyway", action="store_true", help="fly a formation that `companion analyze` rejects")
    add_out_and_quiet(parser)


def _add_run(parser: argparse.ArgumentParser) -> None:
    add_flight_arguments(parser)
    parser.add_argument("--record", action="store_true", help="leave the recordings of the agents, as `sitl fly` does")


def _add_fly(parser: argparse.ArgumentParser) -> None:
    add_flight_arguments(parser)
    parser.add_argument(
        "--external",
        type=Path,
        metavar="px4|ardupilot|FILE",
        help="start no stand-ins but real PX4 (SIH) or ArduCopter (SITL), or fly the external autopilots of this file",
    )
    add_binary(parser)
    add_port_offset(parser)


def _add_fleet(parser: argparse.ArgumentParser) -> None:
    add_scenario(parser)
    add_autopilot(parser)
    add_overrides(parser, "change one key of the scenario")
    add_out(parser)
    parser.add_argument("--quiet", action="store_true", help="do not show the vehicles, only how to command them")
    add_port_offset(parser)


def _run_run(parsed: argparse.Namespace) -> int:
    """Fly a scenario in virtual time: the same agents and stand-in autopilots as `sitl fly`, in one loop without sockets,
    many times faster than real time. The same scenario and seed give a bit-identical flight.

    examples:
      sitl run platoon                        the paper's platoon with the paper's law
      sitl run platoon --compare              the paper's laws and cooperative in turn, one table, one figure
      sitl run platoon --set stand_in.sensors=default --set stand_in.seed=2
      sitl run platoon --autopilot ardupilot  stand-ins that behave like ArduCopter instead of PX4
      sitl run platoon --set links.peer_loss=0.1 --set links.peer_delay_s=0.1

    --set takes any key of the scenario file, [N] for the N-th item of a list from 0, and a YAML value. The section links sets
    the delays of telemetry, setpoints and peer packets, the shares of peer packets that are lost and repeated, and partitions.

    Before the flight the formation is checked as by `companion analyze`: one without a path from a leader to every vehicle, or
    one that is unstable with the usual delay, is refused; --anyway flies it.

    the folder (default: a new one, runs/SCENARIO-LAW-DATE-TIME; with --compare one folder per law inside it; files of an older
    run in --out are removed; a folder that another run uses is refused):
      summary.json              as of `sitl fly`, with real_time_factor: seconds flown per second of computing time. Timing
                                (tick, telemetry_to_command_us, cpu_percent, rss_mb) is null in virtual time
      figure_5.png, figure_6.png, from_above.png, comparison.json, comparison.png, scenario.yaml      as of `sitl fly`
      truth_N.csv               true positions of vehicle N, 50 times a second; its clock is virtual and begins at 0
      vehicle_N_*.mcap          with --record: what the agent of vehicle N received and decided, by the virtual clock

    Ctrl-C lands all vehicles, which takes no time here, and writes the folder; a second Ctrl-C stops at once.

    exit codes:
      0    flown and landed
      1    the flight failed; one line says which vehicle and why
      2    the scenario, an argument or the folder cannot be used; one line says which and what to do
      130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM), vehicles landed
    """

    from sitl.flight.flights import run_virtual

    return run_virtual(flight_options(parsed))


def _run_fly(parsed: argparse.Namespace) -> int:
    """Fly a scenario with real processes: one stand-in autopilot and one agent per vehicle, MAVLink between them, datagrams
    and Zenoh between the agents. Shows every vehicle live, lands, and leaves a folder with figures, plots, files and logs. With
    --external the agents fly real autopilots: PX4 and ArduCopter in their own simulations, or others on a bench.

    examples:
      sitl fly platoon                        the paper's platoon with the paper's law
      sitl fly platoon --law average_22       with another law
      sitl fly platoon --compare average_26   also with this one, one table, one figure; --compare alone: as `sitl run`
      sitl fly platoon --autopilot ardupilot  stand-ins that behave like ArduCopter instead of PX4
      sitl fly platoon --external ardupilot   with four real ArduCopters in their own simulation
      sitl fly four_in_line --external px4 --binary ~/px4/build/px4_sitl_sih/bin/px4
      sitl fly platoon --set stand_in.sensors=default --set timeline[3].for_s=20
      sitl fly platoon --set stand_in.airframe.attitude=instant --set stand_in.airframe.motor_lag_s=0
      sitl fly runs/platoon-weighted-20250131-120000/scenario.yaml   repeat a flight exactly

    --set takes any key of the scenario file, [N] for the N-th item of a list from 0, and a YAML value.

    Before the flight the formation is checked as by `companion analyze`: one without a path from a leader to every vehicle, or
    one that is unstable with the usual delay, is refused; --anyway flies it. Without --port-offset it takes the first of the
    offsets 0, 100, 200, ... with which all ports are free, so that several fleets can fly side by side.

    the folder (default: a new one, runs/SCENARIO-LAW-DATE-TIME; with --compare one folder per law inside it; files of an older
    run in --out are removed; a folder that another run uses is refused):
      summary.json                   largest, smallest and final distances, settling time, final error, timing of each agent
      figure_5.png, figure_6.png     x and y curves, inter-distances; all from true positions
      from_above.png                 the paths from above, with leaders and neighbours after each command
      comparison.json, .png          with --compare
      scenario.yaml                  as flown; fleet.yaml, vehicle_N.yaml, autopilot_N.yaml are made from it
      truth_N.csv                    true positions of vehicle N, 50 times a second
      agent_N.log                    output of the agents; autopilots_1_to_M.log that of the stand-ins, which share a process
      vehicle_N_*.mcap               what the agent of vehicle N received and decided (docs/recording.md)

    --external px4 or ardupilot starts one PX4 (SIH) or ArduCopter (SITL) for each vehicle in the place of the stand-ins, at its
    starts_enu_m, with the parameters that an agent requires, and ends it after the flight (docs/external.md). A vehicle whose
    autopilot the scenario names under stand_in.vehicles gets that type. All figures are from the true positions of their
    simulations. autopilot_N.log and autopilot_N/ have its output and logs.
    --external FILE connects to autopilots that another program has started, at the endpoints in FILE, with a line for each:
      external_vehicles: [{id: 1, mavlink: udpin:127.0.0.1:14540, autopilot: px4, hover_thrust_norm: 0.5, drag_1_s: 1.0},
                          {id: 2, mavlink: tcp:127.0.0.1:5772, autopilot: ardupilot, hover_thrust_norm: 0.39}]
    They are never ended: the vehicles are landed and left. Their true positions are unknown: estimated_N.csv instead of
    truth_N.csv holds the positions that each reported in the air, ten times a second, and summary.json has `tracks: estimated`.
    With either no command is given before all vehicles are ready: the autopilots' own checks pass, origin and position are
    known, parameters are in order, and each vehicle is on the ground within 10 m of its starts_enu_m, by fleet.origin, and
    apart from the others. A vehicle that is armed, or taken over by its pilot, is left alone.

    On a busy machine a line after the figures reports it: where more than 0.5 % of the ticks were missed, or an agent took more
    than 5 ms (p99) from telemetry to command, the figures are those of the machine rather than of the law. Ctrl-C lands all
    vehicles and stops everything; a second Ctrl-C stops at once.

    exit codes:
      0    flown and landed
      1    the flight failed; one line says which vehicle and why, the logs say more
      2    the scenario, an argument, a port or the folder cannot be used; one line says which and what to do
      130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM), vehicles landed
    """

    from sitl.flight.fly import run_fly

    return run_fly(flight_options(parsed))


def _run_fleet(parsed: argparse.Namespace) -> int:
    """A scenario's fleet as real processes, one stand-in autopilot and one agent per vehicle. It waits on the ground for an
    operator: `companion fleet` in a second terminal. The scenario's timeline is not flown; its targets move.

    examples:
      sitl fleet ring_figure_8
      sitl fleet formations --set stand_in.sensors=ideal
      sitl fleet platoon --autopilot ardupilot --port-offset 100

    It prints what `companion fleet` needs and the ports for ground stations. Without --port-offset it takes the first of the
    offsets 0, 100, 200, ... with which all ports are free, so that several fleets can fly side by side.

    the folder (default: a new one, runs/fleet-SCENARIO-DATE-TIME; files of an older run in --out are removed):
      fleet.yaml                     for `companion fleet --fleet`; vehicle_N.yaml, autopilot_N.yaml, scenario.yaml
      truth_N.csv                    true positions of vehicle N, 50 times a second
      agent_N.log                    output of the agents: every command and its answer is a line
      autopilots_1_to_M.log          output of the stand-ins, up to sixteen in one process
      vehicle_N_*.mcap               what the agent of vehicle N received and decided (docs/recording.md)

    Ctrl-C takes command, lands all vehicles where they are and stops everything; a second Ctrl-C stops at once. On a busy
    machine the last lines report it: where more than 0.5 % of the ticks were missed, or an agent took more than 5 ms (p99) from
    telemetry to command.

    exit codes:
      0    ended by Ctrl-C, all vehicles landed
      1    a vehicle could not be landed, or a process could not be ended; one line says which and why, the logs say more
      2    the scenario, an argument, a port or the folder cannot be used; one line says which and what to do
    """

    from sitl.flight.fly import run_fleet

    return run_fleet(flight_options(parsed))


def flight_options(parsed: argparse.Namespace) -> FlightOptions:
    """The options of any of the three commands. Raises ConfigError."""
    from sitl.flight.flights import FlightOptions

    given = vars(parsed)
    if given.get("external") and parsed.autopilot:
        raise ConfigError(
            "--autopilot", "", "chooses the stand-ins, and --external starts none; give one of the two options"
        )
    others = USUAL if given.get("others") == [] else given.get("others")
    return options_of(FlightOptions, given | {"overrides": overrides_of(parsed), "others": others})


RUN = command(
    "run",
    "flies a scenario in virtual time: one process, many times faster, bit-identical each time",
    _add_run,
    _run_run,
    ("matplotlib", "rich"),
)


FLY = command(
    "fly",
    "a whole fleet of real processes through a scenario, with figures at its end",
    _add_fly,
    _run_fly,
    ("matplotlib", "rich"),
)


FLEET = command(
    "fleet",
    "a fleet of real processes that waits on the ground for `companion fleet`",
    _add_fleet,
    _run_fleet,
    ("rich",),
)
