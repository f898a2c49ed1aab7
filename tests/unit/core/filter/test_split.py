"""What a vehicle flies while the network is split."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from common import NOW_S, peer
from companion.assembly import safety_filter_of
from companion.core.consensus.peers import PeerState
from companion.core.filter.motion import KEPT_S, Ahead, Motions, Silence
from companion.core.filter.split import Split
from companion.core.filter.vehicles import ALONE_SHARE
from companion.types.autopilot import VehicleState
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot, Gains
from companion.types.values import ZERO3
from one_agent import FLEET

FRESH_S, BRAKING_M_S2 = 0.3, 2.0
OWN = peer(2).packet.motion.position_enu_m
EAST = VehicleState(position_enu_m=OWN, velocity_enu_m_s=(1.0, 0.0, 0.0), position_time_s=NOW_S)


IN_PLACE = peer(2).packet.slot
CHANGES = replace(IN_PLACE, moves_for_s=2.0)


def silent(vehicle_id: int, for_s: float, **changes: object) -> PeerState:
    heard_s = NOW_S - for_s
    return PeerState(peer(vehicle_id, **changes).packet, heard_s, heard_s, heard_s)  # type: ignore[arg-type]


def ahead(vehicle: VehicleState) -> Ahead:
    """Without acceleration and lag."""
    return Ahead(vehicle.position_enu_m, vehicle.velocity_enu_m_s)


def split(separation_m: float = 0.5) -> Split:
    return Split(FRESH_S, separation_m, BRAKING_M_S2, Gains(2.0, 2.4))


def behind(*peers: PeerState, slot: FlownSlot | None = CHANGES) -> frozenset[int]:
    """The vehicles that a new `Split` finds behind the split; `peers` are those that are silent."""
    return split().step(NOW_S, EAST, ahead(EAST), slot, {one.packet.sender.vehicle_id: one for one in peers}, {})


def test_vehicles_that_fall_silent_at_once_are_behind_a_split() -> None:
    assert behind(silent(1, 0.35), silent(3, 0.5)) == {1, 3}


def test_one_silent_vehicle_has_lost_its_agent() -> None:
    assert behind(silent(1, 0.35)) == frozenset()


def test_vehicles_that_fell_silent_one_after_the_other_are_behind_no_split() -> None:
    """Within a second of each other they count."""
    assert behind(silent(1, 0.35), silent(3, 1.34)) == {1, 3}
    assert behind(silent(1, 0.35), silent(3, 1.36)) == frozenset()


def test_a_vehicle_whose_packet_is_merely_late_does_not_count() -> None:
    assert behind(silent(1, 0.35), silent(3, FRESH_S)) == frozenset()


def test_vehicles_far_away_do_not_count() -> None:
    """From 12 m on."""
    x, y, z = OWN
    for north_m, found in ((11.9, {1, 3}), (12.1, set())):
        far = silent(3, 0.35, position_enu_m=(x, y + north_m, z))
        assert behind(silent(1, 0.35), far) == found


def test_a_vehicle_that_its_autopilot_flies_does_not_count() -> None:
    assert behind(silent(1, 0.35), silent(3, 0.35, phase=FlightPhase.HOLD)) == frozenset()


def test_a_formation_that_keeps_its_shape_flies_on() -> None:
    """Two agents that end at once, or a split: nobody has to evade."""
    both = (silent(1, 0.35), silent(3, 0.35))
    assert behind(*both, slot=IN_PLACE) == frozenset()
    kept, peers = split(), {one.packet.sender.vehicle_id: one for one in both}
    assert not kept.step(NOW_S, EAST, ahead(EAST), IN_PLACE, peers, {})
    x, y, z = OWN
    gone_on = replace(EAST, position_enu_m=(x + 3.0, y, z))
    # It has left the silent ones behind.
    assert not kept.step(NOW_S + 1.0, gone_on, ahead(gone_on), IN_PLACE, peers, {})


@pytest.mark.parametrize(("separation_m", "speed_m_s", "wide_m"), [(1.0, 0.0, 1.7), (0.4, 0.0, 0.8), (1.0, 2.0, 2.5)])
def test_a_vehicle_flies_on_only_far_from_what_is_silent(separation_m: float, speed_m_s: float, wide_m: float) -> None:
    """1.5 times separation_m, 0.2 m, and the way of 0.4 s."""
    moving = replace(EAST, velocity_enu_m_s=(0.0, -0.6 * speed_m_s, 0.8 * speed_m_s))
    x, y, z = OWN
    for apart_m, found in ((wide_m + 0.01, set()), (wide_m - 0.01, {1, 3})):
        slots = (
            replace(peer(i).packet.slot, position_enu_m=(-1.5, apart_m * side, 0.0)) for i, side in ((1, 1), (3, -1.1))
        )
        placed = zip((1, 3), slots, (apart_m, -1.1 * apart_m), strict=True)
        near = {
            i: silent(i, 0.35, slot=slot, position_enu_m=(x, y + north_m, z), velocity_enu_m_s=ZERO3)
            for i, slot, north_m in placed
        }
        own_slot = replace(IN_PLACE, position_enu_m=(-1.5, 0.0, 0.0))
        assert split(separation_m).step(NOW_S, moving, ahead(moving), own_slot, near, {}) == found


@pytest.mark.parametrize(
    ("slot", "changes"),
    [
        (IN_PLACE, {"slot": replace(peer(3).packet.slot, moves_for_s=1.0)}),
        (IN_PLACE, {"slot": replace(peer(3).packet.slot, waiting=1)}),
        (replace(IN_PLACE, waiting=1), {}),
        (replace(IN_PLACE, position_enu_m=(-1.5, 0.6, 0.0)), {}),
        (None, {"slot": replace(peer(3).packet.slot, moves_for_s=1.0)}),
    ],
)
def test_where_slots_move_or_vehicles_are_not_placed_the_split_counts(
    slot: FlownSlot | None, changes: dict[str, object]
) -> None:
    assert behind(silent(1, 0.35), silent(3, 0.35, **changes), slot=slot) == {1, 3}


def test_a_split_lasts_until_all_are_heard_again() -> None:
    of_both = split()
    silent_ones = {1: silent(1, 0.35), 3: silent(3, 0.35)}
    assert of_both.step(NOW_S, EAST, ahead(EAST), CHANGES, silent_ones, {}) == {1, 3}
    heard = silent_ones | {1: peer(1)}
    assert of_both.step(NOW_S, EAST, ahead(EAST), CHANGES, heard, {1: heard[1]}) == {3}
    heard |= {3: peer(3)}
    assert of_both.step(NOW_S, EAST, ahead(EAST), CHANGES, heard, heard) == frozenset()


def test_nobody_waits_longer_than_thirty_seconds() -> None:
    of_both = split()
    silent_ones = {1: silent(1, 0.35), 3: silent(3, 0.35)}
    for after_s, found in ((0.0, {1, 3}), (29.6, {1, 3}), (29.7, set())):
        assert of_both.step(NOW_S + after_s, EAST, ahead(EAST), CHANGES, silent_ones, {}) == found


def test_a_split_goes_on_after_the_slots_have_moved_and_the_way_of_braking_stays_the_same() -> None:
    of_both, silent_ones = split(), {1: silent(1, 0.35), 3: silent(3, 0.35)}
    assert of_both.step(NOW_S, EAST, ahead(EAST), CHANGES, silent_ones, {}) == {1, 3}
    x, y, z = OWN
    later = VehicleState(position_enu_m=(x + 0.16, y, z), velocity_enu_m_s=(0.6, 0.0, 0.0))
    assert of_both.step(NOW_S + 0.2, later, ahead(later), IN_PLACE, silent_ones, {}) == {1, 3}
    assert of_both.acceleration(NOW_S + 0.2, ahead(later)) == pytest.approx((-BRAKING_M_S2, 0.0, 0.0), abs=1e-9)


def test_a_vehicle_half_a_metre_off_its_slot_is_in_place() -> None:
    x, y, z = OWN
    for off_m, found in ((0.49, set()), (0.51, {1, 3})):
        both = (silent(1, 0.35), silent(3, 0.35, position_enu_m=(x - 2.0, y, z + off_m)))
        assert behind(*both, slot=IN_PLACE) == found


@pytest.mark.parametrize("after_s", [0.0, 0.2, 0.49])
def test_the_vehicle_brakes_on_a_straight_line(after_s: float) -> None:
    """From 1 m/s with 2 m/s^2: 0.25 m in half a second."""
    waiting, way = split(), (0.6, -0.48, 0.64)
    moving = replace(EAST, velocity_enu_m_s=way)
    assert waiting.step(NOW_S, moving, ahead(moving), CHANGES, {1: silent(1, 0.35), 3: silent(3, 0.35)}, {})
    left_m_s = 1.0 - BRAKING_M_S2 * after_s
    gone_m = after_s * (1.0 + left_m_s) / 2.0
    x, y, z = (p + gone_m * w for p, w in zip(OWN, way, strict=True))
    vx, vy, vz = (left_m_s * w for w in way)
    on_time = VehicleState(position_enu_m=(x, y, z), velocity_enu_m_s=(vx, vy, vz))
    expected = tuple(-BRAKING_M_S2 * w for w in way)
    assert waiting.acceleration(NOW_S + after_s, ahead(on_time)) == pytest.approx(expected, abs=1e-9)


def test_a_vehicle_that_its_attitude_already_brakes_does_not_fly_back() -> None:
    """It still moves at 1 m/s and tilts against it: its lag ends at rest a decimetre on."""
    x, y, z = OWN
    comes_to_rest, waiting = Ahead((x + 0.1, y, z), ZERO3), split()
    assert waiting.step(NOW_S, EAST, comes_to_rest, CHANGES, {1: silent(1, 0.35), 3: silent(3, 0.35)}, {})
    assert waiting.acceleration(NOW_S, comes_to_rest) == ZERO3
    flies_back = Ahead((x + 0.1, y, z), (-0.4, 0.0, 0.0))
    assert waiting.acceleration(NOW_S + 0.2, flies_back)[0] > 0.5


def test_the_vehicle_stays_where_it_has_stopped() -> None:
    waiting = split()
    assert waiting.step(NOW_S, EAST, ahead(EAST), CHANGES, {1: silent(1, 0.35), 3: silent(3, 0.35)}, {})
    x, y, z = OWN
    at_rest = VehicleState(position_enu_m=(x + 0.25, y, z))
    assert waiting.acceleration(NOW_S + 5.0, ahead(at_rest)) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    pushed = VehicleState(position_enu_m=(x + 0.25, y + 0.5, z))
    assert waiting.acceleration(NOW_S + 5.0, ahead(pushed))[1] < 0.0


def test_the_slot_of_a_vehicle_that_its_autopilot_flies_does_not_count() -> None:
    """It flies in no formation: what its last packet says of its slot changes no shape."""
    leaves = silent(2, 0.1, phase=FlightPhase.HOLD, slot=CHANGES)
    assert behind(silent(1, 0.35), silent(3, 0.35), leaves, slot=IN_PLACE) == frozenset()
    moves = silent(3, 0.35, slot=replace(peer(3).packet.slot, moves_for_s=1.0))
    assert behind(leaves, silent(1, 0.35), moves, slot=IN_PLACE) == {1, 3}


def test_the_filter_brakes_behind_a_split_and_flies_the_wish_again_when_all_are_heard() -> None:
    x, y, z = OWN
    silent_ones = {i: silent(i, 0.35, position_enu_m=(x + off, y, z)) for i, off in ((1, 9.0), (3, -9.0))}
    wish = (0.4, 0.3, 0.1)
    for slot in (CHANGES, None):  # without a slot it makes way for all: its wish is flown
        one = safety_filter_of(FLEET, 2)
        braking = one.step(NOW_S, EAST, slot, silent_ones, {}, wish, ZERO3, ZERO3)
        if slot is None:
            assert braking.acceleration_enu_m_s2 is wish
        else:
            level_m_s2 = one.braking_alone_m_s2 / ALONE_SHARE
            assert braking.acceleration_enu_m_s2 == pytest.approx((-level_m_s2, 0.0, 0.0))
        heard = {i: replace(known, measured_s=NOW_S, received_s=NOW_S) for i, known in silent_ones.items()}
        assert one.step(NOW_S, EAST, slot, heard, heard, wish, ZERO3, ZERO3).acceleration_enu_m_s2 is wish


def test_the_filter_expects_no_vehicle_behind_a_split_to_fly_on() -> None:
    """From one whose agent has failed more is kept the longer it is silent; one behind a split waits where it stands."""
    x, y, z = OWN
    silent_ones = {i: silent(i, 4.0, position_enu_m=(x + off, y, z)) for i, off in ((1, 5.0), (3, -6.0))}
    required_m = []
    for slot in (CHANGES, IN_PLACE):
        known = silent_ones if slot is CHANGES else {1: silent_ones[1]}
        found = safety_filter_of(FLEET, 2).step(NOW_S, EAST, slot, known, {}, ZERO3, ZERO3, ZERO3).separation
        assert found.nearest is not None and found.nearest.name == "1"
        required_m.append(found.nearest.required_m)
    assert required_m[1] > required_m[0] + 0.3


def test_a_vehicle_behind_a_split_brakes_when_it_knows_and_not_before() -> None:
    """It flies on until it misses the others as they miss it, 0.2 s longer at most."""
    motions = Motions(2, Silence(FRESH_S, 0.0, KEPT_S, BRAKING_M_S2))
    for behind_split, brakes_s, kept_s in ((frozenset({1}), FRESH_S, FRESH_S + 0.2), (frozenset[int](), 0.0, KEPT_S)):
        (other,) = motions.peers(NOW_S, EAST, True, {1: silent(1, 0.35)}, {}, behind_split)
        assert other.makes_way is bool(behind_split) and other.slot is None
        assert other.silence is not None
        assert (other.silence.brakes_s, other.silence.kept_s) == (brakes_s, kept_s)
