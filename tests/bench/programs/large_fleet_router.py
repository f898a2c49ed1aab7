"""A Zenoh router: python -m tests.bench.programs.large_fleet_router ENDPOINT. It runs until its input ends."""

from __future__ import annotations

import sys

from tests.bench.programs.large_fleet_link import opened


def main() -> None:
    with opened("router", [sys.argv[1]], []):
        print("ready", flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    main()
