"""An admitted vehicle that lies in a flying fleet with identities: real agents, TLS, and one of them altered.

`make attacks` writes its row of docs/attacks.md.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import pytest

from companion.security.provisioning import revoke
from companion.types.flight import FlightPhase, HealthFlag, Role
from fault_table import FaultRow
from lying_agent import lie
from secured_fleet import SecuredFleet, secured_fleet
from sitl.flight.processes import FleetProcesses
from sitl.vehicle.lies import Lie

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(240), pytest.mark.every_fault]

OTHERS, LIAR = (1, 2, 3), 4
LYING_AGENT = Path(__file__).parents[1] / "helpers" / "lying_agent.py"
LIES = {
    "it leads": Lie(vehicle=LIAR, says="leader"),
    "the epoch is another one": Lie(vehicle=LIAR, says="epoch", by=7.0),
    "it jumps by 4 m": Lie(vehicle=LIAR, kind="jump", by_enu=(0.0, 0.0, 4.0)),
}


class WithLiar(FleetProcesses):
    """The last vehicle has an altered agent."""

    def start_module(self, name: str, ids: Sequence[int], folder: Path, module: str, *arguments: str) -> None:
        if name != f"agent {LIAR}":
            super().start_module(name, ids, folder, module, *arguments)
        else:
            self.start_program(name, ids, folder, [sys.executable, str(LYING_AGENT), *arguments[1:]])


def in_doubt(fleet: SecuredFleet) -> list[int]:
    """The vehicles that say that another one lies."""
    return [i for i in OTHERS if HealthFlag.PEER_IN_DOUBT in fleet.ground.newest[i].safety.flags]


def test_an_admitted_vehicle_that_lies_is_named_and_of_no_use_once_revoked(row: FaultRow, tmp_path: Path) -> None:
    with secured_fleet(tmp_path, processes=WithLiar) as fleet:
        longest_s = 0.0
        for name, one in LIES.items():
            began_s = time.monotonic()
            lie(fleet.folder, one)
            fleet.ground.wait(lambda: in_doubt(fleet), 10.0, lambda name=name: name)
            longest_s = max(longest_s, time.monotonic() - began_s)
            lie(fleet.folder)
            fleet.ground.wait(lambda: not in_doubt(fleet), 10.0)
        assert any(event.endswith(f": {LIAR}") for event in fleet.ground.events)
        helps_s = _revoked_after_s(fleet)
        newest = fleet.ground.newest
        assert fleet.ground.phases(OTHERS) == {FlightPhase.FORMATION}
        assert {i: (newest[i].leadership.role, newest[i].leadership.epoch) for i in OTHERS} == {
            i: (Role.LEADER if i == 1 else Role.FOLLOWER, 0) for i in OTHERS
        }
    row.fault = f"the altered agent of vehicle {LIAR} says that {', that '.join(LIES)}"
    row.demanded = "named within 2 s, no leader changed, in formation; revoked, not used after 1 s"
    row.measured += [f"named after {longest_s:.1f} s at most", f"not used {helps_s:.1f} s after the new list was sent"]
    row.outcome = "named, not followed; then revoked"


def _revoked_after_s(fleet: SecuredFleet) -> float:
    """Time from sending the list until no other vehicle uses the states of the liar."""
    revoke(fleet.keys, [f"vehicle-{LIAR}"], datetime.now(UTC))
    data, began_s = (fleet.keys / "authority" / "admitted.json").read_bytes(), time.monotonic()
    fleet.session.send_admission_list(data)
    fleet.ground.wait(lambda: all(LIAR not in fleet.ground.newest[i].neighbourhood.peers for i in OTHERS), 20.0)
    return time.monotonic() - began_s
