"""`sitl sweep`: statistics of many flights of one formation."""

from __future__ import annotations

import argparse

from companion.cli.options import add_overrides
from sitl.cli.options import add_cluster, add_out_and_quiet, add_scenario, number, whole_number
from sitl.sweep.options import DEFAULT_SEEDS, LONGEST_S, MAX_FLIGHTS, SHORTEST_S, SweepOptions

HELP = "statistics: many flights of one formation, with varied keys and seeds, side by side in arrays"
DESCRIPTION = """\
Fly a scenario's formation many times, in every combination of the values that --vary lists, each with seeds 1 to N, and
report the spread of the figures. All formations fly side by side in arrays, on all cores: the same bodies, loops, law and links
as `sitl run`, hundreds to thousands of times faster than real time. The same command gives the same figures each time.
"""

MORE = """\
examples:
  sitl sweep config/scenarios/platoon.yaml --vary fleet.law.name=weighted,average_22,average_26
  sitl sweep config/scenarios/platoon.yaml --vary fleet.law.exponent=0,1,2,8 --vary links.peer_loss=0,0.1,0.3
  sitl sweep config/scenarios/platoon.yaml --vary fleet.law.name=weighted,cooperative \\
             --vary links.peer_delay_s=0,0.05,0.1,0.2 --set stand_in.sensors=ideal --seeds 100 --seconds 40

--vary and --set take any key of the scenario file, [N] for the N-th item of a list from 0. The values of --vary are YAML
scalars with commas between them; a list or a mapping cannot be varied, but its items can
(--vary "starts_enu_m.2[0]=-1.5,-2.0"), and --set takes it as a whole. All combinations are flown: 3 values of one key and
4 of another with 20 seeds are 240 flights; 100000 are the most. With ideal sensors and
lossless links a seed only sets when within a period each vehicle ticks, so a few seeds are enough. With noisy sensors hardly
any formation stays within 10 cm; there the final error is more informative than the settling time.

A flight begins in formation, at rest over `starts_enu_m` at the height of take-off, and lasts S seconds. It has no take-off
and no landing, no ground and no fence, no failsafe and no change of leaders: of the timeline only the time of its `form` step
is used, and a formation that turns with its course is refused. `sitl run` flies all of these, one flight at a time; with ideal
sensors the figures of both agree to a few millimetres.

the folder (default: a new one, runs/SCENARIO-sweep-DATE-TIME):
  sweep.csv     one row per flight: the varied keys, seed, settle_s (the time from which every vehicle stays within 10 cm of
                its slot; empty if never), largest and smallest distance of neighbours, smallest distance of any two, and
                final error (RMS of the last 2 s, of the vehicle with the largest)
  sweep.json    per combination: how many flights, the share that settled, and the median, 5 and 95 percentiles of each figure.
                A flight that never settled counts as later than all that did; null: the percentile is such a flight
  sweep.png     the same as curves: over the numeric key with the most values, one curve for each other combination

Ctrl-C stops and keeps the flights that are complete. Flights are flown in batches, so a short sweep may have
no complete flight yet; one line then says so. A second Ctrl-C stops at once and keeps nothing.

exit codes:
  0    all flown
  1    a process ended before its flights did, most likely for lack of memory
  2    the scenario or an argument cannot be used; one line says which and what to do
  130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM)
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
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
        type=number(f"{SHORTEST_S:g} to {LONGEST_S:g} seconds", lambda value: SHORTEST_S <= value <= LONGEST_S),
        metavar="S",
        help=f"duration of each flight, {SHORTEST_S:g} to {LONGEST_S:g} (default: for_s of the scenario's form step)",
    )
    add_overrides(parser, "change one key of the scenario")
    add_cluster(parser)
    add_out_and_quiet(parser)


def run(parsed: argparse.Namespace) -> int:
    from sitl.sweep.run import run as run_sweep

    return run_sweep(sweep_options(parsed))


def sweep_options(parsed: argparse.Namespace) -> SweepOptions:
    return SweepOptions(
        parsed.scenario,
        parsed.varied,
        parsed.seeds,
        parsed.seconds,
        parsed.overrides,
        parsed.out,
        parsed.quiet,
        parsed.cluster,
    )
