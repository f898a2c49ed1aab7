"""Where others are and may be, to the number: the way of a silent vehicle, stepped in time, and who is near."""

from __future__ import annotations

from math import exp, hypot, inf, sqrt

import pytest
from msgspec.structs import replace

from common import slot_peer, with_fields
from companion.core.consensus.peers import PeerState
from companion.core.filter.motion import (
    Ahead,
    Motion,
    Motions,
    Other,
    Silence,
    Traffic,
    column_m,
    nearest_on_way,
    traffic_nearby,
)
from companion.core.filter.solver import Rank
from companion.types.autopilot import PositionError, VehicleState
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot
from companion.types.peers import ReceivedTraffic, TrafficSample
from companion.types.values import ZERO3, Vector3

P = FlightPhase
NO_ERROR = PositionError(0.0, 0.0)
LAST: Motion = ((10.0, -4.0, 20.0), (3.0, -2.0, 1.5), (0.8, 0.5, -0.7))
SILENCE = Silence(begins_s=0.3, brakes_s=0.5, kept_s=1.0, braking_m_s2=2.5, most_m_s=6.0)
STEP_S = 1e-3


def stepped(last: Motion, for_s: float, accel: object) -> tuple[Vector3, Vector3]:
    """(position, velocity) after this time under accel(t, velocity), by small steps."""
    (x, y, z), (vx, vy, vz), _ = last
    for step in range(round(for_s / STEP_S)):
        ax, ay, az = accel((step + 0.5) * STEP_S, (vx, vy, vz))  # type: ignore[operator]
        x, y, z = x + STEP_S * vx, y + STEP_S * vy, z + STEP_S * vz
        vx, vy, vz = vx + STEP_S * ax, vy + STEP_S * ay, vz + STEP_S * az
    return (x, y, z), (vx, vy, vz)


def brakes(seconds: float, velocity: Vector3) -> Vector3:
    """Straight on for half a second, then to a stop."""
    speed = hypot(*velocity)
    if seconds < 0.5 or speed < 0.005:
        return ZERO3
    x, y, z = velocity
    return (-2.5 * x / speed, -2.5 * y / speed, -2.5 * z / speed)


def end_of_way(towards: float, age_s: float, ahead_s: float, last: Motion = LAST) -> Motion:
    """The end that a vehicle far away meets: -1 the one where the other brakes, 1 where it coasts."""
    (x, y, z), (vx, vy, vz), _ = last
    far = Ahead((x + towards * 1e4 * vx, y + towards * 1e4 * vy, z + towards * 1e4 * vz), ZERO3)
    return nearest_on_way(far, last, age_s, ahead_s, SILENCE, 1.0)


@pytest.mark.parametrize(("age_s", "ahead_s"), [(0.8, 0.2), (1.2, 0.3), (1.9, 0.0), (2.6, 0.2)])
def test_one_end_of_the_way_is_that_of_braking(age_s: float, ahead_s: float) -> None:
    position, velocity, acceleration = end_of_way(-1.0, age_s, ahead_s)
    expected, moving = stepped(LAST, age_s + ahead_s, brakes)
    assert position == pytest.approx(expected, abs=0.01)
    assert velocity == pytest.approx(moving, abs=0.01)
    assert acceleration == pytest.approx(brakes(age_s + ahead_s, moving), abs=0.01)


@pytest.mark.parametrize(("age_s", "ahead_s"), [(0.75, 0.15), (1.2, 0.3), (6.0, 0.2)])
def test_the_other_end_keeps_its_attitude_for_a_second_and_is_slowed_by_drag_then(age_s: float, ahead_s: float) -> None:
    """The height is held then; a kept attitude changes only the horizontal velocity."""

    def coasts(seconds: float, velocity: Vector3) -> Vector3:
        return (0.8, 0.5, 0.0) if seconds < 1.0 else (-0.25 * velocity[0], -0.25 * velocity[1], 0.0)

    at_s = age_s + ahead_s
    position, velocity, acceleration = end_of_way(1.0, age_s, ahead_s)
    (x, y, _), (vx, vy, _) = stepped(LAST, at_s, coasts)
    assert position == pytest.approx((x, y, 20.0 + 1.5 * min(at_s, 1.0)), abs=0.01)
    assert velocity == pytest.approx((vx, vy, 1.5 if at_s <= 1.0 else 0.0), abs=0.01)
    assert acceleration == pytest.approx(coasts(at_s, (vx, vy, 0.0)), abs=0.01)


def test_no_silent_vehicle_is_believed_to_be_faster_than_it_flies() -> None:
    """Neither by its packet nor by the attitude that it keeps."""
    fast: Motion = (ZERO3, (30.0, -40.0, 0.0), ZERO3)
    braked = end_of_way(-1.0, 9.0, 0.0, fast)
    way_m = 6.0 * 0.5 + 6.0**2 / 5.0
    assert braked[0] == pytest.approx((0.6 * way_m, -0.8 * way_m, 0.0))
    faster: Motion = (ZERO3, (3.0, 4.0, 0.0), (1.2, 1.6, 0.0))
    coasted = end_of_way(1.0, 3.0, 0.0, faster)
    left = 6.0 * exp(-0.25 * 2.0)
    assert coasted[1] == pytest.approx((0.6 * left, 0.8 * left, 0.0))


@pytest.mark.parametrize("part", [0.25, 0.5, 0.9])
@pytest.mark.parametrize("towards", [-1.0, 1.0])
def test_the_way_grows_smoothly_within_four_tenths_of_a_second(towards: float, part: float) -> None:
    last: Motion = (LAST[0], LAST[1], ZERO3)
    age_s = 0.3 + 0.4 * part
    grown = nearest_on_way(Ahead((1e4 * towards, -1e4 * towards, 0.0), ZERO3), last, age_s, 1.0, SILENCE, 1.0)
    whole = nearest_on_way(
        Ahead((1e4 * towards, -1e4 * towards, 0.0), ZERO3), last, age_s, 1.0, replace(SILENCE, begins_s=-inf), 1.0
    )
    expected = tuple(x + v * (age_s + 1.0) for x, v in zip(*last[:2], strict=True))
    share = part * part * (3.0 - 2.0 * part)
    rate_1_s = 6.0 * part * (1.0 - part) / 0.4
    for axis in range(3):
        off_m = whole[0][axis] - expected[axis]
        assert grown[0][axis] == pytest.approx(expected[axis] + share * off_m)
        moving = last[1][axis] + share * (whole[1][axis] - last[1][axis]) + rate_1_s * off_m
        assert grown[1][axis] == pytest.approx(moving)
        assert grown[2][axis] == pytest.approx(share * whole[2][axis])


@pytest.mark.parametrize("age_s", [0.7, 3.0])
@pytest.mark.parametrize("weight", [1.0, 0.5])
def test_between_its_ends_the_point_follows_the_own_motion_along_the_way(weight: float, age_s: float) -> None:
    """In the metric of the separation: heights have a weight."""
    braked, coasted = end_of_way(-1.0, age_s, 0.2), end_of_way(1.0, age_s, 0.2)
    along = [b - a for a, b in zip(braked[0], coasted[0], strict=True)]
    for share in (0.25, 0.6):
        on_way = [a + share * d for a, d in zip(braked[0], along, strict=True)]
        aside = (-along[1], along[0], 0.0)
        own = Ahead(tuple(p + a for p, a in zip(on_way, aside, strict=True)), (0.7, 0.4, -0.9))
        position, velocity, acceleration = nearest_on_way(own, LAST, age_s, 0.2, SILENCE, weight)
        if weight == 1.0 or along[2] == 0.0:
            assert position == pytest.approx(on_way)
        weighted = (along[0], along[1], along[2] * weight * weight)
        for vector, target in ((velocity, own.velocity_enu_m_s), (position, own.position_enu_m)):
            assert sum(w * (a - b) for w, a, b in zip(weighted, vector, target, strict=True)) == pytest.approx(
                0.0, abs=1e-9
            )
        left = [(p - a) / d for p, a, d in zip(position, braked[0], along, strict=True) if abs(d) > 1e-6]
        assert max(left) == pytest.approx(min(left))
        at = left[0]
        expected = [a + at * (b - a) for a, b in zip(braked[2], coasted[2], strict=True)]
        assert acceleration == pytest.approx(expected)


def test_beyond_its_ends_the_way_goes_not_on() -> None:
    braked, coasted = end_of_way(-1.0, 3.0, 0.2), end_of_way(1.0, 3.0, 0.2)
    for share, end in ((-0.3, braked), (1.3, coasted)):
        at = tuple(a + share * (b - a) for a, b in zip(braked[0], coasted[0], strict=True))
        assert nearest_on_way(Ahead(at, (9.0, 9.0, 9.0)), LAST, 3.0, 0.2, SILENCE, 1.0) == end


def test_below_a_vehicle_that_may_land_the_room_grows_by_a_metre_a_second_or_as_the_landing_comes() -> None:
    """It descends by 1.5 m/s, from 0.6 s after its last setpoint on; heights count half."""
    assert column_m(2.0, 10.0, 1.0, 0.5) == pytest.approx((2.0 - 0.5 * (10.0 - 1.5 * 1.4), 0.75))
    assert column_m(2.0, 4.0, 0.5, 0.5) == pytest.approx((0.5, 1.0))
    assert column_m(2.0, 4.0, 1.8, 0.5) == pytest.approx((2.0 - 0.5 * (4.0 - 1.5 * 2.2), 0.75))
    assert column_m(2.0, 2.1, 1.0, 0.5) == (1.0, 1.0)  # 2.1 m are descended in 1.4 s
    assert column_m(2.0, 2.1, 3.0, 0.5) == (2.0, 0.0)
    assert column_m(3.0, 0.0, 3.0, 0.5) == (3.0, 0.0)


# ---------------------------------------------------------------- where this vehicle will be

OWN = VehicleState(position_enu_m=(1.0, 2.0, 3.0), velocity_enu_m_s=(0.5, -1.0, 0.25), position_time_s=10.0)


def test_the_own_command_acts_by_the_lag_of_the_attitude() -> None:
    motions = Motions(2, SILENCE)
    at_first = motions.own(10.05, OWN, (1.0, 2.0, -3.0))
    assert at_first.position_enu_m == pytest.approx((1.125, 1.75, 3.0625))
    assert at_first.velocity_enu_m_s == pytest.approx((0.5, -1.0, 0.25))  # nothing has been flown yet
    later = motions.own(10.1, OWN, (1.0, 2.0, -3.0))
    share = 0.05 / 0.25
    assert later.position_enu_m == pytest.approx((1.15, 1.7, 3.075))
    assert later.velocity_enu_m_s == pytest.approx((0.5 + 0.3 * share, -1.0 + 0.6 * share, 0.25 - 0.9 * share))
    again = motions.own(10.1, OWN, (9.0, 9.0, 9.0))  # no time has passed
    assert again == later
    last = motions.own(10.3, OWN, ZERO3)
    assert last.velocity_enu_m_s == pytest.approx(
        (0.5 + 0.5 * share * 0.5, -1.0 + 0.5 * share, 0.25 - 1.5 * share * 0.5)
    )


# ---------------------------------------------------------------- which others count, and how


def heard(
    peer_id: int, position_enu_m: Vector3, phase: FlightPhase = P.FORMATION, measured_s: float = 10.0, **changes: object
) -> PeerState:
    packet = with_fields(
        slot_peer(1),
        **{"vehicle_id": peer_id, "position_enu_m": position_enu_m, "phase": phase, "armed": True} | changes,
    )
    return PeerState(packet, measured_s, 0.0, measured_s)


def near(
    *peers: PeerState, fresh: bool = True, cooperates: bool = True, motions: Motions | None = None, now_s: float = 10.0
) -> list[Other]:
    known = {peer.packet.sender.vehicle_id: peer for peer in peers}
    motions = motions or Motions(2, SILENCE)
    return motions.peers(now_s, OWN, cooperates, known, known if fresh else {})


def test_what_is_known_of_a_peer_in_formation() -> None:
    slot = FlownSlot((0.0, 5.0, 0.0))
    error = PositionError(0.2, 0.3)
    peer = heard(7, (2.0, 2.0, 3.0), acceleration_enu_m_s2=(1.0, 0.0, 0.0), position_error=error, measured_s=9.9)
    peer = replace(peer, packet=replace(peer.packet, slot=slot))
    (found,) = near(peer)
    motion: Motion = ((2.0, 2.0, 3.0), peer.packet.motion.velocity_enu_m_s, (1.0, 0.0, 0.0))
    assert found == Other(
        7, motion, (1.0, 0.0, 0.0), pytest.approx(0.1), None, error, 0.5, slot, makes_way=True, side=1.0
    )
    (other,) = near(heard(1, (2.0, 2.0, 3.0), armed=False))
    assert (other.side, other.height_weight, other.error) == (-1.0, 1.0, NO_ERROR)
    (alone,) = near(peer, cooperates=False)
    assert (alone.slot, alone.makes_way) == (None, True)
    (silent,) = near(peer, fresh=False)
    assert (silent.slot, silent.makes_way) == (None, False)
    (holds,) = near(heard(7, (2.0, 2.0, 3.0), P.HOLD))
    assert (holds.slot, holds.makes_way) == (None, False)


ABOVE = replace(
    OWN, position_enu_m=(3.0, 4.0, 2.5), velocity_enu_m_s=(2.0, -0.5, 0.5), ground_position_enu_m=(9.0, 9.0, 0.2)
)


def on_ground(
    error_m: float,
    place_enu_m: Vector3 = (0.0, 0.0, 0.1),
    age_s: float = 0.2,
    own: VehicleState = ABOVE,
    armed: bool = False,
    contradicts: bool = False,
    silence: Silence = SILENCE,
) -> Other:
    """A vehicle that has landed, as `own` takes it."""
    error = PositionError(error_m, 3.0)
    peer = heard(7, place_enu_m, P.OBSERVE, 10.0 - age_s, armed=armed, position_error=error)
    peer = replace(peer, contradicts=contradicts)
    (other,) = Motions(2, silence).peers(10.0, own, True, {7: peer}, {7: peer})
    return other


def test_a_vehicle_without_gps_may_lie_on_the_ground_straight_below() -> None:
    """Its error is 6 m, and it is 5 m away; the place follows the own vehicle, and is below it when taken ahead by its age."""
    below = on_ground(6.0)
    assert below.last[0] == pytest.approx((3.0 - 0.2 * 2.0, 4.0 + 0.2 * 0.5, 0.1))
    assert below.last[1:] == ((2.0, -0.5, 0.0), (0.0, 0.0, 0.0))
    assert (below.error, below.silence, below.age_s) == (NO_ERROR, None, pytest.approx(0.2))
    assert on_ground(8.0, (10.0, 2.0, 0.1)).last[1] == (2.0, -0.5, 0.0)
    assert on_ground(5.0).last[1] == (2.0, -0.5, 0.0)


def test_a_vehicle_on_the_ground_may_be_nearer_by_its_error() -> None:
    nearer = on_ground(2.0)
    assert nearer.last == (pytest.approx((1.2, 1.6, 0.1)), ZERO3, ZERO3)
    assert nearer.error == NO_ERROR
    assert on_ground(0.0).last[0] == (0.0, 0.0, 0.1)
    far = replace(ABOVE, position_enu_m=(30.0, 40.0, 2.5), velocity_enu_m_s=(9.0, 9.0, 0.0))
    assert on_ground(1e3, own=far).last[0] == pytest.approx((18.0, 24.0, 0.1)), (
        "no packet claims more than 30 m of ground"
    )


def test_a_vehicle_that_may_lie_anywhere_within_metres_comes_after_obstacles_and_fence() -> None:
    assert [on_ground(error_m).rank for error_m in (0.0, 1.0, 1.01, 6.0)] == [
        Rank.VEHICLE,
        Rank.VEHICLE,
        Rank.MARGIN,
        Rank.MARGIN,
    ]
    assert on_ground(2.0, age_s=0.31).rank is Rank.MARGIN
    assert {on_ground(6.0, armed=True).rank, on_ground(6.0, (0.0, 0.0, 1.2)).rank} == {Rank.VEHICLE}


def test_the_place_of_a_silent_vehicle_on_the_ground_does_not_coast() -> None:
    for silent in (on_ground(6.0, age_s=0.31), on_ground(6.0, contradicts=True)):
        assert silent.last == ((3.0, 4.0, 0.1), ZERO3, ZERO3)
        assert silent.silence is not None
    begins = replace(SILENCE, begins_s=0.25)
    assert on_ground(6.0, age_s=0.25, silence=begins).last[1] == (2.0, -0.5, 0.0)


def test_what_does_not_lie_on_the_ground_keeps_its_error() -> None:
    """Armed, more than 1 m above the own place of take-off, or where this is not known: the error counts in all directions."""
    unknown = replace(ABOVE, ground_position_enu_m=None)
    for other in (on_ground(6.0, armed=True), on_ground(6.0, (0.0, 0.0, 1.2)), on_ground(6.0, own=unknown)):
        assert other.last[0][:2] == (0.0, 0.0)
        assert other.error == PositionError(6.0, 3.0)
    assert on_ground(6.0, (0.0, 0.0, 1.19)).error == NO_ERROR


@pytest.mark.parametrize(
    ("phase", "armed", "age_s", "contradicts", "expected"),
    [
        (P.FORMATION, True, 0.3, False, None),
        (P.ENGAGE, True, 0.1, False, None),
        (P.READY, False, 0.1, False, None),
        (P.FORMATION, True, 0.31, False, SILENCE),
        (P.HOLD, True, 0.31, True, SILENCE),
        (P.READY, False, 0.31, False, replace(SILENCE, lands=False)),
        (P.FORMATION, True, 0.1, True, replace(SILENCE, begins_s=-inf, lands=False)),
        (P.HOLD, True, 0.1, False, Silence(-inf, 0.0, 1.0, 5.0, 6.0, lands=False)),
        (P.LAND, True, 0.1, False, Silence(-inf, 0.0, 1.0, 5.0, 6.0, lands=False)),
        (P.OBSERVE, True, 0.1, False, Silence(-inf, 0.0, 1.0, 5.0, 6.0, lands=False, leaps_m=0.2)),
    ],
)
def test_how_a_vehicle_may_fly_that_its_last_packet_does_not_tell(
    phase: FlightPhase, armed: bool, age_s: float, contradicts: bool, expected: Silence | None
) -> None:
    """A silent one, one that contradicts itself, and one that flies on its own: by its autopilot, or by a pilot's leap."""
    peer = heard(7, (2.0, 2.0, 3.0), phase, 0.0, armed=armed)
    (found,) = near(replace(peer, contradicts=contradicts), now_s=age_s)
    assert found.silence == expected


def test_the_command_of_a_fresh_peer_acts_by_the_lag_and_a_pilots_at_once() -> None:
    for phase, fresh, lags in ((P.FORMATION, True, True), (P.FORMATION, False, False), (P.OBSERVE, True, False)):
        motions = Motions(2, SILENCE)
        near(heard(7, (2.0, 2.0, 3.0), phase, acceleration_enu_m_s2=(1.0, -1.5, 2.0)), motions=motions, now_s=10.0)
        turned = heard(7, (2.0, 2.0, 3.0), phase, acceleration_enu_m_s2=(3.0, 0.0, -2.0))
        (found,) = near(turned, motions=motions, now_s=10.05, fresh=fresh)
        share = 0.05 / 0.25 if lags else 1.0
        assert found.last[2] == pytest.approx((1.0 + 2.0 * share, -1.5 + 1.5 * share, 2.0 - 4.0 * share))
        near(motions=motions, now_s=10.1)  # it is far away for a tick
        (found,) = near(turned, motions=motions, now_s=10.12)
        assert found.last[2] == (3.0, 0.0, -2.0)


def test_a_peer_counts_within_eight_metres_on_each_axis_and_as_far_as_both_fly_in_three_seconds() -> None:
    """The own speeds add up to 1.75 m/s: 13.25 m. One that flies by 1 m/s on each axis comes from 9 m farther."""
    for axis in range(3):
        for sign in (1.0, -1.0):
            for apart_m, moves, counts in (
                (13.24, 0.0, True),
                (13.26, 0.0, False),
                (22.24, 1.0, True),
                (22.26, 1.0, False),
            ):
                at = list(OWN.position_enu_m)
                at[axis] += sign * apart_m
                peer = heard(
                    7, tuple(at), velocity_enu_m_s=(moves, -moves, moves), acceleration_enu_m_s2=(5.0, 5.0, 5.0)
                )
                assert bool(near(peer)) is counts
    aged = heard(7, (1.0 + 22.8, 2.0, 3.0), measured_s=9.8, velocity_enu_m_s=(1.0, 1.0, 1.0))
    assert near(aged)  # 0.2 s of 3 m/s more
    assert not near(heard(7, (1.0 + 22.8, 2.0, 3.0), velocity_enu_m_s=(1.0, 1.0, 1.0)))


def test_one_that_is_far_away_or_forgotten_hides_no_other() -> None:
    far, forgotten = heard(3, (400.0, 2.0, 3.0)), heard(4, (2.0, 2.0, 3.0), measured_s=-9999.0)
    assert [other.key for other in near(far, forgotten, heard(7, (2.0, 2.0, 3.0)))] == [7]
    for axis in range(3):
        own, at = [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]
        own[axis], at[axis] = 20.0, -20.0
        opposite = heard(7, tuple(at), velocity_enu_m_s=ZERO3)
        vehicle = replace(OWN, position_enu_m=tuple(own))
        assert Motions(2, SILENCE).peers(10.0, vehicle, True, {7: opposite}, {7: opposite}) == []


def test_one_that_is_not_fresh_may_have_kept_its_attitude_for_a_second_and_land() -> None:
    """To its speeds of 1 m/s each come 0.5 and 0.25 m/s, and 1.5 m/s downwards: 5.25 m/s for 4 s."""
    for apart_m, counts in ((8.0 + 5.25 + 20.99, True), (8.0 + 5.25 + 21.01, False)):
        peer = heard(
            7,
            (1.0, 2.0 - apart_m, 3.0),
            measured_s=9.0,
            velocity_enu_m_s=(1.0, -1.0, -1.0),
            acceleration_enu_m_s2=(-0.5, 0.25, 9.0),
        )
        assert bool(near(peer, fresh=False)) is counts


# ---------------------------------------------------------------- traffic


def traffic(position_enu_m: Vector3, age_s: float = 0.0, **changes: object) -> ReceivedTraffic:
    sample = TrafficSample(position_enu_m, (2.0, -1.0, 0.5), age_s=age_s, error_m=0.7)
    return ReceivedTraffic(9.5, "crane", replace(sample, **changes))


def test_what_is_known_of_traffic() -> None:
    (found,) = traffic_nearby(10.0, OWN, {"crane": traffic((4.0, 2.0, 3.0), 0.25)})
    motion: Motion = ((4.0, 2.0, 3.0), (2.0, -1.0, 0.5), ZERO3)
    error = PositionError(0.7, 0.7)
    assert found == Other("crane", motion, ZERO3, 0.75, None, error, 0.5, None, makes_way=False, side=1.0)
    (unknown,) = traffic_nearby(10.0, OWN, {"crane": traffic((4.0, 2.0, 900.0), height="unknown")})
    assert unknown.last == ((4.0, 2.0, 3.0), (2.0, -1.0, 0.0), ZERO3)
    assert unknown.height_weight == 0.0
    assert traffic_nearby(10.0, OWN, {"crane": traffic((4.0, 2.0, 900.0))}) == []


def test_an_aircraft_holds_its_course_for_five_seconds() -> None:
    silence = Silence(5.0, 5.0, 5.0, 5.0, lands=False)
    for age_s, expected in ((4.5, None), (4.51, silence)):
        (found,) = traffic_nearby(10.0, OWN, {"crane": traffic((4.0, 2.0, 3.0), age_s)})
        assert found.silence == expected


def test_no_more_than_sixteen_are_kept_and_none_for_more_than_half_a_minute() -> None:
    """Those at an unknown height count by their horizontal distance."""
    kept, own = Traffic(), (5.0, 5.0, 5.0)
    far = [ReceivedTraffic(1.0, f"a{k}", traffic((5.0 + k, 5.0, 5.0)).sample) for k in range(1, 17)]
    low = ReceivedTraffic(1.0, "low", traffic((5.0, 15.5, 900.0), height="unknown").sample)
    high = ReceivedTraffic(1.0, "high", traffic((5.0, 15.5, 900.0)).sample)
    kept.step(1.0, own, [*far, low, high])
    assert set(kept.newest) == {*(f"a{k}" for k in range(1, 16)), "low"}
    for now_s, count in ((31.0, 16), (31.1, 0)):
        kept.step(now_s, own, [])
        assert len(kept.newest) == count


def test_the_newest_sample_counts_by_when_it_was_measured() -> None:
    kept = Traffic()
    first, same, newer = (
        ReceivedTraffic(at_s, "a", traffic((east, 0.0, 0.0), age_s).sample)
        for at_s, age_s, east in ((5.0, 1.0, 1.0), (6.0, 2.0, 2.0), (5.5, 1.25, 3.0))
    )
    kept.step(6.0, ZERO3, [first, same])
    assert kept.newest["a"] is first
    kept.step(6.0, ZERO3, [newer, first])
    assert kept.newest["a"] is newer


def test_the_braking_way_of_a_vehicle_that_is_stopped_is_all_of_it() -> None:
    position, velocity, acceleration = end_of_way(-1.0, 30.0, 0.0)
    speed = sqrt(3.0**2 + 2.0**2 + 1.5**2)
    gone_s = 0.5 + 0.5 * speed / 2.5
    assert position == pytest.approx(tuple(x + gone_s * v for x, v in zip(*LAST[:2], strict=True)))
    assert (velocity, acceleration) == (ZERO3, ZERO3)
