"""`python -m tests.soak --seconds 3600 --out FOLDER`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.soak.run import run_soak


def main() -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.soak",
        description="Eight vehicles in formation as real processes; memory, files, threads and tick timing over time.",
    )
    parser.add_argument("--seconds", type=float, default=3600.0, metavar="S", help="in formation (default 3600)")
    parser.add_argument("--out", type=Path, default=Path("runs/soak"), metavar="FOLDER", help="default runs/soak")
    parser.add_argument("--page", type=Path, metavar="FILE", help="also write the page of the documentation")
    parser.add_argument("--quiet", action="store_true", help="only the result")
    parsed = parser.parse_args()
    return run_soak(parsed.out, parsed.seconds, parsed.quiet, parsed.page)


if __name__ == "__main__":
    sys.exit(main())
