"""A fleet whose distant vehicles are received at 5 Hz, in virtual time: nothing that matters may come late."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from common import ROOT
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, HealthFlag, Role
from lockstep_fleet import CommandedFlight

CHAIN = ROOT / "config" / "scenarios" / "chain_16.yaml"
C, P = CommandName, FlightPhase
IDS = tuple(range(1, 7))
SPACING_M = 10.0
SEPARATION_M = 1.5
X_M = {i: -SPACING_M * (i - 1) for i in IDS}
VEHICLES = ", ".join(
    f"{{id: {i}, role: {'leader' if i == 1 else 'follower'}, slot_enu_m: [{x}, 0.0, 0.0], may_lead: {str(i < 3).lower()}}}"
    for i, x in X_M.items()
)
EDGES = {"kind": "edges", "edges": [[i, i + 1] for i in IDS[:-1]]}
RANGE = {"kind": "range", "range_m": 1.2 * SPACING_M, "hysteresis_m": 1.0}


class LargeFleet(CommandedFlight):
    """A chain in a circle, with `full_rate_up_to` from the fleet file, and who receives whom at 5 Hz."""

    def __init__(self, neighbours: dict[str, object] = EDGES, full_rate_up_to: int = 1, *overrides: str) -> None:
        super().__init__(
            CHAIN,
            f"fleet.vehicles=[{VEHICLES}]",
            f"fleet.neighbours={neighbours}",
            f"starts_enu_m={ {i: [x, 0.0, 0.0] for i, x in X_M.items()} }",
            "fleet.takeoff_height_m=2.0",
            "timeline[3].for_s=0",
            f"fleet.separation_m={SEPARATION_M}",
            "fleet.successors=[2]",
            f"fleet.peers.full_rate_up_to={full_rate_up_to}",
            "reference={kind: circle, centre_enu_m: [-6.0, 0.0, 2.0], radius_m: 6.0, period_s: 30.0}",
            *overrides,
        )

    @property
    def distant(self) -> dict[int, frozenset[int]]:
        """Of each vehicle those that it receives at 5 Hz."""
        return dict(self.lockstep.network.distant)

    def receivers_at_5_hz(self, vehicle_id: int) -> set[int]:
        return {i for i, ids in self.distant.items() if vehicle_id in ids}

    def received(self, vehicle_id: int, within_s: float) -> list[int]:
        """Senders of the packets that a vehicle receives from now on."""
        receive, senders = self.lockstep.network.receive, []

        def counted(receiver: int, now_s: float) -> Iterable[object]:
            packets = receive(receiver, now_s)
            if receiver == vehicle_id:
                senders.extend(received.packet.sender.vehicle_id for received in packets)
            return packets

        self.lockstep.network.receive = counted  # type: ignore[method-assign, assignment]
        self.go_on(within_s)
        self.lockstep.network.receive = receive  # type: ignore[method-assign]
        return senders

    def tracks(self) -> dict[int, list[list[float]]]:
        times_s = np.arange(0.0, self.lockstep.now_s() - 0.1, 0.1)
        return {s.vehicle_id: s.track().at(times_s).tolist() for s in self.lockstep.stand_ins}


def rejected(flight: CommandedFlight) -> set[str]:
    return {key for status in flight.newest.values() for key in status.rejected}


@pytest.mark.parametrize("neighbours", [EDGES, pytest.param(RANGE, marks=pytest.mark.long)], ids=["edges", "range"])
def test_a_formation_flies_as_if_all_were_received_at_50_hz(neighbours: dict[str, object]) -> None:
    two_rates, full_rate = LargeFleet(neighbours), LargeFleet(neighbours, 250)
    for flight in (two_rates, full_rate):
        flight.go_on(14.0)
    assert all(full_rate.distant[i] == frozenset() for i in IDS)
    assert two_rates.distant[1] == {3, 4, 5, 6}
    assert two_rates.distant[6] == {3, 4}  # not the leader, its successor and the neighbour
    assert rejected(two_rates) == set()
    assert two_rates.tracks() == full_rate.tracks()
    senders = two_rates.received(6, 2.0)
    assert 8 <= senders.count(4) <= 12
    assert 95 <= senders.count(1) <= 105


def test_a_vehicle_that_leaves_or_joins_is_received_at_50_hz_by_all_within_half_a_second() -> None:
    flight = LargeFleet()
    flight.go_on(16.0)
    assert flight.receivers_at_5_hz(6) == {1, 2, 3, 4}
    flight.give(C.HOLD, 6)
    flight.go_on(0.5)
    assert flight.receivers_at_5_hz(6) == set()
    assert flight.distant[6] == frozenset()
    flight.go_on(3.0)
    since_s = flight.lockstep.now_s()
    flight.give(C.FORM, 6)
    flight.until(6, P.FORMATION)
    flight.go_on(14.0)
    assert max(flight.errors_m().values()) < 0.5
    assert flight.smallest_m(since_s) > SEPARATION_M
    assert flight.receivers_at_5_hz(6) == {1, 2, 3, 4}


def test_a_lost_leader_is_replaced_as_quickly_and_all_are_received_at_50_hz_meanwhile() -> None:
    flight = LargeFleet()
    flight.go_on(14.0)
    flight.separate(1, for_s=60.0)
    flight.go_on(0.5)
    assert all(not flight.distant[i] or HealthFlag.LEADER_AWAITED not in flight.newest[i].safety.flags for i in IDS[1:])
    flight.go_on(1.5)
    assert flight.newest[2].leadership.role is Role.LEADER
    assert all(flight.newest[i].phase is P.FORMATION for i in IDS[1:])


@pytest.mark.long
def test_packets_that_are_lost_make_no_vehicle_absent() -> None:
    flight = LargeFleet(EDGES, 1, "links.peer_loss=0.1", "links.peer_delay_s=0.05", "links.peer_jitter_s=0.1")
    flight.go_on(30.0)
    assert flight.distant[6] == {3, 4}
    assert all(not status.safety.flags for status in flight.newest.values())
    assert max(flight.errors_m().values()) < 3.0
