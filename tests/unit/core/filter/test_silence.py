"""Where a silent vehicle may be."""

from __future__ import annotations

from math import dist, hypot, inf, isfinite

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from common import NOW_S, peer
from companion.core.consensus.peers import PeerState
from companion.core.filter.motion import (
    KEPT_S,
    Ahead,
    Motion,
    Motions,
    Silence,
    column_m,
    nearest_on_way,
)
from companion.types.autopilot import VehicleState
from companion.types.peers import FORGOTTEN_S
from companion.types.values import ZERO3, Vector3

BRAKING_M_S2 = 2.0
PEER = Silence(0.3, 0.0, KEPT_S, BRAKING_M_S2, 15.0)
EAST: Motion = ((0.0, 0.0, 5.0), (4.0, 0.0, 0.0), ZERO3)
OWN_M_S: Vector3 = (3.0, 1.0, 0.0)
FAR_BEHIND: Vector3 = (-500.0, 0.0, 5.0)
FAR_AHEAD: Vector3 = (500.0, 0.0, 5.0)


def nearest(own_enu_m: Vector3, last: Motion, age_s: float, silence: Silence = PEER) -> Motion:
    return nearest_on_way(Ahead(own_enu_m, OWN_M_S), last, age_s, 0.0, silence, 1.0)


def test_a_vehicle_behind_meets_one_that_brakes_at_once() -> None:
    position, velocity, acceleration = nearest(FAR_BEHIND, EAST, 1.0)
    assert position == pytest.approx((3.0, 0.0, 5.0))
    assert velocity == pytest.approx((2.0, 0.0, 0.0))
    assert acceleration == pytest.approx((-2.0, 0.0, 0.0))
    assert nearest(FAR_BEHIND, EAST, 9.0) == (pytest.approx((4.0, 0.0, 5.0)), ZERO3, ZERO3)


def test_a_vehicle_ahead_meets_one_that_coasts() -> None:
    position, velocity, _ = nearest(FAR_AHEAD, EAST, 3.0)
    assert position == pytest.approx((4.0 + 6.3, 0.0, 5.0), abs=0.01)
    assert velocity == pytest.approx((2.43, 0.0, 0.0), abs=0.01)


def test_a_vehicle_beside_the_way_meets_the_point_next_to_it() -> None:
    position, velocity, _ = nearest((6.0, 2.0, 5.0), EAST, 3.0)
    assert position == pytest.approx((6.0, 0.0, 5.0))
    assert velocity == pytest.approx((OWN_M_S[0], 0.0, 0.0))  # it follows along the way, and does not turn away


def test_the_attitude_is_kept_at_first() -> None:
    turning: Motion = ((1.0, 2.0, 3.0), (4.0, 0.0, 0.0), (0.0, 2.0, 9.0))
    position, velocity, _ = nearest((1.0, 500.0, 3.0), turning, 0.9)
    assert position == pytest.approx((4.6, 2.81, 3.0))
    assert velocity == pytest.approx((4.0, 1.8, 0.0))


def test_one_that_brakes_may_level_and_coast_on_at_once() -> None:
    """Across its way the attitude is kept: what slows it down may have ended with the last setpoint."""
    slows: Motion = ((1.0, 2.0, 3.0), (3.0, 4.0, 0.0), (-4.0, 0.75, 0.0))
    position, velocity, acceleration = nearest((500.0, 500.0, 3.0), slows, 0.9)
    assert position == pytest.approx((1.0 + 2.7 - 0.405 * 2.92, 2.0 + 3.6 + 0.405 * 2.19, 3.0))
    assert velocity == pytest.approx((3.0 - 0.9 * 2.92, 4.0 + 0.9 * 2.19, 0.0))
    assert acceleration == pytest.approx((-2.92, 2.19, 0.0))
    heard = replace(PEER, begins_s=-inf)
    assert sum(nearest((500.0, 500.0, 3.0), slows, 0.9, heard)[0]) < sum(position) - 0.5
    speeds: Motion = ((1.0, 2.0, 3.0), (3.0, 4.0, 0.0), (-1.0, 0.8, 0.0))
    assert nearest((500.0, 500.0, 3.0), speeds, 0.9)[2] == (-1.0, 0.8, 0.0)


@pytest.mark.parametrize("speed_m_s", [5e-324, 1e-200, 1e-160, 1e-12])
def test_a_speed_whose_square_is_0_does_no_harm(speed_m_s: float) -> None:
    stands: Motion = ((1.0, 2.0, 3.0), (speed_m_s, speed_m_s, 0.0), (-200.0, 0.0, 0.0))
    for own_enu_m in (FAR_BEHIND, FAR_AHEAD, (1.0, 2.0, 3.0)):
        for waits in (PEER, replace(PEER, kept_s=0.5, coasts=False)):
            for age_s in (0.3, 0.5, 0.9, 5.0):
                found = nearest(own_enu_m, stands, age_s, waits)
                assert all(isfinite(value) and abs(value) < 1e4 for vector in found for value in vector)


def test_a_vehicle_behind_a_split_stops_as_soon_as_it_knows() -> None:
    """At 4 m/s it flies on for half a second, then brakes with 2 m/s^2: it does not coast."""
    waits = replace(PEER, kept_s=0.5, coasts=False)
    (on_m, _, _), speed, _ = nearest(FAR_AHEAD, EAST, 0.45, waits)
    assert (on_m, speed[0]) == (pytest.approx(1.8), pytest.approx(4.0, abs=0.4))
    assert nearest(FAR_AHEAD, EAST, 9.0, waits) == (pytest.approx((6.0, 0.0, 5.0)), ZERO3, ZERO3)
    assert nearest(FAR_BEHIND, EAST, 9.0, waits)[0] == pytest.approx((4.0, 0.0, 5.0))


def test_a_vehicle_behind_a_split_turns_on_until_it_knows_and_brakes_straight_on_from_there() -> None:
    """For 0.3 s by its acceleration, and by the lag of 0.2 s: in a turn at 4 m/s it braked 1.6 m beside that."""
    turning: Motion = ((1.0, 2.0, 3.0), (4.0, 0.0, 0.1), (-0.5, 3.0, 0.2))
    waits = replace(PEER, brakes_s=0.3, kept_s=0.5, coasts=False)
    knows_enu_m = (1.0 + 0.3 * 4.0 - 0.045 * 0.5, 2.0 + 0.045 * 3.0, 3.0 + 0.3 * 0.1 + 0.045 * 0.2)
    flies_enu_m_s = (4.0 - 0.3 * 0.5, 0.3 * 3.0, 0.1 + 0.3 * 0.2)
    x, y, z = [place + 0.2 * flies for place, flies in zip(knows_enu_m, flies_enu_m_s, strict=True)]
    vx, vy, vz = flies_enu_m_s[0] - 0.2 * 0.5, flies_enu_m_s[1] + 0.2 * 3.0, flies_enu_m_s[2] + 0.2 * 0.2
    for own_enu_m, late_s in ((FAR_BEHIND, 0.0), (FAR_AHEAD, 0.2)):
        gone_s = late_s + 0.5 * hypot(vx, vy, vz) / BRAKING_M_S2
        place = nearest_on_way(Ahead(own_enu_m, OWN_M_S), turning, 9.0, 0.2, waits, 1.0)[0]
        assert place == pytest.approx((x + gone_s * vx, y + gone_s * vy, z + gone_s * vz))
    brakes_m_s = nearest_on_way(Ahead(FAR_BEHIND, OWN_M_S), turning, 1.3, 0.2, waits, 1.0)[1]
    assert hypot(*brakes_m_s) == pytest.approx(hypot(vx, vy, vz) - 1.0 * BRAKING_M_S2)


def test_of_a_vehicle_behind_a_split_no_landing_is_expected() -> None:
    last, vehicle = peer(1), VehicleState(position_enu_m=(20.0, 0.0, 5.0), position_time_s=NOW_S)
    known = {1: PeerState(last.packet, NOW_S - 2.0, NOW_S - 2.0, NOW_S - 2.0)}
    (alone,) = Motions(2, PEER).peers(NOW_S, vehicle, True, known, {})
    (split,) = Motions(2, PEER).peers(NOW_S, vehicle, True, known, {}, frozenset({1}))
    assert alone.silence is not None and alone.silence.lands and alone.silence.coasts
    assert split.silence is not None and not split.silence.lands and not split.silence.coasts
    assert split.silence.kept_s == pytest.approx(PEER.begins_s + 0.2)


def test_a_vehicle_at_rest_stays_where_it_is() -> None:
    resting: Motion = ((0.0, 0.0, 5.0), ZERO3, ZERO3)
    assert nearest((4.0, 2.0, 7.0), resting, 500.0) == resting


def test_no_vehicle_coasts_faster_than_this_fleet_flies() -> None:
    """One packet may report any velocity: at 15 m/s a vehicle flies 15 m with its attitude kept, then 60 m."""
    (x, _, _), _, _ = nearest(FAR_AHEAD, ((0.0, 0.0, 5.0), (25.0, 0.0, 0.0), ZERO3), 600.0)
    assert x == pytest.approx(15.0 + 60.0, abs=0.1)


def test_an_attitude_that_is_kept_makes_no_vehicle_faster_either() -> None:
    """14 m/s and 5 m/s^2 are 19 m/s after a second: from there on 15 m/s count."""
    _, (speed_m_s, _, _), _ = nearest(FAR_AHEAD, ((0.0, 0.0, 5.0), (14.0, 0.0, 0.0), (5.0, 0.0, 0.0)), KEPT_S + 0.001)
    assert speed_m_s == pytest.approx(15.0, abs=0.1)


def test_a_vehicle_that_is_silent_for_ten_minutes_is_forgotten() -> None:
    vehicle, motions = VehicleState(position_enu_m=(20.0, 0.0, 5.0), position_time_s=NOW_S), Motions(2, PEER)
    last = peer(1)
    for age_s, near in ((FORGOTTEN_S - 1.0, [1]), (FORGOTTEN_S + 1.0, [])):
        known = {1: PeerState(last.packet, NOW_S - age_s, NOW_S - age_s, NOW_S - age_s)}
        assert [other.key for other in motions.peers(NOW_S, vehicle, True, known, {})] == near


def test_a_vehicle_that_contradicts_itself_may_be_where_a_silent_one_is() -> None:
    honest, motions = peer(1), Motions(2, PEER)
    x, y, z = honest.packet.motion.position_enu_m
    vehicle = VehicleState(position_enu_m=(x + 2.0, y, z), position_time_s=NOW_S)
    (other,) = motions.peers(NOW_S, vehicle, True, {1: honest}, {1: honest})
    assert other.silence is None
    (other,) = motions.peers(NOW_S, vehicle, True, {1: replace(honest, contradicts=True)}, {})
    assert other.silence is not None
    assert other.silence.begins_s < 0.0
    assert not other.silence.lands


METRES = st.floats(-50.0, 50.0)
SPEEDS = st.floats(-8.0, 8.0)
MOTIONS = st.tuples(
    st.tuples(METRES, METRES, METRES), st.tuples(SPEEDS, SPEEDS, SPEEDS), st.tuples(SPEEDS, SPEEDS, SPEEDS)
)


@given(st.tuples(METRES, METRES, METRES), MOTIONS)
def test_the_way_grows_from_where_a_fresh_vehicle_is_expected(own: Vector3, last: Motion) -> None:
    (x, y, z), (vx, vy, vz), (ax, ay, az) = last
    position, velocity, acceleration = nearest(own, last, PEER.begins_s)
    t = PEER.begins_s
    assert position == pytest.approx((x + t * vx, y + t * vy, z + t * vz))
    assert velocity == pytest.approx((vx + t * ax, vy + t * ay, vz + t * az))
    assert acceleration == last[2]


@pytest.mark.parametrize("age_s", [0.35, 0.5, 0.65, 0.8, 1.2, 3.0])
@pytest.mark.parametrize("own", [FAR_BEHIND, FAR_AHEAD])
@pytest.mark.parametrize("coasts", [True, False])
@pytest.mark.parametrize("accel_enu_m_s2", [ZERO3, (1.0, 3.0, 0.0)])
def test_the_ends_of_the_way_move_at_their_velocity(
    own: Vector3, age_s: float, accel_enu_m_s2: Vector3, coasts: bool
) -> None:
    last, silence = (*EAST[:2], accel_enu_m_s2), PEER if coasts else replace(PEER, kept_s=0.5, coasts=False)
    before, at, after = [nearest(own, last, age_s + step_s, silence) for step_s in (-0.001, 0.0, 0.001)]
    moved_m_s = [(b - a) / 0.002 for a, b in zip(before[0], after[0], strict=True)]
    assert at[1] == pytest.approx(moved_m_s, abs=0.01)


@given(st.tuples(METRES, METRES, METRES), st.floats(0.3, 20.0), st.floats(0.0, 1.0))
def test_no_place_on_the_way_is_nearer(own: Vector3, age_s: float, share: float) -> None:
    begins, ends = nearest(FAR_BEHIND, EAST, age_s)[0], nearest(FAR_AHEAD, EAST, age_s)[0]
    place = [a + share * (b - a) for a, b in zip(begins, ends, strict=True)]
    assert dist(own, nearest(own, EAST, age_s)[0]) <= dist(own, place) + 1e-9


def test_a_vehicle_below_makes_way_as_a_landing_may_arrive() -> None:
    assert column_m(1.5, 4.0, 0.1, 0.5)[0] < 0.0
    at_once, grows_m_s = column_m(1.5, 1.0, 0.1, 0.5)
    assert (at_once, grows_m_s) == (pytest.approx(0.1), 1.0)
    assert column_m(1.5, 4.0, 9.0, 0.5) == (1.5, 0.0)
