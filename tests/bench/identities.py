"""CPU of whole agents in formation with identities, against the same flight without: python -m tests.bench.identities.

Both fly on addresses of this machine, in turn. The limit is LIMIT times the CPU of agents without identities.
"""

from __future__ import annotations

import sys
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory

from companion.link.fleet.identity import load
from companion.security.identity import Identity
from sitl.flight.files import autopilots_of, write_files
from sitl.flight.scenario import Scenario, load_scenario
from sitl.links.free_ports import reserved_ports
from tests.bench.provisioned import identity_folder, provision, use_identities
from tests.bench.real_flight import RealFlight
from tests.bench.scenarios import SCENARIOS

SCENARIO = SCENARIOS / "platoon.yaml"
ROUNDS = 2
FORM_S = 40.0
LIMIT = 1.2
GROUND = "ground-bench"


def main() -> int:
    scenario = load_scenario(SCENARIO, [f"timeline[3].for_s={FORM_S:g}"])
    percent: dict[bool, list[float]] = {False: [], True: []}
    for number in range(2 * ROUNDS):
        secured = number % 2 == 1
        with TemporaryDirectory(prefix="agents-") as folder:
            percent[secured].append(_cpu_percent(scenario, Path(folder), secured))
        print(f"  {_name(secured):22} {percent[secured][-1]:5.1f} % of a core for each agent", flush=True)
    ratio = fmean(percent[True]) / fmean(percent[False])
    print(f"TLS against TCP: {ratio:.2f} times the CPU, limit {LIMIT:g}")
    return 0 if ratio <= LIMIT else 1


def _name(secured: bool) -> str:
    return "TLS with identities" if secured else "TCP without identities"


def _cpu_percent(scenario: Scenario, folder: Path, secured: bool) -> float:
    """Mean of the agents in formation, as they report it."""
    with reserved_ports(autopilots_of(scenario), None) as offset:
        write_files(scenario, folder, offset)
        identity: Identity | None = None
        if secured:
            keys = folder / "keys"
            provision(scenario, folder, keys, [GROUND])
            use_identities(scenario, folder, keys)
            identity = load(identity_folder(keys, GROUND))
        flight = RealFlight(scenario, folder, offset, identity=identity)
        failures = flight.fly()
    if failures:
        raise SystemExit("\n".join(failures))
    return fmean(timing.cpu_percent for timing in flight.watch.newest_timing.values())


if __name__ == "__main__":
    sys.exit(main())
