"""A fleet whose network splits and heals, in virtual time: each part acts by the failsafe matrix, and they form again."""

from __future__ import annotations

from random import Random

import pytest

from common import ROOT
from companion.config.law import law_of
from companion.ground.changes import reference_change
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, HealthFlag, Role
from lockstep_fleet import JUMP_M, CommandedFlight

RING = ROOT / "config" / "scenarios" / "ring_figure_8.yaml"
C, P, F = CommandName, FlightPhase, HealthFlag
SEPARATION_M = 1.0
SUCCESSORS = ("fleet.vehicles[2].may_lead=true", "fleet.successors=[2,3]", f"fleet.separation_m={SEPARATION_M}")
LAWS = pytest.mark.parametrize("law", ["cooperative", "weighted"])
# Of what a vehicle steers to, when the network heals: two leaders were up to 0.15 s apart, at up to 0.5 m/s, and followers
# of the weighted law lag behind each of them.
HEALED_JUMP_M = {"cooperative": 0.075, "weighted": 0.2}
HEALED_WITHIN_S = 1.0


def on_the_figure_8(law: str, *overrides: str) -> CommandedFlight:
    """Four vehicles in a ring, on the figure since 14 s."""
    flight = CommandedFlight(RING, f"fleet.law.name={law}", "timeline[3].for_s=4", *SUCCESSORS, *overrides)
    flight.go_on(9.5)
    return flight


def leaders(flight: CommandedFlight) -> set[int]:
    return {i for i, status in flight.newest.items() if status.leadership.role is Role.LEADER}


def phases(flight: CommandedFlight) -> dict[int, FlightPhase]:
    return {i: status.phase for i, status in flight.newest.items()}


def assert_safe(flight: CommandedFlight, since_s: float, separated_for_s: float | None = None) -> None:
    """No two vehicles too near, no jump of a slot or a reference, and none of what is steered to when the network heals."""
    assert flight.smallest_m(since_s) >= SEPARATION_M
    assert flight.decisions.jump_m(since_s) < JUMP_M
    if separated_for_s is not None:
        law, healed_s = flight.scenario.fleet.law, since_s + separated_for_s
        jump_m = flight.decisions.steered_jump_m(law_of(law), healed_s, healed_s + HEALED_WITHIN_S)
        assert jump_m < HEALED_JUMP_M[law.name]


def form_again(flight: CommandedFlight, vehicle_id: int) -> None:
    """Command `form` until it is accepted: while others fly past, the way to the slot is not free."""
    for _ in range(40):
        reply = flight.answers(C.FORM, vehicle_id)[vehicle_id]
        assert reply is not None
        if reply.accepted:
            flight.until(vehicle_id, P.FORMATION)
            return
        flight.go_on(0.5)
    raise AssertionError(reply)


@LAWS
def test_a_leader_that_is_cut_off_holds_and_follows_its_successor_afterwards(law: str) -> None:
    flight = on_the_figure_8(law)
    since_s = flight.lockstep.now_s()
    flight.separate(1, for_s=8.0)
    flight.go_on(4.5)
    assert leaders(flight) == {1, 2}  # on one reference and one mission time
    times_s = [flight.newest[i].formation.reference_s for i in (1, 2)]
    assert times_s[0] == pytest.approx(times_s[1], abs=0.15)
    assert F.FLEET_LINK_LOST in flight.newest[1].safety.flags
    flight.go_on(1.5)
    assert phases(flight) == {1: P.HOLD, 2: P.FORMATION, 3: P.FORMATION, 4: P.FORMATION}
    flight.go_on(3.0)
    assert leaders(flight) == {2}
    assert not flight.newest[1].safety.flags
    form_again(flight, 1)
    flight.go_on(8.0)
    assert leaders(flight) == {2}
    assert flight.errors_m().keys() == {1, 2, 3, 4}
    assert_safe(flight, since_s, separated_for_s=8.0)


@LAWS
def test_two_halves_fly_on_and_become_one_fleet_again(law: str) -> None:
    """Their slots are far apart for this separation_m: nearer ones brake and wait."""
    flight = on_the_figure_8(law, "fleet.separation_m=0.5")
    since_s = flight.lockstep.now_s()
    flight.separate(1, 4, for_s=6.0)
    flight.go_on(5.0)
    assert leaders(flight) == {1, 2}
    assert set(phases(flight).values()) == {P.FORMATION}
    flight.go_on(2.0)
    assert leaders(flight) == {2}
    assert {status.leadership.epoch for status in flight.newest.values()} == {1}
    flight.go_on(8.0)
    assert set(phases(flight).values()) == {P.FORMATION}
    assert max(flight.errors_m().values()) < 0.8
    assert_safe(flight, since_s, separated_for_s=6.0)


def test_a_reference_that_only_one_half_received_is_flown_by_both_afterwards() -> None:
    flight = on_the_figure_8("cooperative")
    since_s = flight.lockstep.now_s()
    flight.separate(1, 4, for_s=6.0)
    flight.go_on(2.0)
    away = {"kind": "point", "point_enu_m": [6.0, 0.0, 2.0]}
    change = reference_change(away, list(flight.newest.values()))
    flight.give(C.REFERENCE, 2, content=change)  # the leader of one half
    flight.go_on(20.0)
    assert leaders(flight) == {2}
    assert set(phases(flight).values()) == {P.FORMATION}
    assert max(flight.errors_m().values()) < 0.8
    assert_safe(flight, since_s, separated_for_s=6.0)


def test_a_follower_that_is_cut_off_holds_and_lands_while_the_others_fly_on() -> None:
    flight = on_the_figure_8("cooperative", "fleet.land_after_s=4")
    since_s = flight.lockstep.now_s()
    flight.separate(4, for_s=60.0)
    flight.go_on(2.0)
    assert phases(flight) == {1: P.FORMATION, 2: P.FORMATION, 3: P.FORMATION, 4: P.HOLD}
    flight.go_on(4.0)
    assert flight.newest[4].phase is P.LAND
    assert leaders(flight) == {1}
    assert_safe(flight, since_s)


def test_a_leader_that_only_cannot_receive_holds_and_the_fleet_waits_with_it() -> None:
    flight = on_the_figure_8("cooperative")
    since_s = flight.lockstep.now_s()
    flight.separate(1, for_s=8.0, lost="received")
    flight.go_on(7.0)
    assert phases(flight) == {1: P.HOLD, 2: P.FORMATION, 3: P.FORMATION, 4: P.FORMATION}
    flight.go_on(3.0)
    assert leaders(flight) == {1}
    form_again(flight, 1)
    flight.go_on(3.0)
    assert_safe(flight, since_s, separated_for_s=8.0)


def test_a_leader_that_is_not_received_becomes_a_follower_at_once() -> None:
    flight = on_the_figure_8("cooperative")
    since_s = flight.lockstep.now_s()
    flight.separate(1, for_s=5.0, lost="sent")
    flight.go_on(1.5)
    assert leaders(flight) == {2}
    flight.go_on(6.0)
    assert set(phases(flight).values()) == {P.FORMATION}
    assert_safe(flight, since_s, separated_for_s=5.0)


@LAWS
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_random_churn_violates_no_separation(law: str, seed: int) -> None:
    """Links flap, and vehicles leave and join, at random times."""
    random = Random(seed)
    flight = on_the_figure_8(law)
    since_s = flight.lockstep.now_s()
    for _ in range(6):
        ids = random.sample([1, 2, 3, 4], random.choice([1, 2]))
        flight.separate(*ids, for_s=random.uniform(0.1, 3.0), lost=random.choice(["both", "received", "sent"]))
        leaves = random.choice([3, 4, None])
        if leaves and flight.newest[leaves].phase is P.FORMATION:
            flight.give(C.HOLD, leaves)
        flight.go_on(random.uniform(0.5, 3.5))
        for vehicle_id in (i for i, phase in phases(flight).items() if phase is P.HOLD):
            flight.answers(C.FORM, vehicle_id)  # it may be refused, while it is cut off for example
        flight.go_on(1.0)
    flight.go_on(3.0)
    for vehicle_id in [i for i, phase in phases(flight).items() if phase is P.HOLD]:
        form_again(flight, vehicle_id)
    flight.go_on(8.0)
    assert len(leaders(flight)) == 1
    assert set(phases(flight).values()) == {P.FORMATION}
    assert_safe(flight, since_s)
