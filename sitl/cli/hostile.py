"""`sitl hostile`: decoders and whole agents under seeded hostile input."""

from __future__ import annotations

import argparse
from pathlib import Path

from sitl.cli.options import whole_number

HELP = "decoders and whole agents under millions of damaged, wrong and forged messages"
DESCRIPTION = """\
Gives every decoder seeded damaged input, and flies fleets of whole agents under decodable but hostile packets, commands,
targets, traffic and telemetry. No exception, no setpoint outside its limits, no growing state, no tick above 20 ms of CPU
time; afterwards the true operator and the true peers work.
"""
MORE = """\
examples:
  sitl hostile                                  a short run (a minute)
  sitl hostile --inputs 10000000 --ticks 1000000 --out docs/hostile.md

exit codes: 0 no failure; 1 an invariant was broken; 2 an argument cannot be used
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--inputs", type=whole_number(0, 10**9), default=100_000, metavar="N", help="for each decoder")
    parser.add_argument("--ticks", type=whole_number(0, 10**9), default=30_000, metavar="N", help="of whole agents")
    parser.add_argument("--seed", type=whole_number(0, 10**9), default=0, metavar="N", help="of all inputs (default 0)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the table to this file, too")


def run(parsed: argparse.Namespace) -> int:
    from sitl.hostile.command import run_hostile

    return run_hostile(parsed.inputs, parsed.ticks, parsed.seed, parsed.out)
