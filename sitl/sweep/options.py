"""The command line of `sitl sweep`. Light to import: what flies is imported when it does."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

DEFAULT_SEEDS = 20  # below that, 5 and 95 percent are the extremes
MAX_FLIGHTS = 100_000
SHORTEST_S, LONGEST_S = 2.0, 3600.0  # "final" and "settled" are taken over the last 2 s

DESCRIPTION = """\
Fly a scenario's formation many times, in every combination of the values that --vary lists, each with seeds 1 to N, and
say how the figures spread. All formations fly side by side in arrays, on all cores: the same bodies, loops, law and links
as `sitl run`, hundreds to thousands of times faster than real time. The same command gives the same figures each time.
"""

MORE = """\
examples:
  sitl sweep config/scenarios/platoon.yaml --vary fleet.law.name=weighted,average_22,average_26
  sitl sweep config/scenarios/platoon.yaml --vary fleet.law.exponent=0,1,2,8 --vary links.peer_loss=0,0.1,0.3
  sitl sweep config/scenarios/platoon.yaml --vary fleet.law.name=weighted,cooperative \\
             --vary links.peer_delay_s=0,0.05,0.1,0.2 --set stand_in.sensors=ideal --seeds 100 --seconds 40

--vary and --set take any key of the scenario file, [N] for the N-th item of a list from 0. The values of --vary are YAML
words and numbers with commas between them; a list or a mapping cannot be varied, but its items can
(--vary "starts_enu_m.2[0]=-1.5,-2.0"), and --set takes it as a whole. All combinations are flown: 3 values of one key and
4 of another with 20 seeds are 240 flights; 100000 are the most. Ideal sensors over links that lose nothing leave little to
chance: a seed then only says when within a period each vehicle ticks, so a few seeds will do. With noisy sensors hardly any
formation stays within 10 cm; there the final error tells more than the time to settle.

A flight begins in formation, at rest over `starts_enu_m` at the height of take-off, and lasts S seconds. It knows no take-off
and no landing, no ground and no fence, no failsafe and no change of leaders: of the timeline only the time of its `form` step
is used, and a formation that turns with its course is refused. `sitl run` flies all that, one flight at a time; with ideal
sensors the figures of both agree to a few millimetres.

the folder (default: runs/SCENARIO-sweep-DATE-TIME):
  sweep.csv     one row per flight: the varied keys, seed, settle_s (from when on nobody is farther than 10 cm from its place;
                empty where that never came), largest and smallest distance of neighbours, smallest distance of any two, and
                final error (RMS of the last 2 s, of the vehicle that is farthest off)
  sweep.json    per combination: how many flights, the share that settled, and the median, 5 and 95 percentiles of each figure.
                A flight that never settled counts as later than all that did; null says that the percentile is such a flight
  sweep.png     the same to look at: over the numeric key with the most values, one curve for each other combination

Ctrl-C stops and keeps the flights that are complete. Flights are flown in batches, so of a short sweep nothing may be
complete yet; the one line then says so. A second Ctrl-C stops at once and keeps nothing.

exit codes:
  0    all flown
  1    a process ended before its flights did, most likely for want of memory
  2    the scenario or an argument cannot be used; the one line says which and what to do
  130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM)
"""


@dataclass(frozen=True, slots=True)
class SweepOptions:
    """What the command line says. `seconds` is None where the scenario says it; `workers` where the machine does."""

    scenario: Path
    varied: Sequence[str] = ()
    seeds: int = DEFAULT_SEEDS
    seconds: float | None = None
    overrides: Sequence[str] = ()
    out: Path | None = None
    quiet: bool = False
    workers: int | None = None


def add_sweep_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", type=Path, metavar="SCENARIO", help="a scenario file, see config/scenarios/")
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
        type=_seeds,
        default=DEFAULT_SEEDS,
        metavar="N",
        help=f"fly each combination with stand_in.seed 1 to N (default {DEFAULT_SEEDS})",
    )
    parser.add_argument(
        "--seconds",
        type=_seconds,
        metavar="S",
        help=f"how long each formation flies, {SHORTEST_S:g} to {LONGEST_S:g} (default: for_s of the scenario's form step)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="overrides",
        metavar="KEY=VALUE",
        help="change one key of the scenario in all flights; may be given many times",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="the folder for the results")
    parser.add_argument("--quiet", action="store_true", help="print the result only")


def sweep_options(parsed: argparse.Namespace) -> SweepOptions:
    return SweepOptions(
        parsed.scenario, parsed.varied, parsed.seeds, parsed.seconds, parsed.overrides, parsed.out, parsed.quiet
    )


def _seeds(text: str) -> int:
    if not text.isdecimal() or len(text) > len(str(MAX_FLIGHTS)) or not 1 <= int(text) <= MAX_FLIGHTS:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a whole number from 1 to {MAX_FLIGHTS}")
    return int(text)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not SHORTEST_S <= value <= LONGEST_S:
        raise argparse.ArgumentTypeError(f"{text!r}, expected {SHORTEST_S:g} to {LONGEST_S:g} seconds")
    return value
