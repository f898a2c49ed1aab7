"""Hand-overs between references, and a vehicle's plan of which one it flies by when it leads."""

from __future__ import annotations

from collections.abc import Sequence
from math import dist, hypot
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.assembly import build_agent
from companion.config.vehicle import AgentConfig
from companion.core.formation import Place
from companion.core.hand_over import HandOverLimits, box_of, handed_over
from companion.core.pursuit import Box
from companion.core.reference import along, point
from companion.core.reference_plan import ReferencePlan
from companion.geometry.curves import Curve, about, circle, dying_out, figure_8
from companion.types import (
    ZERO3,
    FlightPhase,
    FlownSlot,
    HeldReference,
    PeerPacket,
    ReceivedTarget,
    ReferenceChange,
    Role,
    TargetSample,
    Vector3,
)
from sitl.fleet import reached_stand_in, vehicle_file
from sitl.scenario import load_scenario

RING = Path(__file__).parents[2] / "config" / "scenarios" / "ring_figure_8.yaml"
FENCE: Box = ((-60.0, -60.0, 0.0), (60.0, 60.0, 40.0))
LIMITS = HandOverLimits(2.0, 1.0, 25.0, 4.5, FENCE)
EIGHT = about((0.0, 0.0, 2.0), lambda t: figure_8(t, 12.0, 6.0, 25.0, 5.0))
CIRCLE = about((5.0, -8.0, 4.0), lambda t: circle(t, 6.0, 25.0, 5.0))
SLOTS = {1: (1.0, 1.0, 0.0), 2: (1.0, -1.0, 0.0), 3: (-1.0, -1.0, 0.0), 4: (-1.0, 1.0, 0.0)}

coordinates = st.floats(-30.0, 30.0)
speeds = st.floats(-2.0, 2.0)
vectors = st.tuples(coordinates, coordinates, coordinates)
small_vectors = st.tuples(speeds, speeds, speeds)


# ---------------------------------------------------------------- hand-overs


@given(vectors, small_vectors, small_vectors, st.floats(0.5, 60.0))
def test_what_dies_out_begins_as_given_ends_in_nothing_and_is_smooth(
    position: Vector3, velocity: Vector3, acceleration: Vector3, lasts_s: float
) -> None:
    delta = dying_out((position, velocity, acceleration), lasts_s)
    for got, wanted in zip(delta(0.0), (position, velocity, acceleration), strict=True):
        assert got == pytest.approx(wanted, abs=1e-9)
    for got in delta(lasts_s * (1.0 - 1e-9)):
        assert got == pytest.approx(ZERO3, abs=1e-4)
    assert delta(lasts_s) == (ZERO3, ZERO3, ZERO3)
    step_s = lasts_s * 1e-5
    for t in np.linspace(0.05, 0.95, 7) * lasts_s:
        before, now, after = delta(t - step_s), delta(t), delta(t + step_s)
        assert np.subtract(after[0], before[0]) / (2 * step_s) == pytest.approx(np.array(now[1]), abs=1e-3)
        assert np.subtract(after[1], before[1]) / (2 * step_s) == pytest.approx(np.array(now[2]), abs=1e-3)


@settings(deadline=None)
@given(st.sampled_from([EIGHT, CIRCLE]), st.sampled_from([EIGHT, CIRCLE]), st.floats(0.0, 100.0))
def test_a_hand_over_takes_all_over_and_keeps_its_limits(old: Curve, new: Curve, begins_s: float) -> None:
    before, after = along(old)(begins_s), along(new)
    found = handed_over(before, after, begins_s, LIMITS, FENCE)
    assert found is not None
    whole, lasts_s = found
    first = whole(begins_s)
    assert first.position_enu_m == pytest.approx(before.position_enu_m)
    assert first.velocity_enu_m_s == pytest.approx(before.velocity_enu_m_s)
    assert first.acceleration_enu_m_s2 == pytest.approx(before.acceleration_enu_m_s2)
    later = after(lasts_s + 3.0)
    assert whole(begins_s + lasts_s + 3.0).position_enu_m == pytest.approx(later.position_enu_m)
    assert whole(begins_s + lasts_s + 3.0).velocity_enu_m_s == pytest.approx(later.velocity_enu_m_s)
    had_m_s, had_m_s2 = hypot(*before.velocity_enu_m_s), hypot(*before.acceleration_enu_m_s2)
    for t in np.linspace(0.0, lasts_s, 500).tolist():
        with_it, without = whole(begins_s + t), after(t)
        assert dist(with_it.velocity_enu_m_s, without.velocity_enu_m_s) <= (2.0 + had_m_s) * 1.01
        assert dist(with_it.acceleration_enu_m_s2, without.acceleration_enu_m_s2) <= (1.0 + had_m_s2) * 1.01


def test_a_hand_over_takes_no_longer_than_it_must() -> None:
    for way_m in (2.0, 30.0):
        found = handed_over(Place((way_m, 0.0, 5.0), ZERO3), point((0.0, 0.0, 5.0)), 0.0, LIMITS, FENCE)
        assert found is not None
        whole, lasts_s = found
        places = [whole(t) for t in np.linspace(0.0, lasts_s, 1000).tolist()]
        fastest = max(hypot(*place.velocity_enu_m_s) for place in places) / 2.0
        hardest = max(hypot(*place.acceleration_enu_m_s2) for place in places)
        assert max(fastest, hardest) == pytest.approx(1.0, abs=0.01)


def test_one_that_cannot_stay_inside_the_fence_is_none() -> None:
    flying_out = Place((59.0, 0.0, 5.0), (4.0, 0.0, 0.0))
    assert handed_over(flying_out, point((59.5, 0.0, 5.0)), 0.0, LIMITS, FENCE) is None
    assert handed_over(flying_out, point((0.0, 0.0, 5.0)), 0.0, LIMITS, ((-60.0,) * 3, (80.0,) * 3)) is not None


def test_the_box_of_a_formation_is_the_fence_less_its_slots() -> None:
    assert box_of(((-10.0, -10.0, 0.0), (10.0, 10.0, 5.0)), [(-3.0, 0.0, 0.0), (1.0, 2.0, 0.5)]) == (
        (-7.0, -10.0, 0.0),
        (9.0, 8.0, 4.5),
    )


# ---------------------------------------------------------------- a vehicle's plan


CHANGE = ReferenceChange(
    1, {"kind": "circle", "centre_enu_m": [0.0, 0.0, 2.0], "radius_m": 4.0, "period_s": 20.0}, 21.0
)
TARGET = {"kind": "target", "start_enu_m": [0.0, 0.0, 2.0], "offset_enu_m": [0.0, -2.0, 0.0]}


def plan() -> ReferencePlan:
    """That of vehicle 1 of the ring, as an agent has it."""
    scenario = load_scenario(RING)
    file = vehicle_file(scenario, reached_stand_in(scenario, 1, port_offset=0), port_offset=0)
    references = build_agent(
        AgentConfig(file, scenario.fleet, scenario.fleet.vehicles[0]), session=1
    )._formation.references
    assert references is not None
    return references


def other(flown: int, waiting: int, role: Role = Role.FOLLOWER, begun_s: float = 0.0) -> PeerPacket:
    return PeerPacket(
        2, 1, 1, 0, FlightPhase.FORMATION, role, ZERO3, ZERO3, ZERO3, 0.0, 0.0, 2, None, FlownSlot(ZERO3),
        reference=HeldReference(flown, waiting, begun_s),
    )  # fmt: skip


def told(references: ReferencePlan, change: ReferenceChange, others: Sequence[PeerPacket] = ()) -> tuple[bool, str]:
    return references.obey(change, 20.0, SLOTS, others, ZERO3)


def test_a_change_begins_at_its_time_where_all_that_may_lead_have_it() -> None:
    references = plan()
    before = references.at(21.0)
    assert told(references, CHANGE) == (True, "reference 1 begins in 1.0 s")
    assert references.held == HeldReference(0, 1)
    references.update(1.0, 20.9, SLOTS, [other(0, 1)], ())
    assert references.held == HeldReference(0, 1)
    references.update(1.1, 21.0, SLOTS, [other(0, 1)], ())
    assert references.held == HeldReference(1, 1, 21.0)
    assert references.at(21.0).position_enu_m == pytest.approx(before.position_enu_m)
    assert references.events[0].startswith("reference 0 -> 1 (hand-over of ")
    x, y, z = references.at(21.0 + 600.0).position_enu_m
    assert (hypot(x, y), z) == pytest.approx((4.0, 2.0))
    assert told(references, CHANGE) == (True, "reference 1 is known")


def test_where_one_that_may_lead_lacks_it_it_does_not_begin() -> None:
    references = plan()
    before = references.at(30.0)
    told(references, CHANGE)
    references.update(1.1, 21.0, SLOTS, [other(0, 0)], ())
    assert references.events == ["reference 1 does not begin: vehicle 2 does not have it"]
    assert references.held == HeldReference(0, 0)
    assert references.at(30.0) == before


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"number": 0}, "number 0 is not newer than 0"),
        ({"number": 1002}, "number 1002 is not newer than 0"),
        ({"begins_s": 19.0}, "begins at 19.0 s of the fleet's time, which is 20.0 s now"),
        ({"begins_s": 90.0}, "begins at 90.0 s of the fleet's time, which is 20.0 s now"),
        ({"begins_s": float("nan")}, "begins at nan s"),
        ({"reference": {}}, "command: reference"),
        ({"reference": {"kind": "point", "a\n" * 9999: 1.0}}, "unknown field a a a a a"),
        ({"reference": {"kind": "spiral"}}, "command: reference.kind: 'spiral': expected one of circle, figure_8"),
        ({"reference": CHANGE.reference | {"radius": 4.0}}, 'command: reference.radius: unknown key; did you mean "radius_m"?'),
        ({"reference": CHANGE.reference | {"radius_m": float("inf")}}, "command: reference.radius_m: inf is not a finite"),
        ({"reference": CHANGE.reference | {"radius_m": 99.5}}, "puts vehicle 1 at x = 100.5 m, outside the fence"),
        ({"reference": CHANGE.reference | {"period_s": 5.0}}, "command: reference.period_s: 5 s with ramp_s 5 asks for"),
        ({"reference": TARGET | {"max_speed_m_s": 26.0}}, "reference.max_speed_m_s: 26 asks for 26.0 m/s, peers.max_speed"),
        ({"reference": TARGET | {"max_speed_m_s": 0.01}}, "the fleet is too fast or too near the fence"),
        ({"reference": TARGET | {"name": "a/b"}}, "command: reference.name: 'a/b': expected at most 41"),
    ],
)  # fmt: skip
def test_what_cannot_be_flown_is_refused_in_words_and_changes_nothing(changes: dict[str, object], words: str) -> None:
    references = plan()
    before = references.at(30.0)
    accepted, reason = told(references, replace(CHANGE, **changes))
    assert not accepted
    assert reason.startswith("reference: ")
    assert words in reason
    assert "\n" not in reason
    assert len(reason) < 320
    references.update(100.0, 30.0, SLOTS, (), ())
    assert references.held == HeldReference(0, 0)
    assert references.at(30.0) == before


def test_the_slots_that_are_flown_count_for_the_fence_and_not_the_file_s() -> None:
    wide = SLOTS | {4: (-97.0, 0.0, 0.0)}
    accepted, reason = plan().obey(CHANGE, 20.0, wide, (), ZERO3)
    assert not accepted
    assert "puts vehicle 4 at x = -101 m, outside the fence (-100 to 100)" in reason


def test_while_one_is_still_to_begin_no_other_is_taken() -> None:
    references = plan()
    told(references, CHANGE)
    assert told(references, replace(CHANGE, number=2)) == (False, "reference: 1 is still to begin")


def test_who_missed_it_takes_up_what_the_leader_flies_and_takes_no_lead_before() -> None:
    references = plan()
    leader = other(1, 1, Role.LEADER, begun_s=3.0)
    restarted = replace(leader, phase=FlightPhase.OBSERVE)  # it says that it leads, by its file, and nobody follows
    references.update(1.0, 20.0, SLOTS, [restarted], ())
    assert references.missing(1.0) == ""
    references.update(1.0, 20.0, SLOTS, [leader], ())
    words = "vehicle 2 flies reference 1 since 3.0 s of the fleet's time, this one 0 since 0.0 s"
    assert references.missing(1.0) == words
    assert references.missing(2.5) == words  # it was heard just now: whoever takes over from it needs the same
    assert references.missing(4.0) == ""
    assert told(references, replace(CHANGE, begins_s=3.0), [leader]) == (True, "reference 1, which the leader flies")
    assert references.missing(1.0) == ""
    references.update(1.1, 20.1, SLOTS, [other(0, 1, Role.LEADER)], ())  # its packet is of before it began
    assert references.missing(1.1) == ""
    assert references.at(20.0) == along(about((0.0, 0.0, 2.0), lambda t: circle(t, 4.0, 20.0, 5.0)))(17.0)


def test_when_the_fleet_s_time_begins_anew_the_last_one_does() -> None:
    references = plan()
    told(references, CHANGE)
    references.update(1.1, 21.0, SLOTS, (), ())
    references.update(1.2, 20.99, SLOTS, (), ())  # put right
    assert references.held == HeldReference(1, 1, 21.0)
    references.update(60.0, 0.0, SLOTS, (), ())  # landed
    assert references.held == HeldReference(1, 1, 0.0)
    assert references.at(0.0).position_enu_m == pytest.approx((4.0, 0.0, 2.0))


def test_who_landed_alone_must_be_told_again_before_it_leads() -> None:
    references = plan()
    told(references, CHANGE)
    references.update(1.1, 21.0, SLOTS, (), ())
    references.update(60.0, 0.0, SLOTS, (), ())
    leader = other(1, 1, Role.LEADER, begun_s=21.0)
    references.update(90.0, 70.0, SLOTS, [leader], ())  # it hears the others again
    assert references.missing(90.0).startswith("vehicle 2 flies reference 1 since 21.0 s")
    assert references.obey(CHANGE, 70.0, SLOTS, [leader], ZERO3) == (True, "reference 1, which the leader flies")
    assert references.missing(90.0) == ""


def word(now_s: float, sequence: int) -> ReceivedTarget:
    """Something that goes east from x = 10 m at a steady 1 m/s."""
    return ReceivedTarget(now_s, "main", TargetSample(1, sequence, now_s, (1.0, 0.0, 0.0), (10.0 + now_s, 3.0, 0.3)))


def test_a_target_is_followed_from_where_the_old_one_was_and_its_silence_is_told() -> None:
    references = plan()
    before = references.at(21.0)
    told(references, ReferenceChange(1, TARGET, 21.0))
    references.update(0.0, 21.0, SLOTS, (), ())
    assert references.events.pop() == "reference 0 -> 1 (follows target main)"
    assert references.at(21.0) == before
    assert references.target_age_s is None
    for tick in range(1, 1501):
        now_s = tick * 0.02
        references.update(now_s, 21.0 + now_s, SLOTS, (), [word(now_s, tick)] if tick % 5 == 0 else ())
    assert references.events == ["target main is heard"]
    assert references.target_age_s == pytest.approx(0.0)
    assert references.at(51.0).position_enu_m == pytest.approx(
        (40.0, 1.0, 2.0), abs=0.02
    )  # 2 m south, at its own altitude
    for tick in range(1501, 1801):
        references.update(tick * 0.02, 21.0 + tick * 0.02, SLOTS, (), ())
    assert references.events[1] == "target main is silent for 1 s: the reference comes to rest"
    assert references.target_age_s == pytest.approx(6.0)
    assert references.at(57.0).velocity_enu_m_s == pytest.approx(ZERO3, abs=1e-3)
    assert references.at(57.0).position_enu_m[0] == pytest.approx(41.5, abs=0.7)


def test_while_the_fleet_s_time_stands_a_target_leads_nowhere() -> None:
    references = plan()
    told(references, ReferenceChange(1, TARGET, 21.0))
    references.update(0.0, 21.0, SLOTS, (), ())
    stood = references.at(21.0)
    for tick in range(1, 100):
        references.update(tick * 0.02, 21.0, SLOTS, (), [word(tick * 0.02, tick)])
    assert references.at(21.0) == stood
