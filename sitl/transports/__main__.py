"""python -m sitl.transports"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from sitl.transports.hosts import HostsError
from sitl.transports.run import LOSSES, TRANSPORTS, measure_all, table, write_page

EXIT_UNUSABLE = 2


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m sitl.transports",
        description="Age of the peers' states over each transport, with four vehicles in network namespaces of this machine"
        " and a radio between them that loses packets. Needs root, for the namespaces.",
    )
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="for each case (default 20)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the table between the marks of this page")
    options = parser.parse_args()
    rows = []
    try:
        with TemporaryDirectory(prefix="transports-") as folder:
            for row in measure_all(Path(folder), TRANSPORTS, LOSSES, options.seconds):
                print(row.line(), flush=True)
                rows.append(row)
    except HostsError as error:
        print(f"sitl.transports: {error}", file=sys.stderr)
        return EXIT_UNUSABLE
    if options.page:
        write_page(options.page, table(rows))
    return 0 if all(row.worst for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
