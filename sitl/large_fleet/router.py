"""A Zenoh router: python -m sitl.large_fleet.router ENDPOINT. It runs until its input ends."""

from __future__ import annotations

import sys

from sitl.large_fleet.link import opened


def main() -> None:
    with opened("router", [sys.argv[1]], []):
        print("ready", flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    main()
