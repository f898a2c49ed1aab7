"""A law in flight: what it is told, what it remembers, and what of its answers is refused. And the time of its calls."""

# ruff: noqa: ARG002 -- laws that ignore what they are told
from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import pytest

from companion.core.consensus.law import FlownLaw, LawError
from companion.laws import FormationState, Law, Memory, Neighbour, Own, Values
from companion.link.law_timer import LawTimer
from companion.types.autopilot import VehicleState
from companion.types.formation import FlownSlot
from companion.types.values import ZERO3, Vector3

SLOT = FlownSlot((-2.0, 1.0, 0.0), (0.1, 0.0, 0.0), (0.01, 0.0, 0.0))


class Told(Law, frozen=True):
    """Its acceleration and its values are what it is told."""

    memory = 1
    publishes = 2

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        return (own.memory[0][0], own.step_s, own.drag_1_s)

    def remember(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Memory:
        return ((own.memory[0][0] + 1.0, 0.0, 0.0),)

    def publish(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Values:
        return (own.position_enu_m, own.velocity_enu_m_s)


class Answers(Law, frozen=True):
    """It answers with its fields, whatever they are."""

    memory = 1
    publishes = 1
    wanted: Any = ZERO3
    remembered: Any = (ZERO3,)
    published: Any = (ZERO3,)

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        return self.wanted  # type: ignore[no-any-return]

    def remember(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Memory:
        return self.remembered  # type: ignore[no-any-return]

    def publish(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Values:
        if self.published == "raise":
            raise KeyError("nothing here")
        return self.published  # type: ignore[no-any-return]


def at(time_s: float) -> VehicleState:
    return VehicleState((1.0, 2.0, 3.0), (0.5, 0.0, 0.0), position_time_s=time_s)


def asked(law: FlownLaw, time_s: float) -> Vector3:
    return law.acceleration(at(time_s), SLOT, ZERO3, (), None)


def test_it_remembers_from_position_to_position_and_forgets_outside_formation() -> None:
    law = FlownLaw(Told(), drag_1_s=0.3)
    assert asked(law, 10.0) == (0.0, 0.02, 0.3)  # the first step is the usual one
    assert asked(law, 10.05) == (1.0, pytest.approx(0.05), 0.3)
    assert asked(law, 13.0) == (2.0, 0.5, 0.3)  # the longest
    law.end()
    assert asked(law, 13.02) == (0.0, 0.02, 0.3)


def test_what_it_publishes_is_relative_to_the_slot_and_its_motion() -> None:
    assert FlownLaw(Told(), 0.0).values(at(1.0), SLOT, ZERO3, (), None) == ((3.0, 1.0, 3.0), (0.4, 0.0, 0.0))


BAD_VECTORS: list[Any] = [
    (),
    (ZERO3, ZERO3),
    ((0.0, 0.0),),
    ((0.0, 0.0, float("nan")),),
    ((float("inf"), float("-inf"), 0.0),),
    (None,),
    None,
    (("a", "b", "c"),),
]


@pytest.mark.parametrize(
    "wanted", [(float("nan"), 0.0, 0.0), (0.0, 0.0, -1e6), (float("inf"), 0.0, 0.0), (1.0,), None, "abc"]
)
def test_an_acceleration_that_cannot_be_flown(wanted: Any) -> None:
    with pytest.raises(LawError, match=r"the law (gives|raises)"):
        asked(FlownLaw(Answers(wanted=wanted), 0.0), 1.0)


@pytest.mark.parametrize("vectors", BAD_VECTORS)
def test_a_memory_and_values_of_another_shape(vectors: Any) -> None:
    with pytest.raises(LawError, match=r"the law remembers .* expected 1 vectors"):
        asked(FlownLaw(Answers(remembered=vectors), 0.0), 1.0)
    with pytest.raises(LawError, match=r"the law publishes .* expected 1 vectors"):
        FlownLaw(Answers(published=vectors), 0.0).values(at(1.0), SLOT, ZERO3, (), None)


def test_values_that_peers_would_refuse_end_the_vehicle_that_publishes_them() -> None:
    assert FlownLaw(Answers(published=((2e4, 0.0, 0.0),)), 0.0).values(at(1.0), SLOT, ZERO3, (), None)
    with pytest.raises(LawError, match="up to 20000"):
        FlownLaw(Answers(published=((0.0, 2.1e4, 0.0),)), 0.0).values(at(1.0), SLOT, ZERO3, (), None)


def test_an_exception_is_named() -> None:
    with pytest.raises(LawError, match="the law raises KeyError: 'nothing here'"):
        FlownLaw(Answers(published="raise"), 0.0).values(at(1.0), SLOT, ZERO3, (), None)


def test_the_timer_measures_all_calls_and_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    clock_s = iter(range(100))
    monkeypatch.setattr(time, "monotonic", lambda: float(next(clock_s)))
    timer = LawTimer(Told(), [])
    law, plain = FlownLaw(timer, 0.3), FlownLaw(Told(), 0.3)
    for time_s in (1.0, 1.02):
        assert asked(law, time_s) == asked(plain, time_s)
    assert timer.read_s() == 4.0  # two of acceleration, two of remember
    assert law.values(at(1.0), SLOT, ZERO3, (), None) == plain.values(at(1.0), SLOT, ZERO3, (), None)
    assert (timer.read_s(), timer.read_s()) == (1.0, 0.0)
    assert (timer.memory, timer.publishes) == (1, 2)
    raising = LawTimer(Answers(published="raise"), [])
    with pytest.raises(KeyError):
        raising.publish(Own(ZERO3, ZERO3), (), None)
    assert raising.read_s() == 1.0
