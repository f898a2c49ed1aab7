"""Many flights with one result: `sitl paper`, `compare` and `gauntlet`."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.cli.options import add_overrides, number, whole_number
from companion.cli.program import CliCommand, command, fail
from companion.types.autopilot import AutopilotKind
from companion.types.errors import EXIT_DONE, EXIT_UNUSABLE
from sitl.cli.options import add_binary, add_cluster, add_out_and_quiet, options_of
from sitl.compare.options import (
    DEFAULT_CONDITIONS,
    DEFAULT_GRAPHS,
    DEFAULT_LAWS,
    DEFAULT_S,
    DEFAULT_SEEDS,
    LONGEST_S,
    MAX_FLIGHTS,
    MOST_VEHICLES,
    SHORTEST_S,
    CompareOptions,
)

MOST_FLIGHTS, MOST_SEED, MOST_JOBS = 100_000, 999_999_999, 256


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

    Ctrl-C keeps the claims and flights that are finished, and writes the page of them, marked incomplete. A second Ctrl-C stops
    at once and writes nothing.

    exit codes:
      0    written; a claim that does not hold is a result, not a failure
      1    a flight that a figure needs had no formation, or a process ended before its flights did; one line says which
      2    an argument cannot be used; one line says which and what to do
      130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM)
    """

    from sitl.paper.command import run_paper

    return run_paper(options)


def _add_compare(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "scenario",
        type=Path,
        nargs="?",
        metavar="SCENARIO",
        help="a scenario file or the name of a shipped one: its fleet is the only graph (default: graphs of --graphs)",
    )
    for name, of, default in (
        ("laws", "names, Python files with a law, or NAME:KEY=VALUE for other parameters", DEFAULT_LAWS),
        ("graphs", "names of graphs", DEFAULT_GRAPHS),
        ("conditions", "names of conditions", DEFAULT_CONDITIONS),
    ):
        usual = f"{of} (default {','.join(default)}{'' if name == 'graphs' else '; of a scenario its own'})"
        parser.add_argument(f"--{name}", type=listed, default=(), metavar="A,B", help=usual)
    parser.add_argument(
        "--vehicles", type=sizes, default=(), metavar="N,M", help=f"of each graph, 2 to {MOST_VEHICLES} (default 8)"
    )
    seeds, cells = whole_number(1, MAX_FLIGHTS), whole_number(0, MAX_FLIGHTS)
    parser.add_argument(
        "--seeds", type=seeds, default=DEFAULT_SEEDS, metavar="N", help=f"seeds 1 to N (default {DEFAULT_SEEDS})"
    )
    parser.add_argument(
        "--seconds",
        type=number(f"{SHORTEST_S:g} to {LONGEST_S:g} seconds", SHORTEST_S, LONGEST_S),
        metavar="S",
        help=f"of each flight (default {DEFAULT_S:g}; of a scenario that of its form step)",
    )
    parser.add_argument(
        "--vary",
        action="append",
        default=[],
        dest="varied",
        metavar="KEY=V1,V2,...",
        help="fly with each of these values; may be given many times, for all combinations",
    )
    parser.add_argument(
        "--lockstep", type=cells, default=0, metavar="N", help="the real agents fly N flights of the batch as well"
    )
    parser.add_argument("--list", action="store_true", help="list graphs and conditions, and fly nothing")
    add_overrides(parser, "change one key of all scenarios")
    add_cluster(parser)
    add_out_and_quiet(parser)


def listed(text: str) -> tuple[str, ...]:
    """An argparse type: values with commas between them."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def sizes(text: str) -> tuple[int, ...]:
    """An argparse type: numbers of vehicles."""
    return tuple(map(whole_number(2, MOST_VEHICLES), listed(text)))


def _run_compare(options: argparse.Namespace) -> int:
    """Compare formation laws: every law on every graph under every condition, with the same seeds, and report settling,
    overshoot, smallest distance, gain per hop, RMS about the RFT, control effort and bytes, and who wins where, with
    intervals of 95 %. All formations fly side by side in arrays, on all cores: the same bodies, loops, laws, links and
    separation filter as `sitl run`. The same command gives the same figures each time. docs/statistics.md defines them.

    examples:
      sitl compare                                    three laws on four graphs of 8 under four conditions (2 minutes)
      sitl compare --list                             the graphs and the conditions
      sitl compare --laws cooperative,my_law.py --graphs chain,range --conditions ideal,noise --vehicles 16 --lockstep 5
      sitl compare --laws cooperative,cooperative:feedforward=0.8 --graphs chain --vehicles 4,16,64
      sitl compare platoon --laws weighted,cooperative --vary links.peer_delay_s=0,0.05,0.1 --seeds 100 --seconds 40

    --vary and --set take any key of a scenario file, [N] for the N-th item of a list from 0, after law and condition. The
    values of --vary are YAML scalars with commas between them; --set takes lists and mappings as well. With noisy sensors
    hardly any formation stays within 10 cm: there the RMS is more informative than the settling time. A condition that a
    batch cannot fly (leader_change, lying), an autopilot other than px4, a target or a turning formation is flown by the
    agents one by one, which takes fifty times as long.

    --lockstep N lets the agents that fly real vehicles fly N of the flights again, of evenly chosen cells, and says which
    figures differ by more than 5 %, or with random errors from those of all seeds by more than these differ.

    the folder (default: a new one, runs/compare-DATE-TIME):
      index.html        one page with everything in it
      compare.csv       one row per flight; compare.parquet is the same, where pyarrow is installed
      compare.json      medians with intervals, winners, checks, the command, versions, and the digests of laws in files
      settling.pdf, by_graph.pdf, distance.pdf    the figures of the page for a paper

    Ctrl-C stops and keeps the flights that are complete. Flights are flown in batches, so a short comparison may have none
    yet; one line then says so. A second Ctrl-C stops at once and keeps nothing.

    exit codes:
      0    all flown, or listed
      1    a process ended before its flights did, most likely for lack of memory
      2    a scenario, a law or an argument cannot be used; one line says which and what to do
      130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM)
    """

    from sitl.compare.command import names_text, run

    if options.list:
        print(names_text())
        return EXIT_DONE
    return run(options_of(CompareOptions, vars(options)))


def _add_anything(parser: argparse.ArgumentParser) -> None:
    parser.prefix_chars = "\0"  # whatever it was called with, options too
    parser.add_argument("anything", nargs="*", help=argparse.SUPPRESS)


def replaced(name: str, by: str) -> CliCommand:
    """A command that is now another one, and says so."""

    def run(_: argparse.Namespace) -> int:
        return fail(f"`sitl {name}` is now `{by}`", EXIT_UNUSABLE)

    run.__doc__ = f"It is now `{by}`.\n\nexamples:"
    return command(name, f"now `{by}`", _add_anything, run)


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
    parser.add_argument(
        "--rare",
        metavar="A,B",
        help="probability per hour that two vehicles come too close, by splitting: of named missions, or all",
    )
    parser.add_argument("--fleet", type=Path, metavar="FILE", help="fly this fleet instead of random ones")
    parser.add_argument(
        "--adversarial", action="store_true", help="search for the worst flights instead of drawing them at random"
    )
    parser.add_argument(
        "--resume", type=Path, metavar="FOLDER", help="go on with the search that was stopped, from its folder"
    )
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--jobs", type=whole_number(1, MOST_JOBS), metavar="N", help="processes (default: one per core)")
    add_cluster(place)
    place.add_argument(
        "--external",
        choices=[str(kind) for kind in AutopilotKind],
        help="fly on real PX4 (SIH) or ArduCopter (SITL), one flight after the other (docs/external.md)",
    )
    add_binary(parser)
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
      sitl gauntlet --adversarial --flights 5000           search for the worst flights (five hours on two cores)
      sitl gauntlet --adversarial --flights 5000 --resume FOLDER
      sitl gauntlet --rare platoon,exchange --flights 40   probability per hour that two come too close (40 minutes)
      sitl gauntlet --external px4 --flights 10            on real autopilots (two minutes a flight)

    --adversarial searches, generation by generation, for the flights that come nearest to a violation: of separation_m, or of
    fence, obstacles and ground. `combined`, a family of its own, has several faults, wind, bounds of settings and walls at
    once. A generation has 16 flights of each family, and the last one is flown to its end. The five worst flights are flown
    again without all that they do not need. Ctrl-C keeps the generations that are complete, and --resume goes on with the
    seed and the families of FOLDER, up to --flights.

    --rare estimates how probable it is in an hour that two vehicles in formation come nearer than separation_m less three
    sigmas, with loss, delay, gusts and sensor noise: in each of up to 18 stages the nearest quarter of the flights go on, also
    with other random numbers. --flights is the number of flights in a stage. The nearest of each mission is written as a
    scenario file.

    --external leaves out what only stand-ins can do (pilots, failures, split networks) and fleets of more than six; flights
    land, and each has a folder like that of `sitl fly`.

    the folder (default: a new one, runs/gauntlet-DATE-TIME): gauntlet.json (every flight and the summaries), and the ten
    worst flights as scenario files: `sitl run FOLDER/FLIGHT.yaml` flies one again and plots it. FLIGHT.txt is the traceback
    of a flight that ended in an exception. --adversarial: search.json, its state, and worst_1.yaml to worst_5.yaml

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


COMPARE = command(
    "compare",
    "formation laws by graphs by conditions: who wins where, with figures and intervals, on one page",
    _add_compare,
    _run_compare,
    ("matplotlib", "jinja2", "rich", "scipy"),
)


REPLACED = (
    replaced("sweep", "sitl compare --vary ..."),
    replaced("study", "sitl compare"),
    replaced("switching", "sitl compare --graphs range"),
)


GAUNTLET = command(
    "gauntlet",
    "random flights of whole fleets in virtual time: how close do vehicles come, and do they reach their slots?",
    _add_gauntlet,
    _run_gauntlet,
    ("matplotlib", "rich", "scipy"),
)
