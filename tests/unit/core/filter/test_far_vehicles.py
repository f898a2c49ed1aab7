"""Vehicles that are left out because they are far away change nothing."""

from __future__ import annotations

from math import hypot
from random import Random

import pytest

from companion.core.filter.motion import Ahead, Other
from companion.core.filter.vehicles import QUIET_M_S, QUIET_M_S2, Separation, SeparationSettings, nearest_and_violated
from companion.geometry.formations import HEIGHT_WEIGHT
from companion.types.autopilot import PositionError, VehicleState
from companion.types.formation import FlownSlot
from companion.types.values import ZERO3, Vector3

SETTINGS = SeparationSettings(1, separation_m=1.0, braking_m_s2=2.3, fresh_s=0.3, max_speed_m_s=5.0)
OWN_SLOT, ERROR = FlownSlot(ZERO3), PositionError(0.1, 0.1)


def vector(random: Random, most: float) -> Vector3:
    return (random.uniform(-most, most), random.uniform(-most, most), random.uniform(-most, most))


def others_of(random: Random) -> list[Other]:
    """In and near their slots, many of them about as slow and soft as a quiet vehicle may be; the first one is near."""
    others = []
    for key in range(2, 12):
        x, y, z = vector(random, 0.6 if key == 2 else 2.5)
        dx, dy, dz = vector(random, 1.0)
        last = ((x, y, z), vector(random, 0.6 * QUIET_M_S), vector(random, 0.6 * QUIET_M_S2))
        error = PositionError(random.uniform(0.0, 2.0), random.uniform(0.0, 2.0))
        slot = FlownSlot((x + dx, y + dy, z + dz), moves_for_s=random.choice((0.0, 1.0)))
        age_s = random.uniform(0.0, 0.3)
        others.append(Other(key, last, age_s, None, error, HEIGHT_WEIGHT, slot, makes_way=True, side=1.0))
    return others


@pytest.mark.parametrize("seed", range(300))
def test_what_is_left_out_allows_what_is_wanted_and_is_farther_away_than_another(seed: int) -> None:
    random = Random(seed)
    others, separation = others_of(random), Separation(SETTINGS)
    ahead, wanted = Ahead(ZERO3, ZERO3), vector(random, random.choice((0.1, 1.0, 3.0)))
    every = separation.barriers(ahead, ERROR, OWN_SLOT, others)
    near = separation.barriers(ahead, ERROR, OWN_SLOT, others, separation.free_m(wanted))
    vehicle = VehicleState(position_enu_m=ZERO3, velocity_enu_m_s=ahead.velocity_enu_m_s, position_time_s=0.0)
    assert [barrier for barrier in every if barrier in near] == near
    assert nearest_and_violated(0.0, vehicle, near, 1.0) == nearest_and_violated(0.0, vehicle, every, 1.0)
    left_out = [barrier for barrier in every if barrier not in near]
    assert all(barrier.constraint[3] <= -hypot(*wanted) for barrier in left_out)


def test_most_vehicles_of_a_large_formation_are_left_out() -> None:
    separation, ahead = Separation(SETTINGS), Ahead(ZERO3, ZERO3)
    places = [(2.0 * east, 2.0 * north, 0.0) for east in range(-4, 5) for north in range(-4, 5) if east or north]
    others = [
        Other(key, (place, ZERO3, ZERO3), 0.02, None, ERROR, HEIGHT_WEIGHT, FlownSlot(place), makes_way=True, side=1.0)
        for key, place in enumerate(sorted(places, key=lambda place: hypot(*place)), start=2)
    ]
    near = separation.barriers(ahead, ERROR, OWN_SLOT, others, separation.free_m((0.2, 0.0, 0.0)))
    assert {barrier.other.key for barrier in near} == set(range(2, 10))
