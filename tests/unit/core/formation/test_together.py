"""Vehicles that form together: their paths end together, and two that come too close are refused."""

from __future__ import annotations

from math import dist, hypot

import numpy as np
import pytest

from common import SLOTS, code_of, slot_peer, with_fields
from companion.core.consensus.peers import PeerState
from companion.core.formation.paths import FORM_OR_HOLD, Entering, FormingTogether, law_within_m
from companion.types.autopilot import VehicleState
from companion.types.flight import STREAMING, FlightPhase
from companion.types.formation import EAST, FlownSlot, FormationState, Gains
from companion.types.notices import Code, Notice
from companion.types.values import ZERO3, Vector3
from tests.helpers.laws import cooperative, weighted

NOW_S = 100.0
AT: Vector3 = (20.0, 0.0, 2.0)  # of the RFT
FLEET = FormationState(AT, ZERO3)


def entering(at: Vector3, *peers: PeerState) -> Entering:
    return Entering(NOW_S, VehicleState(position_enu_m=at), peers, EAST, SLOTS)


def forming(own_id: int = 2, separation_m: float = 1.0, has_height: bool = True) -> FormingTogether:
    return FormingTogether(own_id, separation_m, 1.0, 1.5, has_height)


def holding(vehicle_id: int, at: Vector3, phase: FlightPhase = FlightPhase.HOLD, **changes: object) -> PeerState:
    packet = with_fields(slot_peer(vehicle_id, air=True), position_enu_m=at, phase=phase, **changes)
    return PeerState(packet, NOW_S, NOW_S, NOW_S)


# ---------------------------------------------------------------- paths


@pytest.mark.parametrize("gains", [weighted().gains, cooperative().gains, Gains(1.0, 2.0), Gains(1.0, 5.0)])
def test_the_law_stays_below_the_speed_from_the_distance_given_for_it(gains: Gains) -> None:
    x, v, fastest_m_s = law_within_m(gains, 1.0), 0.0, 0.0
    for _ in range(20_000):
        v -= (gains.position_1_s2 * x + gains.velocity_1_s * v) * 0.001
        x += v * 0.001
        fastest_m_s = max(fastest_m_s, abs(v))
    assert fastest_m_s == pytest.approx(1.0, abs=0.01)


def test_no_path_is_flown_when_all_vehicles_are_near_their_slots() -> None:
    """The platoon of the paper starts 1 m off, all vehicles in the same direction."""
    peers = [holding(1, (21.0, 0.0, 2.0)), holding(3, (18.0, 0.0, 2.0))]
    assert forming().leaders_path(entering((19.5, 0.0, 2.0), *peers), FLEET, FORM_OR_HOLD) is None


@pytest.mark.parametrize("other", [(25.0, 0.0, 2.0), (19.2, 0.0, 2.0)])  # far away; near, but on the other side
def test_a_path_is_flown_when_one_vehicle_is_away_from_its_slot(other: Vector3) -> None:
    now = entering((19.3, 0.0, 2.0), holding(1, other))
    assert forming().leaders_path(now, FLEET, FORM_OR_HOLD) is not None


def test_the_leaders_path_lasts_long_enough_for_the_farthest_vehicle() -> None:
    now = entering((18.5, 0.0, 2.0), holding(1, (60.0, 0.0, 2.0)))
    path = forming().leaders_path(now, FLEET, FORM_OR_HOLD)
    assert path is not None
    assert path[1] > 1.875 * 40.0  # at 1 m/s
    follower = forming(1).followers_path(entering((60.0, 0.0, 2.0)), FLEET, path[1])
    assert follower is not None
    assert follower[1] == path[1]  # they end together
    speeds_m_s = [hypot(*follower[0](t)[1]) for t in np.linspace(0.0, path[1], 200)]
    assert max(speeds_m_s) <= 1.0


def test_a_follower_near_its_slot_ends_with_its_leader() -> None:
    now = entering((18.5, 0.1, 2.0))
    assert forming().followers_path(now, FLEET, 0.0) is None
    path = forming().followers_path(now, FLEET, 12.0)
    assert path is not None
    assert path[1] == 12.0


def test_height_does_not_count_when_each_vehicle_keeps_its_altitude() -> None:
    now = entering((18.5, 0.0, 12.0))
    assert forming().followers_path(now, FLEET, 0.0) is not None
    assert forming(has_height=False).followers_path(now, FLEET, 0.0) is None


# ---------------------------------------------------------------- checks


def refusal_from(own_at: Vector3, *peers: PeerState, plan: FormingTogether | None = None) -> Notice | None:
    plan, now = plan or forming(), entering(own_at, *peers)
    path = plan.leaders_path(now, FLEET, FORM_OR_HOLD)
    return plan.refusal(now, FLEET, path, FORM_OR_HOLD)


def test_crossing_paths_give_a_warning_when_all_form() -> None:
    plan = forming()
    now = entering((20.0, 0.0, 2.0), holding(1, (18.5, 0.2, 2.0)), holding(3, (17.0, 0.0, 2.0)))
    path = plan.leaders_path(now, FLEET, FORM_OR_HOLD)
    assert plan.refusal(now, FLEET, path, FORM_OR_HOLD) is None
    warning = plan.crossing(now, FLEET, path)
    assert code_of(warning) is Code.PATHS_CROSS
    assert "vehicles 2 and 1 come within 0.1" in warning.text
    assert code_of(plan.refusal(now, FLEET, path, STREAMING)) is Code.PATH_TOO_CLOSE


def test_vehicles_arranged_like_the_slots_are_accepted() -> None:
    plan = forming()
    now = entering((98.5, 7.0, 2.0), holding(1, (100.0, 7.0, 2.0)), holding(3, (97.0, 7.3, 2.0)))
    path = plan.leaders_path(now, FLEET, FORM_OR_HOLD)
    assert plan.crossing(now, FLEET, path) is None


def test_a_vehicle_in_hold_that_does_not_form_is_in_the_way() -> None:
    own, plan = (25.0, 0.0, 2.0), forming()
    path = plan.followers_path(entering(own), FLEET, 0.0)
    beside, in_the_way = holding(1, (22.0, 1.5, 2.0)), holding(1, (22.0, 0.3, 2.0))
    assert plan.refusal(entering(own, beside), FLEET, path, STREAMING) is None
    refusal = plan.refusal(entering(own, in_the_way), FLEET, path, STREAMING)
    assert code_of(refusal) is Code.PATH_TOO_CLOSE
    assert "vehicle 1, which does not form" in refusal.text


@pytest.mark.parametrize("phase", [FlightPhase.LAND, FlightPhase.RETURN, FlightPhase.TAKEOFF])
def test_a_vehicle_that_climbs_or_lands_is_in_the_way_at_every_height(phase: FlightPhase) -> None:
    own, plan = (25.0, 0.0, 2.0), forming()
    path = plan.followers_path(entering(own), FLEET, 0.0)
    below = holding(1, (22.0, 0.2, -4.0), phase)
    assert code_of(plan.refusal(entering(own, below), FLEET, path, FORM_OR_HOLD)) is Code.PATH_TOO_CLOSE
    assert plan.refusal(entering(own, holding(1, (22.0, 0.2, -4.0))), FLEET, path, STREAMING) is None


def test_a_vehicle_on_the_ground_is_in_nobodys_way() -> None:
    own, plan = (25.0, 0.0, 2.0), forming()
    path = plan.followers_path(entering(own), FLEET, 0.0)
    on_ground = holding(1, (22.0, 0.2, 2.0), FlightPhase.READY)
    assert plan.refusal(entering(own, on_ground), FLEET, path, FORM_OR_HOLD) is None


def test_slots_within_the_separation_do_not_refuse_the_path() -> None:
    plan = forming(separation_m=1.6)
    assert refusal_from((18.5, 0.0, 2.0), holding(1, (20.0, 0.0, 2.0)), plan=plan) is None


def test_the_published_path_of_a_peer_is_predicted_to_its_end() -> None:
    """A peer half way along its path is predicted where it then is."""
    plan, peer_plan, half_s = forming(), forming(1), 6.0
    path = peer_plan.followers_path(entering((30.0, 5.0, 2.0)), FLEET, 12.0)
    assert path is not None
    position, velocity, acceleration = path[0](half_s)
    x, y, z = (r + d for r, d in zip(AT, position, strict=True))
    slot = FlownSlot(position, velocity, acceleration, moves_for_s=path[1] - half_s)
    moving = holding(1, (x, y, z), FlightPhase.FORMATION, velocity_enu_m_s=velocity, slot=slot)
    predicted = plan.peers_path(entering(ZERO3), FLEET, moving, 1.0)
    for t in (0.0, 1.0, 3.0, 5.0):
        assert dist(predicted(t)[0], path[0](half_s + t)[0]) < 1e-6
