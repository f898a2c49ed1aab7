"""An admitted vehicle that lies is named to the operator and deposes no leader; once it is revoked nobody follows it."""

from __future__ import annotations

import numpy as np
import pytest

from common import ROOT
from companion.types.flight import FlightPhase, Role
from lockstep_fleet import CommandedFlight
from sitl.api import fly
from sitl.vehicle.lies import Liars, Lie

LINE = ROOT / "config" / "scenarios" / "four_in_line.yaml"
ALL_HEAR_ALL = "fleet.neighbours={kind: edges, edges: [[1, 2], [1, 3], [1, 4], [2, 3], [2, 4], [3, 4]]}"
AT_REST = "reference.point_enu_m=[0.0, 0.0, 5.0]"
MAY_LEAD = ("fleet.successors=[2]", "fleet.vehicles[1].may_lead=true")
NAMED_WITHIN_S, WARNS_AGAIN_AFTER_S, HELPS_WITHIN_S = 2.0, 5.0, 1.0


class LiarsFlight(CommandedFlight):
    """Four vehicles in formation; the network keeps what only a signature proves from those that do not have it."""

    def __init__(self) -> None:
        super().__init__(LINE, ALL_HEAR_ALL, *MAY_LEAD, AT_REST, "timeline[2].for_s=0", "timeline[3].for_s=1")

    def lie(self, *lies: Lie) -> None:
        """From now on."""
        self.lockstep.network.liars = Liars(lies)

    def is_named(self, liar: int) -> bool:
        """Whether an event of another vehicle names the liar within NAMED_WITHIN_S."""
        before = {i: status.last_event for i, status in self.newest.items()}
        for _ in range(round(NAMED_WITHIN_S / 0.1)):
            self.go_on(0.1)
            events = {i: s.last_event for i, s in self.newest.items() if i != liar and s.last_event != before[i]}
            if any(event and event.text.endswith(f": {liar}") for event in events.values()):
                return True
        return False


def test_a_liar_is_named_within_two_seconds_and_deposes_no_leader() -> None:
    flight = LiarsFlight()
    for lie in (
        Lie(vehicle=4, says="leader"),
        Lie(vehicle=3, says="velocity", by_enu=(3.0, 0.0, 0.0)),
        Lie(vehicle=2, says="epoch", by=7.0),
        Lie(vehicle=4, says="sequence", kind="frozen"),
        Lie(vehicle=3, says="position", kind="jump", by_enu=(0.0, 0.0, 4.0)),
        Lie(vehicle=2, says="acceleration", by_enu=(200.0, 0.0, 0.0)),
        Lie(vehicle=3, says="acceleration", by_enu=(0.0, 4.5, 0.0)),
    ):
        flight.lie(lie)
        assert flight.is_named(lie.vehicle), lie
        flight.lie()
        flight.go_on(WARNS_AGAIN_AFTER_S / 2.0)
    assert {status.phase for status in flight.newest.values()} == {FlightPhase.FORMATION}
    assert {status.leadership.role for i, status in flight.newest.items() if i > 1} == {Role.FOLLOWER}
    assert {status.leadership.epoch for status in flight.newest.values()} == {0}
    assert flight.smallest_m(0.0) > 1.9


def test_two_liars_are_both_named() -> None:
    flight = LiarsFlight()
    flight.lie(Lie(vehicle=3, says="leader"))
    assert flight.is_named(3)
    flight.lie(Lie(vehicle=3, says="leader"), Lie(vehicle=4, says="leader"))
    assert flight.is_named(4)


def test_what_the_leader_says_itself_counts_before_what_a_liar_passes_on_of_it() -> None:
    """Beacons with a stamp 0.25 s ahead made the leader's own ones old: without it, all held for lack of a leader."""
    flight = LiarsFlight()
    said = len(flight.events)
    flight.lie(
        Lie(vehicle=3, says="stamp", by=250.0),
        Lie(vehicle=3, says="heading", by=1.5, kind="jump"),
        Lie(vehicle=3, says="mission_time", by=9.0),
    )
    flight.go_on(3.0)
    flight.lie()
    flight.go_on(1.5)
    assert {status.phase for status in flight.newest.values()} == {FlightPhase.FORMATION}
    assert max(flight.errors_m().values()) < 0.1
    assert not [text for _, text in flight.events[said:] if "leader" in text]


@pytest.mark.parametrize("law", ["cooperative", "serial"])
def test_in_a_chain_a_liar_moves_nobody_between_it_and_the_leader(law: str) -> None:
    """They give it a weight of a thousandth. Under `weighted` it draws all, the leader too: docs/security.md."""
    from_s, most_m = 20.0, 0.3
    lie = {"vehicle": 3, "kind": "drift", "from_s": from_s, "by_enu": [0.0, 8.0, 0.0], "over_s": 8.0}
    sooner = {"stand_in.sensors": "ideal", "stand_in.armable_after_s": 1.0, "timeline[3].for_s": 20.0}
    overrides = {**sooner, "reference.point_enu_m": [0.0, 0.0, 5.0], "links.lies": [lie]}
    flight = fly(LINE, law=law, overrides=overrides)
    lied = np.all(np.isfinite(flight.errors_m), axis=1) & (flight.time_s > from_s)
    errors_m = dict(zip(flight.vehicles, flight.errors_m[lied].max(axis=0), strict=True))
    assert max(errors_m[i] for i in (1, 2, 3)) < most_m
    assert errors_m[4] > 5.0


def test_nobody_follows_a_revoked_liar_after_a_second() -> None:
    """What is revoked is not received any more: `companion/link/fleet`."""
    flight = LiarsFlight()
    flight.lie(Lie(vehicle=4, kind="drift", by_enu=(0.0, 8.0, 0.0), over_s=8.0, from_s=flight.lockstep.now_s()))
    flight.go_on(4.0)
    drawn_m = flight.errors_m()
    assert drawn_m[3] > 0.5
    flight.lockstep.network.paths[4] = []
    flight.go_on(HELPS_WITHIN_S)
    assert all(4 not in flight.newest[i].neighbourhood.neighbours for i in (1, 2, 3))
    flight.go_on(2.0)
    errors_m = flight.errors_m()
    assert all(errors_m[i] < max(0.3, 0.5 * drawn_m[i]) for i in (1, 2, 3)), (drawn_m, errors_m)


def test_who_says_that_it_may_lie_anywhere_below_pushes_nobody_through_a_low_ceiling() -> None:
    """separation_m above that ground is above the ceiling. They make way up to the clearance from it, and no farther."""
    says = [
        {"vehicle": 4, "says": "position", "kind": "drift", "over_s": 5.0, "by_enu": [0.0, 0.0, -1.5], "from_s": 15.0},
        {"vehicle": 4, "says": "disarmed", "from_s": 21.0},
        {"vehicle": 4, "says": "error", "by": 25.0, "from_s": 21.0},
    ]
    sooner = {"stand_in.sensors": "ideal", "stand_in.armable_after_s": 1.0, "timeline[3].for_s": 20.0}
    low = {
        "reference.point_enu_m": [0.0, 0.0, 1.5],
        "fleet.takeoff_height_m": 1.5,
        "fleet.separation_m": 2.0,
        "fleet.envelope.fence_max_enu_m": [40.0, 30.0, 1.9],
        "fleet.envelope.clearance_m": 0.2,
    }
    flight = fly(LINE, overrides={**sooner, **low, "links.lies": says})
    others = [index for index, vehicle in enumerate(flight.vehicles) if vehicle != 4]
    assert flight.positions_enu_m[:, others, 2].max() == pytest.approx(1.7, abs=0.01)
