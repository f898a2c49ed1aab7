"""`make hostile`: decoders and whole agents under seeded hostile input.

Every decoder gets seeded damaged input, and fleets of whole agents fly under decodable but hostile packets, commands,
targets, traffic and telemetry. No exception, no setpoint outside its limits, no growing state, no tick above 20 ms of CPU
time; afterwards the true operator and the true peers work.

Exit codes: 0 no failure; 1 an invariant was broken; 2 an argument cannot be used.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from companion.cli.options import whole_number
from tests.fuzz.run import run_hostile


def main() -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--inputs", type=whole_number(0, 10**9), default=100_000, metavar="N", help="for each decoder")
    parser.add_argument("--ticks", type=whole_number(0, 10**9), default=30_000, metavar="N", help="of whole agents")
    parser.add_argument("--seed", type=whole_number(0, 10**9), default=0, metavar="N", help="of all inputs (default 0)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the table to this file, too")
    parsed = parser.parse_args()
    return run_hostile(parsed.inputs, parsed.ticks, parsed.seed, parsed.out)


if __name__ == "__main__":
    sys.exit(main())
