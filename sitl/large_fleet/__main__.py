"""python -m sitl.large_fleet"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from sitl.bench.machine import others_cpu_s
from sitl.large_fleet.run import NUMBERS, measure_all, table, write_page


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m sitl.large_fleet",
        description="CPU and bytes of one agent's Zenoh link among others that publish at 50 Hz, all received at that rate or"
        " eight of them and the rest at 5 Hz, with connections of its own and through a Zenoh router. Linux, with iproute2.",
    )
    parser.add_argument(
        "--others", type=int, nargs="+", default=NUMBERS, metavar="N", help="publishers (default 8 16 32 64)"
    )
    parser.add_argument("--port", type=int, default=17600, metavar="PORT", help="first of one for each case (17600)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the table between the marks of this page")
    options = parser.parse_args()
    if not all(1 <= number <= 200 for number in options.others):
        parser.error("expected 1 to 200 publishers")
    rows, before_s, began_s = [], others_cpu_s(), time.monotonic()
    try:
        for row in measure_all(options.others, options.port):
            print(row.line(), flush=True)
            rows.append(row)
    except RuntimeError as error:
        print(f"sitl.large_fleet: {error}", file=sys.stderr)
        return 1
    others_cores = (others_cpu_s() - before_s) / (time.monotonic() - began_s)
    elsewhere = f"Meanwhile other processes used {others_cores:.1f} cores."
    print(elsewhere)
    if options.page:
        write_page(options.page, f"{table(rows)}\n\n{elsewhere}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
