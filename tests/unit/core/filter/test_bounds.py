"""The constraints of walls, obstacles, ground and speed to the number, and what the stage makes of all constraints."""

from __future__ import annotations

from math import dist, hypot, radians, tan

import pytest
from msgspec.structs import replace

from common import slot_peer, with_fields
from companion.assembly import safety_filter_of, separation_settings_of
from companion.core.consensus.peers import PeerState
from companion.core.filter.filter import Bounds, Interventions, SafetyFilter, SpeedLimit, better_kept
from companion.core.filter.motion import NO_ERROR, Ahead, Motions, Other, Silence
from companion.core.filter.solver import AccelerationLimits, Constraint, Rank, filter_acceleration
from companion.core.filter.vehicles import (
    KEPT_M,
    Barrier,
    Separation,
    SeparationSettings,
    eased,
    largest_removed_m_s2,
    turn_right,
)
from companion.geometry.airspace import Airspace, Cuboid, Cylinder, Fence
from companion.geometry.curves import approach_speed
from companion.types.autopilot import PositionError, VehicleState
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot, Gains
from companion.types.notices import Code
from companion.types.peers import ReceivedTraffic, TrafficSample
from companion.types.status import NearestVehicle, SeparationReport
from companion.types.values import GRAVITY_M_S2, ZERO3, Vector3
from one_agent import FLEET

LEVEL_M_S2, VERTICAL_M_S2 = 2.5, 2.0
SPEED = SpeedLimit(12.0, 3.0, 2.0)
FENCE = Fence((-20.0, -30.0, 0.0), (25.0, 35.0, 40.0))
HOUSE, POLE = Cuboid((5.0, 5.0, 0.0), (8.0, 9.0, 10.0)), Cylinder((-6.0, -6.0), 1.0, 0.0, 15.0)
CLEARANCE_M = 0.5
AIRSPACE = Airspace(FENCE, (HOUSE, POLE), CLEARANCE_M)
BOUNDS = Bounds(AIRSPACE, SPEED, LEVEL_M_S2, VERTICAL_M_S2, 2.0)


def room_m(rank: Rank, normal: Vector3, at: Vector3) -> float:
    """To the wall or obstacle with this normal, and 0.5 m above a ground at 1 m."""
    if rank is Rank.GROUND:
        return at[2] - 1.5
    if rank is Rank.OBSTACLE:
        return next(distance_m for distance_m, n in (HOUSE.gap(at), POLE.gap(at)) if n == normal) - CLEARANCE_M
    walls = {(1.0, 0.0, 0.0): at[0] + 20.0, (-1.0, 0.0, 0.0): 25.0 - at[0], (0.0, 1.0, 0.0): at[1] + 30.0}
    walls |= {(0.0, -1.0, 0.0): 35.0 - at[1], (0.0, 0.0, 1.0): at[2], (0.0, 0.0, -1.0): 40.0 - at[2]}
    return walls[normal] - CLEARANCE_M


@pytest.mark.parametrize(
    ("ahead", "names"),
    [
        (Ahead((-18.0, -28.0, 3.0), (-0.8, 0.4, -0.3)), {"wall", "ground"}),
        (Ahead((24.0, 34.0, 38.5), (0.6, 0.7, 0.9)), {"wall"}),
        (Ahead((3.5, 3.0, 11.0), (0.5, 0.6, -0.4)), {"obstacle"}),  # obliquely before an upper corner of the house
        (Ahead((-4.2, -6.0, 9.0), (-0.7, 0.2, 0.1)), {"obstacle"}),
        (Ahead((25.3, 0.0, 20.0), (0.3, 0.0, 0.0)), {"wall"}),  # outside
    ],
)
@pytest.mark.parametrize(("level_m_s2", "vertical_m_s2"), [(2.5, 2.0), (1.5, 2.0)])
def test_on_a_constraint_the_room_shrinks_by_its_response(
    level_m_s2: float, vertical_m_s2: float, ahead: Ahead, names: set[str]
) -> None:
    """b = h' + V(h) falls by b' = -4 b, of a vehicle that flies on the plane."""
    bounds = Bounds(AIRSPACE, SPEED, level_m_s2, vertical_m_s2, 2.0)
    step_s, found, (vx, vy, vz) = 1e-5, set(), ahead.velocity_enu_m_s
    for nx, ny, nz, least, rank in bounds.constraints(ahead, (0.0, 0.0, 1.0)):
        level, up = nz == 0.0, abs(nz) == 1.0
        braking_m_s2 = level_m_s2 if level else vertical_m_s2 if up else min(level_m_s2, vertical_m_s2)
        left_m, rate_m_s = room_m(rank, (nx, ny, nz), ahead.position_enu_m), nx * vx + ny * vy + nz * vz
        before = rate_m_s + approach_speed(left_m, braking_m_s2, 2.0, 1.0)[0]
        after = rate_m_s + least * step_s + approach_speed(left_m + rate_m_s * step_s, braking_m_s2, 2.0, 1.0)[0]
        assert (after - before) / step_s == pytest.approx(-4.0 * before, abs=2e-3)
        found.add({Rank.FENCE: "wall", Rank.GROUND: "ground", Rank.OBSTACLE: "obstacle"}[rank])
    assert names <= found


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("speed_m_s", [0.0, 5.0, 12.0])
def test_what_is_left_out_could_change_nothing(axis: int, speed_m_s: float) -> None:
    """All of it allows at least 20 m/s^2 towards it; a wall at any distance is asked about or far enough."""
    far = Bounds(Airspace(Fence((-99.0, -99.0, -99.0), (99.0, 99.0, 99.0)), (), CLEARANCE_M), SPEED, 2.5, 2.0, 2.0)
    asked_once = False
    for left_m in range(1, 90, 4):
        place, velocity, normal = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        place[axis], velocity[axis], normal[axis] = 99.0 - left_m, speed_m_s, -1.0
        found = [c for c in far.constraints(Ahead(tuple(place), tuple(velocity)), None) if c[:3] == tuple(normal)]
        allowed_m_s, slope_1_s = approach_speed(left_m - CLEARANCE_M, 2.0 if axis == 2 else 2.5, 2.0, 1.0)
        assert found or -4.0 * (allowed_m_s - speed_m_s) + slope_1_s * speed_m_s <= -20.0
        asked_once = asked_once or bool(found)
    assert asked_once


def test_the_floor_is_half_a_metre_above_the_ground_or_half_of_a_low_take_off() -> None:
    for takeoff_m, floor_m in ((9.0, 0.5), (1.0, 0.5), (0.6, 0.3)):
        bounds = Bounds(Airspace(FENCE, (), CLEARANCE_M), SPEED, LEVEL_M_S2, VERTICAL_M_S2, takeoff_m)
        ahead = Ahead((0.0, 0.0, 5.0 + floor_m + 0.4), ZERO3)
        ((*normal, least, _),) = [c for c in bounds.constraints(ahead, (9.0, 9.0, 5.0)) if c[4] is Rank.GROUND]
        assert (normal, least) == ([0.0, 0.0, 1.0], pytest.approx(-4.0 * 2.0 * 0.4))
        assert not [c for c in bounds.constraints(ahead, None) if c[4] is Rank.GROUND]


@pytest.mark.parametrize(
    ("velocity", "constraints"),
    [
        ((0.0, 0.0, 0.5), [(0.0, 0.0, -1.0, -5.0, Rank.SPEED)]),
        ((0.0, 0.0, 0.0), [(0.0, 0.0, 1.0, -4.0, Rank.SPEED)]),
        ((0.06, -0.08, -0.5), [(0.0, 0.0, 1.0, -3.0, Rank.SPEED)]),
        ((0.06, -0.08001, -0.5), [(0.0, 0.0, 1.0, -3.0, Rank.SPEED), (-0.6, 0.8, 0.0, -23.8, Rank.SPEED)]),
        ((3.0, -4.0, -2.5), [(0.0, 0.0, 1.0, 1.0, Rank.SPEED), (-0.6, 0.8, 0.0, -14.0, Rank.SPEED)]),
    ],
)
def test_the_speed_may_grow_by_twice_what_is_left_of_it(velocity: Vector3, constraints: list[Constraint]) -> None:
    wanted = (0.5, 0.5, 2.0)
    slowed, found = BOUNDS.limit_speed(Ahead(ZERO3, velocity), wanted)
    assert found == [pytest.approx(constraint, abs=1e-3) for constraint in constraints]
    assert slowed is wanted


def test_what_exceeds_a_speed_limit_is_taken_off_along_its_direction() -> None:
    ahead = Ahead(ZERO3, (7.2, -9.6, 2.0))
    slowed, _ = BOUNDS.limit_speed(ahead, (3.0, 2.0, 3.0))
    assert slowed == pytest.approx((3.0 - 0.6 * 0.2, 2.0 + 0.8 * 0.2, 2.0))
    ahead = Ahead(ZERO3, (9.0, -12.0, -3.0))  # too fast: brakes by 6 m/s^2 and 2 m/s^2
    x, y, z = BOUNDS.limit_speed(ahead, (1.0, 2.0, -1.0))[0]
    assert z == pytest.approx(2.0)
    assert -0.6 * x + 0.8 * y == pytest.approx(6.0)
    assert 0.8 * x + 0.6 * y == pytest.approx(0.8 + 1.2)


# ---------------------------------------------------------------- the turn to the right


def test_a_turn_is_flown_unless_it_misses_a_rank_by_far_more() -> None:
    """By one metre per second squared; what a higher rank gains counts before."""
    vehicle: Constraint = (1.0, 0.0, 0.0, 2.0, Rank.VEHICLE)
    fence: Constraint = (0.0, 1.0, 0.0, 2.0, Rank.FENCE)
    allowed = (1.0, 1.0, 0.0)
    for turned, is_flown in (
        ((0.01, 1.0, 0.0), True),
        ((-0.01, 1.0, 0.0), False),
        ((1.0, -0.01, 0.0), False),
        ((1.0, 0.01, 0.0), True),
        ((2.5, -9.0, 0.0), False),
        ((-0.01, 9.0, 0.0), False),
    ):
        assert better_kept(turned, allowed, [fence, vehicle]) is (turned if is_flown else allowed)
    far_off = (0.0, 1.0, 0.0)
    assert better_kept((1.01, -9.0, 0.0), far_off, [fence, vehicle]) == (1.01, -9.0, 0.0)
    assert better_kept((0.99, -9.0, 0.0), far_off, [fence, vehicle]) is far_off


# ---------------------------------------------------------------- the stage

TAN_TILT = tan(radians(25.0))
LIMITS = AccelerationLimits.of_envelope(TAN_TILT, 0.3, 1.6)
SETTINGS = SeparationSettings(1, 2.0 - KEPT_M, 1.5, 0.3, 8.0)
GAINS = Gains(2.0, 1.5)
NOW_S = 10.0
OWN = VehicleState(position_enu_m=(0.0, 0.0, 20.0), position_time_s=NOW_S, position_error=PositionError(0.1, 0.2))


def stage() -> SafetyFilter:
    return SafetyFilter(SETTINGS, BOUNDS, LIMITS, GAINS)


def peer(
    position_enu_m: Vector3,
    velocity_enu_m_s: Vector3 = ZERO3,
    phase: FlightPhase = FlightPhase.HOLD,
    age_s: float = 0.0,
) -> PeerState:
    packet = with_fields(
        slot_peer(2), phase=phase, position_enu_m=position_enu_m, velocity_enu_m_s=velocity_enu_m_s, armed=True
    )
    packet = replace(packet, slot=FlownSlot((2.5, 0.0, 0.0)))
    return PeerState(packet, NOW_S - age_s, 0.0, NOW_S - age_s)


def by_hand(
    own: VehicleState, slot: FlownSlot | None, known: dict[int, PeerState], fresh: dict[int, PeerState], wanted: Vector3
) -> tuple[Vector3, float]:
    """What the parts give one after another, for a vehicle that nothing has pressed before; and the most removed."""
    motions = Motions(1, Silence(0.3, 0.0, 1.0, 1.5, 10.0))  # 1.25 times the largest speed
    separation = Separation(SETTINGS)
    ahead = motions.own(NOW_S, own, ZERO3)
    others = motions.peers(NOW_S, own, slot is not None, known, fresh)
    barriers = [separation.barrier(ahead, own.position_error or PositionError(0.0, 0.0), slot, one) for one in others]
    below = separation.barriers_below(ahead, own.position_error or PositionError(0.0, 0.0), slot, others)
    barriers += below
    slowed, speed = BOUNDS.limit_speed(ahead, wanted)
    asked = [barrier.constraint for barrier in barriers]
    asked += [b.constraint_without_margins for b in barriers if b.constraint_without_margins]
    asked += BOUNDS.constraints(ahead, own.ground_position_enu_m) + speed
    allowed = filter_acceleration(eased(slowed, barriers), asked, LIMITS, 15 if below else 5)
    x, y = turn_right(slowed, own.velocity_enu_m_s, GAINS, barriers)
    if x or y:
        turned = filter_acceleration((allowed[0] + x, allowed[1] + y, allowed[2]), asked, LIMITS, 15 if below else 3)
        allowed = better_kept(turned, allowed, asked)
    return allowed, largest_removed_m_s2(slowed, barriers)


FORMATION = FlightPhase.FORMATION
WAITS, FLIES = replace(OWN, velocity_enu_m_s=(0.2, 0.1, 0.0)), replace(OWN, velocity_enu_m_s=(1.0, 0.2, 0.0))
CASES = {  # own state, own slot, the other vehicle, and whether it is fresh
    "comes": (FLIES, None, peer((3.5, 0.3, 20.2), (-1.0, 0.0, 0.0)), True),
    "in formation": (FLIES, FlownSlot(ZERO3), peer((2.2, 0.3, 20.2), (-0.5, 0.0, 0.0), FORMATION), True),
    "head on": (FLIES, FlownSlot(ZERO3), peer((2.4, 0.0, 20.0), (-0.5, 0.0, 0.0), FORMATION), True),
    "silent for a moment": (WAITS, None, peer((4.5, 0.3, 20.0), (-3.0, 0.1, 0.0), FORMATION, 0.5), False),
    "silent": (WAITS, None, peer((6.5, 0.3, 20.0), (-3.0, 0.1, 0.0), FORMATION, 1.3), False),
    "silent for long": (WAITS, None, peer((12.5, 0.3, 20.0), (-3.0, 0.1, 0.0), FORMATION, 4.0), False),
    "above": (WAITS, None, peer((0.4, 0.3, 24.0), ZERO3, FORMATION, 6.0), False),
    "silent before it": (FLIES, None, peer((2.1, 0.3, 20.0), (1.0, 0.2, 0.0), FORMATION, 0.9), False),
    "over the ground": (
        replace(OWN, ground_position_enu_m=(0.0, 0.0, 19.3), velocity_enu_m_s=(0.0, 0.0, -0.8)),
        None,
        peer((2.5, 0.3, 20.0)),
        True,
    ),
    "without an error": (replace(OWN, position_error=None), None, peer((2.2, 0.3, 20.0)), True),
}


@pytest.mark.parametrize("pull_m_s2", [1.5, 9.0])
@pytest.mark.parametrize("name", CASES)
def test_the_stage_gives_what_its_parts_give_one_after_another(name: str, pull_m_s2: float) -> None:
    own, slot, other, is_fresh = CASES[name]
    known = {2: other}
    fresh = known if is_fresh else {}
    wanted = (pull_m_s2, 0.1, 0.2)
    found = stage().step(NOW_S, own, slot, known, fresh, wanted, ZERO3, ZERO3)
    expected, removed_m_s2 = by_hand(own, slot, known, fresh, wanted)
    assert found.acceleration_enu_m_s2 == pytest.approx(expected) != wanted
    assert found.removed_accel_m_s2 == pytest.approx(removed_m_s2)
    assert found.separation.changed_m_s2 == pytest.approx(
        hypot(*(a - b for a, b in zip(expected, wanted, strict=True)))
    )
    nearest = found.separation.nearest
    assert nearest is not None and nearest.name == "2"
    assert found.separation.violated is (nearest.distance_m < 2.0)


def test_the_turn_gets_three_steps_between_walls_that_contradict_each_other() -> None:
    """So a tick of two solutions stays short."""
    wish, one = (
        (-2.5, 0.0, 0.0),
        Other(2, (ZERO3, ZERO3, ZERO3), ZERO3, 0.0, None, NO_ERROR, 1.0, FlownSlot(ZERO3), True, 1.0),
    )
    ahead = Barrier((1.0, 0.0, 0.0, 0.0, Rank.VEHICLE), one, (3.0, 0.0, 0.0), 2.0, 1.0)
    walls: list[Constraint] = [(0.0, -0.8, 0.6, 1.5, Rank.FENCE), (0.0, 0.6, -0.8, 1.5, Rank.FENCE)]
    found = stage().allowed(NOW_S, OWN, [ahead], walls, wish, wish, ZERO3, SeparationReport())
    x, y, z = filter_acceleration(wish, [ahead.constraint, *walls], LIMITS, 5)
    turned = [filter_acceleration((x, y + 2.0, z), [ahead.constraint, *walls], LIMITS, steps) for steps in (2, 3, 4, 5)]
    assert found.acceleration_enu_m_s2 == pytest.approx(turned[1])
    assert all(dist(found.acceleration_enu_m_s2, other) > 0.1 for other in (turned[0], *turned[2:]))


@pytest.mark.parametrize(
    ("margins_m", "steps", "turn_steps"),
    [((0.29, 0.29, 0.29), 15, 15), ((0.29, 0.3, 0.29), 5, 3), ((0.29, 0.29), 5, 3)],
)
def test_between_three_vehicles_all_of_them_count(margins_m: tuple[float, ...], steps: int, turn_steps: int) -> None:
    """The northern one of three that ask for more than can be flown; and walls on the way out."""
    normals = [(-0.96, -0.26, -0.05), (0.5, 0.86, -0.06), (0.99, -0.13, -0.05)]
    barriers = [
        Barrier(
            (*normal, least, Rank.VEHICLE),
            Other(i, (ZERO3, ZERO3, ZERO3), ZERO3, 0.0, None, NO_ERROR, 1.0, FlownSlot(ZERO3), True, 1.0),
            (3.0, 0.0, 0.0),
            2.0,
            margin_m,
        )
        for i, (normal, least, margin_m) in enumerate(zip(normals, (2.2, 4.0, 0.5), margins_m, strict=False), start=2)
    ]
    walls: list[Constraint] = [(0.0, -1.0, 0.0, -3.5, Rank.FENCE), (0.0, 0.0, -1.0, -0.5, Rank.SPEED)]
    wish, asked = (-1.6, -4.0, 1.0), [*(barrier.constraint for barrier in barriers), *walls]
    x, y, z = filter_acceleration(wish, asked, LIMITS, steps)
    assert dist(filter_acceleration(wish, asked, LIMITS, 20 - steps), (x, y, z)) > 0.1
    turn_x, turn_y = turn_right(wish, OWN.velocity_enu_m_s, GAINS, barriers)
    turned = filter_acceleration((x + turn_x, y + turn_y, z), asked, LIMITS, turn_steps)
    found = stage().allowed(NOW_S, OWN, barriers, walls, wish, wish, ZERO3, SeparationReport())
    assert found.acceleration_enu_m_s2 == pytest.approx(better_kept(turned, (x, y, z), asked))


def test_a_silent_vehicle_is_believed_to_be_no_faster_than_a_quarter_above_the_limit() -> None:
    """At the 30 m/s of its packet it could not brake any more."""
    known = {2: peer((100.0, 0.0, 20.0), (-30.0, 0.0, 0.0), FORMATION, 1.4)}
    assert stage().step(NOW_S, WAITS, None, known, {}, (1.5, 0.1, 0.2), ZERO3, ZERO3).separation.changed_m_s2 == 0.0
    known = {2: peer((30.0, 0.0, 20.0), (-9.9, 0.0, 0.0), FORMATION, 1.4)}  # at 5 m/s it would not matter
    assert stage().step(NOW_S, WAITS, None, known, {}, (1.5, 0.1, 0.2), ZERO3, ZERO3).separation.changed_m_s2 > 0.0


def test_two_that_part_are_too_near_and_nothing_is_changed() -> None:
    wanted = (-3.0, 0.0, 0.0)
    parts = {2: peer((1.8, 0.0, 20.0), (2.0, 0.0, 0.0))}
    found = stage().step(
        NOW_S, replace(OWN, velocity_enu_m_s=(-2.0, 0.0, 0.0)), None, parts, parts, wanted, ZERO3, ZERO3
    )
    assert found.acceleration_enu_m_s2 is wanted
    assert (found.separation.violated, found.separation.changed_m_s2) == (True, 0.0)
    assert found.separation.changed_m_s2 is not False


def test_peers_count_beside_traffic_and_the_nearest_traffic_is_remembered() -> None:
    one, near = stage(), {2: peer((2.2, 0.0, 20.0))}
    cranes = [
        ReceivedTraffic(NOW_S, f"crane {k}", TrafficSample((3.0 + k, 0.0, 20.0), ZERO3, 0.0, 0.3)) for k in range(20)
    ]
    one.receive(NOW_S, OWN, cranes)
    assert set(one.traffic) == {f"crane {k}" for k in range(16)}
    found = one.step(NOW_S, OWN, None, near, near, ZERO3, ZERO3, ZERO3)
    assert found.separation.nearest is not None and found.separation.nearest.name == "2"


def test_far_from_everything_nothing_is_changed_or_reported() -> None:
    wanted = (0.5, 0.1, 0.2)
    found = stage().step(NOW_S, OWN, None, {}, {}, wanted, ZERO3, ZERO3)
    assert found.acceleration_enu_m_s2 is wanted
    assert (found.separation, found.removed_accel_m_s2) == (SeparationReport(), 0.0)
    seen = stage().step(
        NOW_S, OWN, None, {2: peer((7.0, 0.0, 20.0))}, {2: peer((7.0, 0.0, 20.0))}, wanted, ZERO3, ZERO3
    )
    assert seen.acceleration_enu_m_s2 is wanted
    assert seen.separation == SeparationReport(NearestVehicle("2", 7.0, pytest.approx(2.25)), 0.0, violated=False)


def test_without_vehicles_the_fence_and_the_speed_alone_change_the_wish() -> None:
    fast = replace(OWN, velocity_enu_m_s=(12.0, 0.0, 0.0))
    found = stage().step(NOW_S, fast, None, {}, {}, (1.0, 0.5, 0.0), ZERO3, ZERO3)
    x, y, z = found.acceleration_enu_m_s2
    assert (y, z) == (pytest.approx(0.5, abs=0.01), 0.0) and x < -2.0
    assert found.removed_accel_m_s2 == 0.0
    assert found.separation.changed_m_s2 == pytest.approx(1.0 - x)


def test_the_last_command_and_the_wind_count() -> None:
    """The command acts by the lag; the wind moves what the vehicle can fly."""
    at_wall = replace(OWN, position_enu_m=(23.6, 0.0, 20.0), velocity_enu_m_s=(0.9, 0.0, 0.0))
    found = []
    for flown in (ZERO3, (3.0, 0.0, 0.0)):
        one = stage()
        one.step(NOW_S - 0.1, replace(at_wall, position_time_s=NOW_S - 0.1), None, {}, {}, ZERO3, flown, ZERO3)
        found.append(one.step(NOW_S, at_wall, None, {}, {}, ZERO3, flown, ZERO3).acceleration_enu_m_s2[0])
    assert found[1] < found[0] - 0.3
    fast = replace(at_wall, velocity_enu_m_s=(9.0, 0.0, 0.0))
    blown = [
        stage().step(NOW_S, fast, None, {}, {}, ZERO3, ZERO3, wind).acceleration_enu_m_s2[0]
        for wind in (ZERO3, (2.0, 0.0, 0.0))
    ]
    assert blown == pytest.approx([-GRAVITY_M_S2 * TAN_TILT, 2.0 - GRAVITY_M_S2 * TAN_TILT], rel=0.02)


def test_traffic_is_avoided_while_it_is_remembered() -> None:
    one, crane = stage(), TrafficSample((2.4, 0.0, 20.0), ZERO3, 0.0, 0.3)
    one.receive(NOW_S, OWN, [ReceivedTraffic(NOW_S, "crane", crane)])
    found = one.step(NOW_S, OWN, None, {}, {}, ZERO3, ZERO3, ZERO3)
    assert found.separation.nearest == NearestVehicle(
        "crane", pytest.approx(2.4), pytest.approx(2.15 + hypot(0.1, 0.3))
    )
    assert found.acceleration_enu_m_s2[0] < 0.0 and not one.is_pressed
    one.receive(NOW_S + 31.0, OWN, [])
    assert one.step(NOW_S + 31.0, replace(OWN, position_time_s=NOW_S + 31.0), None, {}, {}, ZERO3, ZERO3, ZERO3) == (
        stage().step(NOW_S, OWN, None, {}, {}, ZERO3, ZERO3, ZERO3)
    )


def test_one_that_no_evasion_shakes_off_is_named_and_no_longer_evaded() -> None:
    one, wanted, unshaken_s, found = stage(), (0.3, 0.1, 0.0), None, []
    for tick in range(200):
        now_s = NOW_S + 0.02 * tick
        on_top = {2: replace(peer((0.5, 0.0, 20.0)), measured_s=now_s, received_s=now_s)}
        own = replace(OWN, position_time_s=now_s)
        found.append(one.step(now_s, own, None, on_top, on_top, wanted, ZERO3, ZERO3))
        if unshaken_s is None and found[-1].separation.unshaken:
            unshaken_s = now_s - NOW_S
    assert unshaken_s == pytest.approx(2.0, abs=0.05)
    assert found[50].acceleration_enu_m_s2[0] < -3.0 and found[50].separation.unshaken == ()
    assert found[-1].separation.unshaken == ("2",) and one.is_pressed
    assert found[-1].acceleration_enu_m_s2 == wanted
    for tick in range(200, 900):  # it has left
        now_s = NOW_S + 0.02 * tick
        one.step(now_s, replace(OWN, position_time_s=now_s), None, {}, {}, wanted, ZERO3, ZERO3)
    assert not one.is_pressed


def test_a_vehicle_plans_to_brake_with_half_of_its_tilt_and_alone_with_six_tenths_of_that() -> None:
    settings, half_m_s2 = (
        separation_settings_of(FLEET, 2),
        0.5 * GRAVITY_M_S2 * tan(radians(FLEET.envelope.max_tilt_deg)),
    )
    assert settings.braking_m_s2 == pytest.approx(half_m_s2)
    assert safety_filter_of(FLEET, 2).braking_alone_m_s2 == pytest.approx(0.6 * half_m_s2)


# ---------------------------------------------------------------- events


def test_an_intervention_is_reported_from_three_tenths_on_again_after_two_seconds_and_no_sooner_than_five() -> None:
    def changed(m_s2: float) -> SeparationReport:
        return SeparationReport(NearestVehicle("7", 1.234, 2.0), m_s2)

    events = Interventions()
    assert events.step(0.0, changed(0.29)) == ()
    (notice,) = events.step(0.0, changed(0.3))
    assert notice.code is Code.SEPARATION_INTERVENES
    assert notice.text.endswith("by 0.3 m/s^2; nearest vehicle: 7 at 1.23 m, required 2.00 m")
    assert events.step(2.0, changed(9.0)) == ()
    assert events.step(4.1, changed(9.0)) == ()  # a new one, too soon
    assert events.step(5.5, changed(9.0)) == ()  # it goes on
    assert events.step(7.5, changed(9.0)) == ()
    assert len(events.step(9.6, changed(9.0))) == 1
    other = Interventions()
    other.step(0.0, changed(1.0))
    assert (other.step(5.0, changed(1.0)), len(other.step(7.5, changed(1.0)))) == ((), 1)
    assert other.step(10.0, SeparationReport(None, 0.0)) == ()
