"""`python -m tests.bench --out FILE --page FILE`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from sitl.stopping import StopNow, StopRequest
from tests.bench.run import run


def main() -> int:
    """The exit code: 0 where everything was measured, whether or not the targets are met."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description="Speed, side by side, under 15 minutes.")
    parser.add_argument("--out", type=Path, default=Path("runs/bench/bench.json"), metavar="FILE")
    parser.add_argument("--page", type=Path, default=Path("docs/performance.md"), metavar="FILE")
    parsed = parser.parse_args()
    try:
        with StopRequest("stopped: nothing was written", at_once=True):
            run(parsed.out, parsed.page)
    except StopNow as stop:
        print(stop)
        return stop.exit_code
    except RuntimeError as error:
        print(f"not measured: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
