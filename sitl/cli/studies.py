"""Many flights with one result: `sitl paper`, `sweep`, `study`, `switching` and `gauntlet`."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.cli.options import add_overrides, number, whole_number
from companion.cli.program import command
from sitl.cli.options import ABOVE_0, add_cluster, add_out_and_quiet, add_scenario, options_of
from sitl.sweep.options import DEFAULT_SEEDS, LONGEST_S, MAX_FLIGHTS, SHORTEST_S, SweepOptions

PLOTS, ALL = ("matplotlib", "rich"), ("matplotlib", "rich", "scipy")
MOST_FLIGHTS, MOST_SEED, MOST_JOBS = 100_000, 999_999_999, 256
MOST_STARTS, MOST_VEHICLES, MOST_NUMBER = 100_000, 50, 600.0


def _add_paper(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--full", action="store_true", help="more graphs and more flights with sensor noise")
    add_cluster(parser)
    add_out_and_quiet(parser)


def _run_paper(options: argparse.Namespace) -> int:
    """Reproduce Hou and Zhang (Robotica 2021): compute every claim of the theory, fly figures 4 to 10 with the agents that
    fly real vehicles, and write a page that states which claims hold.

    examples:
      sitl paper --out runs/paper
      sitl paper --out runs/paper --full         more graphs and more flights with sensor noise

    the folder (default: a new one, runs/paper-DATE-TIME):
      index.html       claims with verdicts, errata, figures beside what the paper states
      claims.json      the same claims with the numbers behind them, versions, and the time taken
      *.png            the figures

    exit codes:
      0    written; a claim that does not hold is a result, not a failure
      1    a flight that a figure needs had no formation, or a process ended before its flights did; one line says which
      2    an argument cannot be used; one line says which and what to do
      130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM)
    """

    from sitl.paper.command import run_paper

    return run_paper(options)


def _add_sweep(parser: argparse.ArgumentParser) -> None:
    add_scenario(parser)
    parser.add_argument(
        "--vary",
        action="append",
        default=[],
        dest="varied",
        metavar="KEY=V1,V2,...",
        help="fly with each of these values; may be given many times, for all combinations",
    )
    parser.add_argument(
        "--seeds",
        type=whole_number(1, MAX_FLIGHTS),
        default=DEFAULT_SEEDS,
        metavar="N",
        help=f"fly each combination with stand_in.seed 1 to N (default {DEFAULT_SEEDS})",
    )
    parser.add_argument(
        "--seconds",
        type=number(f"{SHORTEST_S:g} to {LONGEST_S:g} seconds", SHORTEST_S, LONGEST_S),
        metavar="S",
        help=f"duration of each flight, {SHORTEST_S:g} to {LONGEST_S:g} (default: for_s of the scenario's form step)",
    )
    add_overrides(parser, "change one key of the scenario")
    add_cluster(parser)
    add_out_and_quiet(parser)


def _run_sweep(options: argparse.Namespace) -> int:
    """Fly a scenario's formation many times, in every combination of the values that --vary lists, each with seeds 1 to N,
    and report the spread of the figures. All formations fly side by side in arrays, on all cores: the same bodies, loops,
    law and links as `sitl run`, hundreds to thousands of times faster than real time. The same command gives the same
    figures each time.

    examples:
      sitl sweep platoon --vary fleet.law.name=weighted,average_22,average_26
      sitl sweep platoon --vary fleet.law.parameters.exponent=0,1,2,8 --vary links.peer_loss=0,0.1,0.3
      sitl sweep platoon --vary fleet.law.name=weighted,cooperative \\
                 --vary links.peer_delay_s=0,0.05,0.1,0.2 --set stand_in.sensors=ideal --seeds 100 --seconds 40

    --vary and --set take any key of the scenario file, [N] for the N-th item of a list from 0. The values of --vary are
    YAML scalars with commas between them; a list or a mapping cannot be varied, but its items can (--vary
    "starts_enu_m.2[0]=-1.5,-2.0"), and --set takes it as a whole. All combinations are flown: 3 values of one key and 4 of
    another with 20 seeds are 240 flights; 100000 are the most. With ideal sensors and lossless links a seed only sets when
    within a period each vehicle ticks, so a few seeds are enough. With noisy sensors hardly any formation stays within 10
    cm; there the final error is more informative than the settling time.

    A flight begins in formation, at rest over `starts_enu_m` at the height of take-off, and lasts S seconds. It has no
    take-off and no landing, no ground and no fence, no failsafe and no change of leaders: of the timeline only the time of
    its `form` step is used, and a formation that turns with its course is refused. `sitl run` flies all of these, one
    flight at a time; with ideal sensors the figures of both agree to a few millimetres.

    the folder (default: a new one, runs/SCENARIO-sweep-DATE-TIME):
      sweep.csv     one row per flight: the varied keys, seed, settle_s (the time from which every vehicle stays within 10 cm of
                    its slot; empty if never), largest and smallest distance of neighbours, smallest distance of any two, and
                    final error (RMS of the last 2 s, of the vehicle with the largest)
      sweep.json    per combination: how many flights, the share that settled, and the median, 5 and 95 percentiles of each
                    figure. A flight that never settled counts as later than all that did; null: the percentile is such a
                    flight
      sweep.png     the same as curves: over the numeric key with the most values, one curve for each other combination

    Ctrl-C stops and keeps the flights that are complete. Flights are flown in batches, so a short sweep may have
    no complete flight yet; one line then says so. A second Ctrl-C stops at once and keeps nothing.

    exit codes:
      0    all flown
      1    a process ended before its flights did, most likely for lack of memory
      2    the scenario or an argument cannot be used; one line says which and what to do
      130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM)
    """

    from sitl.sweep.run import run as run_sweep

    return run_sweep(options_of(SweepOptions, vars(options)))


def _add_study(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--full", action="store_true", help="more shapes, more seeds, longer flights (an hour and more)"
    )
    add_cluster(parser)
    add_out_and_quiet(parser)


def _run_study(options: argparse.Namespace) -> int:
    """Beyond the paper: chains, rings, grids and random geometric graphs of 4 to 100 vehicles, the full quadrotor model,
    every setting of the law (weights, gains, neighbours' acceleration fed forward, leader coupled or not, one by one and
    together), with noise, delayed and lost packets; the candidates that the setting of `cooperative` is chosen from;
    spectra of up to 10,000 vehicles; and the goals of `cooperative`, each with a verdict.

    examples:
      sitl study                            a quarter of an hour on two cores
      sitl study --full --out /tmp/study    more shapes, more seeds and longer flights

    the folder (default: a new one, runs/study-DATE-TIME): study.json (every flight, the verdicts and the spectra),
    trade_off.png (settling against the worst inter-distance for every setting), selection.png (the candidates and the
    chosen one), spectra.png

    exit codes: 0 flown, whatever the verdicts; 1 a process ended before its flights did, most likely for lack of memory; 2 an
    argument cannot be used; 130 ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM), without results
    """

    from sitl.study.command import run_study_command

    return run_study_command(options)


def _add_switching(parser: argparse.ArgumentParser) -> None:
    starts, vehicles = whole_number(1, MOST_STARTS), whole_number(2, MOST_VEHICLES)
    positive = number(f"a number above 0, up to {MOST_NUMBER:g}", ABOVE_0, MOST_NUMBER)
    parser.add_argument("--starts", type=starts, default=1000, metavar="N", help="random starts (default 1000)")
    parser.add_argument("--vehicles", type=vehicles, default=6, metavar="N", help="in each formation (default 6)")
    parser.add_argument("--range", type=positive, default=3.0, metavar="M", help="range of neighbours (default 3 m)")
    parser.add_argument(
        "--hysteresis", type=positive, default=0.3, metavar="M", help="the second of two, after 0 (default 0.3 m)"
    )
    parser.add_argument("--seconds", type=positive, default=30.0, metavar="S", help="of each flight (default 30)")
    add_cluster(parser)
    add_out_and_quiet(parser)


def _run_switching(options: argparse.Namespace) -> int:
    """Neighbour sets that change with range: random starts from which the graph is connected and a goal leads the formation
    away, flown under every law with the full quadrotor model, without and with hysteresis. Slots are assigned so that the
    sum of the squared distances to them is smallest, and few paths cross. How often are edges lost, how small does
    lambda_min become, and from which starts does every vehicle keep a path to the leader? In how many flights do vehicles
    come too close to each other, or continue where real agents would hand over to the autopilot?

    examples:
      sitl switching                                  1,000 starts of six vehicles with a range of 3 m (some minutes)
      sitl switching --starts 100 --vehicles 10 --range 4 --out /tmp/switching

    the folder (default: a new one, runs/switching-DATE-TIME): switching.json (every flight and the summaries), switching.png

    exit codes: 0 flown; 1 a process ended before its flights did, most likely for lack of memory; 2 an argument cannot be used;
    130 ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM), without results
    """

    from sitl.switching.command import run_switching

    return run_switching(options)


def _add_gauntlet(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--flights",
        type=whole_number(1, MOST_FLIGHTS),
        default=100,
        metavar="N",
        help="number of flights (default 100)",
    )
    parser.add_argument("--seed", type=whole_number(0, MOST_SEED), default=1, metavar="S", help="(default 1)")
    parser.add_argument("--families", metavar="A,B", help="families of flights; a wrong name lists them (default: all)")
    parser.add_argument(
        "--sensors", choices=("ideal", "default", "px4_sih"), help="of all flights (default: random for each flight)"
    )
    parser.add_argument("--fleet", type=Path, metavar="FILE", help="fly this fleet instead of random ones")
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--jobs", type=whole_number(1, MOST_JOBS), metavar="N", help="processes (default: one per core)")
    add_cluster(place)
    parser.add_argument("--page", type=Path, metavar="FILE", help="also write the table as a Markdown page")
    add_out_and_quiet(parser)


def _run_gauntlet(options: argparse.Namespace) -> int:
    """Fly random flights with the agents that fly for real, in virtual time and on all cores: formation changes, crossing
    paths, joining and leaving vehicles, lost leaders, split networks, fast references and more, under the laws weighted and
    cooperative, with both autopilots, ideal and noisy sensors, delay and loss. Every tenth flight has a runaway vehicle
    that flies straight on. The true distances of all pairs are measured at 50 Hz. The same seed gives the same flights bit
    for bit.

    examples:
      sitl gauntlet                                        100 flights with seed 1 (some minutes)
      sitl gauntlet --families joining,exchange --seed 7   two families only
      sitl gauntlet --sensors ideal --flights 1000 --jobs 4
      sitl gauntlet --fleet fleet.yaml                     your own fleet, with its slots, law and separation_m

    the folder (default: a new one, runs/gauntlet-DATE-TIME): gauntlet.json (every flight and the summaries), and the ten
    worst flights as scenario files: `sitl run FOLDER/FLIGHT.yaml` flies one again and plots it. FLIGHT.txt is the traceback
    of a flight that ended in an exception

    exit codes: 0 flown without a violation; 1 two vehicles came closer than allowed, an agent raised an exception, or a process
    ended before its flights did; 2 an argument or the fleet file cannot be used; 130 stopped by Ctrl-C (129 by SIGHUP, 143 by
    SIGTERM), with the results of the flights that were complete
    """

    from sitl.gauntlet.command import run_gauntlet

    return run_gauntlet(options)


PAPER = command(
    "paper",
    "every claim of the paper computed or flown again, on one page",
    _add_paper,
    _run_paper,
    ("matplotlib", "jinja2", "rich", "scipy"),
)


SWEEP = command(
    "sweep",
    "statistics: many flights of one formation, with varied keys and seeds, side by side in arrays",
    _add_sweep,
    _run_sweep,
    PLOTS,
)


STUDY = command(
    "study",
    "beyond the paper: every setting of the law on formations of 4 to 100 vehicles",
    _add_study,
    _run_study,
    ALL,
)


SWITCHING = command(
    "switching",
    "neighbour sets that change with range: connectivity from a thousand random starts under each law",
    _add_switching,
    _run_switching,
    ALL,
)


GAUNTLET = command(
    "gauntlet",
    "random flights of whole fleets in virtual time: how close do vehicles come, and do they reach their slots?",
    _add_gauntlet,
    _run_gauntlet,
    ALL,
)
