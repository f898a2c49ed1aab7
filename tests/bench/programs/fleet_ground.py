"""A ground computer that stays connected: answers to commands and phases, one line of JSON for each line of its input.

    python -m tests.bench.programs.fleet_ground FLEET_FILE [IDENTITY_FOLDER]

`phases`: of every vehicle that reports. `COMMAND ID ...`: whether each of these vehicles accepted, and after which time in
seconds; null where it did not answer within 3 s.
"""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec

from companion.config.fleet_check import load_fleet
from companion.config.vehicle import ground_endpoints
from companion.ground.session import FleetSession
from companion.link.fleet.identity import load
from companion.types.commands import CommandName

ANSWERED_WITHIN_S = 3.0


class Answered(msgspec.Struct, frozen=True):
    accepted: bool
    after_s: float


def main(fleet_file: Path, identity_folder: Path | None) -> None:
    fleet, identity = load_fleet(fleet_file), load(identity_folder, {}) if identity_folder else None
    endpoints = ground_endpoints(fleet, identity is not None)
    with FleetSession(fleet.name, endpoints, identity=identity) as session:
        for line in sys.stdin:
            name, *ids = line.split()
            if name == "phases":
                answer: object = {i: status.phase for i, status in session.newest().items()}
            else:
                asked = session.ask([int(i) for i in ids], CommandName(name), ANSWERED_WITHIN_S)
                answer = {i: Answered(one.reply.accepted, one.after_s) if one else None for i, one in asked.items()}
            print(msgspec.json.encode(answer).decode(), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)
