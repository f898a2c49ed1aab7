"""How long a vehicle may press, tick by tick: when it begins, what it uses, when it is unshaken, and when it counts again."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from companion.core.filter.motion import Other, Silence
from companion.core.filter.pressure import Pressure
from companion.core.filter.solver import Constraint, Rank
from companion.core.filter.vehicles import Barrier
from companion.types.autopilot import PositionError, VehicleState
from companion.types.values import ZERO3, Vector3

TICK_S = 0.125
EAST_2: Constraint = (1.0, 0.0, 0.0, 2.0, Rank.VEHICLE)
FLIES_2: Vector3 = (2.0, 0.0, 0.0)  # as much as is asked
FENCE: Constraint = (-1.0, 0.0, 0.0, 0.0, Rank.FENCE)


def other(apart_m: float, key: int | str = 2, **changes: object) -> Other:
    """To the west of a vehicle at the origin."""
    one = Other(
        key=key,
        last=((-apart_m, 0.0, 0.0), ZERO3, ZERO3),
        commanded_enu_m_s2=ZERO3,
        age_s=0.0,
        silence=None,
        error=PositionError(0.0, 0.0),
        height_weight=1.0,
        slot=None,
        makes_way=False,
        side=1.0,
    )
    return replace(one, **changes)


def barrier(apart_m: float, constraint: Constraint = EAST_2, **changes: object) -> Barrier:
    return Barrier(constraint, other(apart_m, **changes), (apart_m, 0.0, 0.0), 1.0, apart_m - 1.0)


class Pressed:
    """A vehicle with separation_m 1 at the origin, unless it is moved, that does what it is told."""

    def __init__(self) -> None:
        self.pressure = Pressure(1.0)
        self.now_s, self.vehicle = 100.0, VehicleState()

    def ticks(
        self,
        count: int,
        *barriers: Barrier,
        flown: Vector3 = FLIES_2,
        asked: tuple[Constraint, ...] = (),
        moves_m_s: Vector3 = ZERO3,
    ) -> Pressed:
        for _ in range(count):
            self.now_s += TICK_S
            position = tuple(p + TICK_S * v for p, v in zip(self.vehicle.position_enu_m, moves_m_s, strict=True))
            self.vehicle = replace(self.vehicle, position_time_s=self.now_s, position_enu_m=position)
            self.pressure.step(self.now_s, self.vehicle, barriers, asked, flown)
        return self

    @property
    def used_s(self) -> float:
        return self.pressure.pressing[2].used_s


NEAR = barrier(0.5)


def test_a_vehicle_that_is_fled_from_is_unshaken_after_two_seconds() -> None:
    """Each tick with it on top counts from the second one on."""
    pressed = Pressed().ticks(1, NEAR)
    assert pressed.used_s == pytest.approx(0.001)
    assert (pressed.pressure.unshaken, pressed.pressure.lasts) == ((), False)
    pressed.ticks(4, NEAR)
    assert pressed.used_s == pytest.approx(0.501) and pressed.pressure.lasts
    pressed.ticks(11, NEAR)
    assert pressed.pressure.unshaken == ()
    pressed.ticks(1, NEAR)
    assert (pressed.pressure.unshaken, pressed.used_s) == (("2",), 2.0)
    pressed.ticks(9, NEAR)
    assert pressed.used_s == 2.0
    assert not Pressed().ticks(4, NEAR).pressure.lasts


@pytest.mark.parametrize(
    ("apart_m", "least", "flown_m_s2", "presses"),
    [
        (0.89, 1.1, 1.1, True),
        (0.9, 1.1, 1.1, False),  # not on top
        (0.89, 1.0, 1.0, False),  # no flight
        (0.89, 5.0, 1.01, True),  # what is flown counts, and not what is asked
        (0.89, 5.0, 0.9, False),
        (0.89, -3.0, 1.5, True),
    ],
)
def test_who_is_nearer_than_nine_tenths_and_fled_from_by_more_than_a_metre_presses(
    apart_m: float, least: float, flown_m_s2: float, presses: bool
) -> None:
    one = barrier(apart_m, (1.0, 0.0, 0.0, least, Rank.VEHICLE))
    assert bool(Pressed().ticks(1, one, flown=(flown_m_s2, 9.0, 9.0)).pressure.pressing) is presses


def test_how_near_is_of_the_separation_and_what_is_flown_of_all_three_axes() -> None:
    oblique = (0.6, -0.48, 0.64, 5.0, Rank.VEHICLE)
    for apart_m, flown, presses in (
        (1.79, (0.7, -0.5, 0.6), True),  # 1.04 along the normal
        (1.81, (0.7, -0.5, 0.6), False),
        (1.79, (0.7, -0.5, 0.5), False),
        (1.79, (0.7, -0.3, 0.6), False),
    ):
        pressure = Pressure(2.0)
        pressure.step(1.0, VehicleState(position_time_s=1.0), [barrier(apart_m, oblique)], (), flown)
        assert bool(pressure.pressing) is presses


@pytest.mark.parametrize("rank", list(Rank))
def test_who_lets_a_limit_be_missed_presses_at_any_distance(rank: Rank) -> None:
    """A place or the speed; by more than half a metre per second squared; while it holds the vehicle."""
    far, limit = barrier(3.0, (1.0, 0.0, 0.0, 0.5, Rank.VEHICLE)), (-1.0, 0.0, 0.0, 0.0, rank)
    counts = rank in (Rank.OBSTACLE, Rank.FENCE, Rank.SPEED)
    for flown_m_s2, presses in ((0.5, False), (0.501, True), (0.549, True), (0.551, False)):
        pressed = Pressed().ticks(1, far, flown=(flown_m_s2, 0.0, 0.0), asked=(limit,))
        assert bool(pressed.pressure.pressing) is (presses and counts)


def test_the_constraint_without_margins_counts_where_there_is_one() -> None:
    both = replace(barrier(0.5, (1.0, 0.0, 0.0, -9.0, Rank.MARGIN)), constraint_without_margins=EAST_2)
    assert Pressed().ticks(1, both, flown=(2.0, 0.0, 0.0), asked=(FENCE,)).pressure.pressing
    only = barrier(0.95, (1.0, 0.0, 0.0, -9.0, Rank.MARGIN))
    assert not Pressed().ticks(1, only, flown=(2.0, 0.0, 0.0), asked=(FENCE,)).pressure.pressing


def test_a_barrier_below_presses_nobody() -> None:
    assert not Pressed().ticks(1, replace(NEAR, below=True)).pressure.pressing


def test_an_evasion_of_five_metres_is_enough() -> None:
    """From where it would have flown on to: a vehicle that flies straight on has not evaded."""
    moves = (8.0, 0.0, 0.0)
    pressed = Pressed().ticks(1, NEAR)
    for _ in range(5):
        near = barrier(0.5, last=((pressed.vehicle.position_enu_m[0] + 0.5, 0.0, 0.0), ZERO3, ZERO3))
        pressed.ticks(1, near, moves_m_s=moves)
    assert pressed.pressure.unshaken == ()  # 5.0 m
    pressed.ticks(1, barrier(0.5, last=((5.5, 0.0, 0.0), ZERO3, ZERO3)), moves_m_s=(0.1, 0.0, 0.0))
    assert pressed.pressure.unshaken == ("2",)
    onwards = Pressed()
    onwards.vehicle = replace(onwards.vehicle, velocity_enu_m_s=moves)
    onwards.ticks(1, NEAR)
    for _ in range(9):
        near = barrier(0.5, last=((onwards.vehicle.position_enu_m[0] + 0.5, 0.0, 0.0), moves, ZERO3))
        onwards.ticks(1, near, moves_m_s=moves)
    assert onwards.pressure.unshaken == ()


def test_beyond_a_fence_that_gives_way_it_would_have_flown_nowhere() -> None:
    """Then the way counts from where the fence began to give way."""
    moves = (8.0, 0.0, 0.0)
    pressed = Pressed()
    pressed.vehicle = replace(pressed.vehicle, velocity_enu_m_s=moves)

    def on_top() -> Barrier:
        return barrier(0.5, last=((pressed.vehicle.position_enu_m[0] + 0.5, 0.0, 0.0), moves, ZERO3))

    for _ in range(5):
        pressed.ticks(1, on_top(), moves_m_s=moves)
    for tick in range(7):
        assert pressed.pressure.unshaken == ()
        pressed.ticks(1, on_top(), moves_m_s=moves, asked=(FENCE,))
        if tick == 5:
            assert pressed.pressure.unshaken == ()
    assert pressed.pressure.unshaken == ("2",)
    speed = (-1.0, 0.0, 0.0, 0.0, Rank.SPEED)
    too_fast = Pressed()
    too_fast.vehicle = replace(too_fast.vehicle, velocity_enu_m_s=moves)
    for _ in range(9):
        near = barrier(0.5, last=((too_fast.vehicle.position_enu_m[0] + 0.5, 0.0, 0.0), moves, ZERO3))
        too_fast.ticks(1, near, moves_m_s=moves, asked=(speed,))
    assert too_fast.pressure.unshaken == ()


def test_without_pressure_a_fifth_of_the_time_counts_again() -> None:
    pressed = Pressed().ticks(9, NEAR).ticks(8, barrier(0.5), flown=ZERO3)
    assert pressed.used_s == pytest.approx(1.001 - 0.2)
    assert not pressed.pressure.pressing[2].presses and pressed.pressure.pressing[2].within
    pressed.ticks(8)
    assert pressed.used_s == pytest.approx(1.001 - 0.4) and not pressed.pressure.pressing[2].within
    pressed.ticks(24)
    assert pressed.pressure.pressing
    pressed.ticks(1)
    assert not pressed.pressure.pressing


def test_an_unshaken_vehicle_counts_again_when_it_has_used_a_second_or_less() -> None:
    pressed = Pressed().ticks(20, NEAR).ticks(39)
    assert pressed.pressure.unshaken == ("2",)  # 2 s less 0.975 s
    pressed.ticks(2)
    assert pressed.pressure.unshaken == ()
    assert pressed.used_s == pytest.approx(0.975)


def test_after_half_a_second_without_the_filter_nothing_of_before_counts() -> None:
    for pause_s, kept in ((0.5 - TICK_S, True), (0.5, False)):
        pressed = Pressed().ticks(9, NEAR)
        pressed.now_s += pause_s
        pressed.ticks(1, NEAR)
        assert (pressed.used_s > 1.0) is kept


def test_who_is_unshaken_gives_way_to_all_and_counts_not_at_all_while_it_follows() -> None:
    pressed = Pressed().ticks(20, NEAR)
    far, stranger = barrier(1.5), barrier(0.5, key=3)
    assert pressed.pressure.bounded([NEAR, stranger]) == [stranger]
    pressed.ticks(1, far, flown=ZERO3)
    (kept,) = pressed.pressure.bounded([far])
    assert kept == replace(far, constraint=(1.0, 0.0, 0.0, 2.0, Rank.UNSHAKEN))
    both = replace(far, constraint_without_margins=(0.0, 1.0, 0.0, 1.0, Rank.VEHICLE))
    (kept,) = pressed.pressure.bounded([both])
    assert (kept.constraint, kept.constraint_without_margins) == ((0.0, 1.0, 0.0, 1.0, Rank.UNSHAKEN), None)
    fresh = Pressed().ticks(3, NEAR)
    assert fresh.pressure.bounded([NEAR]) == [NEAR]


def test_it_follows_after_a_second_on_top_of_a_vehicle_that_flees() -> None:
    """One that only holds it at a fence does not follow: it gives way to all, and counts."""
    held = (1.0, 0.0, 0.0, 2.0, Rank.VEHICLE)
    beside = barrier(0.95, held)
    pressed = Pressed().ticks(20, beside, asked=(FENCE,))
    assert pressed.pressure.unshaken == ("2",) and pressed.pressure.pressing[2].fled_s == 0.0
    assert [one.constraint[4] for one in pressed.pressure.bounded([beside])] == [Rank.UNSHAKEN]
    pressed.ticks(8, NEAR)
    assert len(pressed.pressure.bounded([NEAR])) == 1
    pressed.ticks(1, NEAR)
    assert pressed.pressure.bounded([NEAR]) == []
    pressed.ticks(1, NEAR, flown=ZERO3)  # it gives up, and is missed
    assert pressed.pressure.pressing[2].fled_s == 1.125
    pressed.ticks(1, barrier(1.5))
    assert pressed.pressure.pressing[2].fled_s == pytest.approx(1.125 - 0.2 * TICK_S)
    for _ in range(9):
        pressed.ticks(8, NEAR)
    assert pressed.pressure.pressing[2].fled_s == 2.0


def test_an_unshaken_one_presses_on_while_its_constraint_is_missed() -> None:
    """It gives way, so it is missed and does not bind."""
    far = barrier(1.5)
    pressed = Pressed().ticks(20, NEAR)
    for flown_m_s2, presses in ((1.94, True), (1.96, False)):
        pressed.ticks(1, far, flown=(flown_m_s2, 0.0, 0.0), asked=(FENCE,))
        assert pressed.pressure.pressing[2].presses is presses


def test_the_distance_is_the_present_one_by_the_last_packet() -> None:
    """Of both; heights count by their weight; of a silent vehicle it is the expected one."""
    moved = barrier(0.0, last=((-1.0, -0.5, 0.5), (0.5, 0.25, 0.5), ZERO3), age_s=0.5)
    assert moved.other.last[1] != ZERO3
    pressed = Pressed()
    pressed.now_s, pressed.vehicle = 1.0, VehicleState(position_enu_m=(0.0, 0.0, 0.0))

    def presses(one: Barrier, old_s: float = 0.0, velocity: Vector3 = ZERO3) -> bool:
        pressure = Pressure(1.0)
        vehicle = VehicleState(position_time_s=1.0 - old_s, velocity_enu_m_s=velocity)
        pressure.step(1.0, vehicle, [one], (), FLIES_2)
        return bool(pressure.pressing)

    # At (-0.75, -0.375, 0.75): 1.13 m, or 0.92 with half of the height.
    assert not presses(moved)
    assert not presses(replace(moved, other=replace(moved.other, height_weight=0.5)))
    assert presses(replace(moved, other=replace(moved.other, height_weight=0.3)))  # 0.87 m
    assert presses(moved, 0.4, (-1.2, 0.0, 0.0))  # 0.48 m nearer: 0.88 m
    assert presses(moved, 0.4, (0.0, 0.0, 1.2))
    assert not presses(moved, 0.4, (0.0, 0.0, -1.2))
    assert presses(moved, 0.4, (-0.6, -0.6, 0.3))
    silent = replace(moved, other=replace(moved.other, silence=Silence(0.3, 0.0, 1.0, 2.0)))
    assert presses(replace(silent, margin_m=-0.6, required_m=1.49))
    assert not presses(replace(silent, margin_m=-0.6, required_m=1.51))


def test_two_vehicles_press_each_for_itself_and_are_named_in_turn() -> None:
    pressed = Pressed().ticks(20, NEAR, barrier(0.5, key="crane"))
    assert pressed.pressure.unshaken == ("2", "crane")
    pressed.ticks(60, barrier(0.5, key="crane"))
    assert pressed.pressure.unshaken == ("crane",)
