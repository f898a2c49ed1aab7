"""Hand-overs between reference trajectories, and the reference plan of a vehicle that may lead."""

from __future__ import annotations

from collections.abc import Sequence
from math import dist, hypot

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from common import ROOT, code_of, codes_of, outcome
from companion.core.reference.blend import BlendLimits, along, blending, point, reference_box
from companion.core.reference.plan import ReferencePlan
from companion.core.reference.target import Box
from companion.geometry.curves import Curve, centred_at, circle, decay_to_rest, figure_8
from companion.types.commands import ReferenceChange
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, FormationState, HeldReference
from companion.types.notices import Answer, Code, Notice, accept, refuse
from companion.types.peers import LeaderReport, Motion, PeerPacket, ReceivedTarget, Sender, TargetSample
from companion.types.steps import whole
from companion.types.values import ZERO3, Vector3
from lockstep_fleet import agent_of
from sitl.flight.scenario import load_scenario

RING = ROOT / "config" / "scenarios" / "ring_figure_8.yaml"
FENCE: Box = ((-60.0, -60.0, 0.0), (60.0, 60.0, 40.0))
LIMITS = BlendLimits(2.0, 1.0, 25.0, 4.5, FENCE)
WIDE_LIMITS = BlendLimits(2.0, 1.0, 25.0, 4.5, ((-60.0,) * 3, (80.0,) * 3))
EIGHT = centred_at((0.0, 0.0, 2.0), lambda t: figure_8(t, 12.0, 6.0, 25.0, 5.0))
CIRCLE = centred_at((5.0, -8.0, 4.0), lambda t: circle(t, 6.0, 25.0, 5.0))
SLOTS = {1: (1.0, 1.0, 0.0), 2: (1.0, -1.0, 0.0), 3: (-1.0, -1.0, 0.0), 4: (-1.0, 1.0, 0.0)}

coordinates = st.floats(-30.0, 30.0)
speeds = st.floats(-2.0, 2.0)
vectors = st.tuples(coordinates, coordinates, coordinates)
small_vectors = st.tuples(speeds, speeds, speeds)


# ---------------------------------------------------------------- hand-overs


@given(vectors, small_vectors, small_vectors, st.floats(0.5, 60.0))
def test_decay_to_rest_begins_as_given_ends_at_zero_and_is_smooth(
    position: Vector3, velocity: Vector3, acceleration: Vector3, lasts_s: float
) -> None:
    delta = decay_to_rest((position, velocity, acceleration), lasts_s)
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
def test_a_hand_over_begins_at_the_old_state_and_keeps_its_limits(old: Curve, new: Curve, begins_s: float) -> None:
    before, after = along(old)(begins_s), along(new)
    found = whole(blending(before, after, begins_s, LIMITS, [ZERO3]))
    assert found is not None
    handed, lasts_s = found
    first = handed(begins_s)
    assert first.position_enu_m == pytest.approx(before.position_enu_m)
    assert first.velocity_enu_m_s == pytest.approx(before.velocity_enu_m_s)
    assert first.acceleration_enu_m_s2 == pytest.approx(before.acceleration_enu_m_s2)
    later = after(lasts_s + 3.0)
    assert handed(begins_s + lasts_s + 3.0).position_enu_m == pytest.approx(later.position_enu_m)
    assert handed(begins_s + lasts_s + 3.0).velocity_enu_m_s == pytest.approx(later.velocity_enu_m_s)
    had_m_s, had_m_s2 = hypot(*before.velocity_enu_m_s), hypot(*before.acceleration_enu_m_s2)
    for t in np.linspace(0.0, lasts_s, 500).tolist():
        with_it, without = handed(begins_s + t), after(t)
        assert dist(with_it.velocity_enu_m_s, without.velocity_enu_m_s) <= (2.0 + had_m_s) * 1.01
        assert dist(with_it.acceleration_enu_m_s2, without.acceleration_enu_m_s2) <= (1.0 + had_m_s2) * 1.01


def test_a_hand_over_is_as_fast_as_its_limits_allow() -> None:
    for distance_m in (2.0, 30.0):
        found = whole(
            blending(FormationState((distance_m, 0.0, 5.0), ZERO3), point((0.0, 0.0, 5.0)), 0.0, LIMITS, [ZERO3])
        )
        assert found is not None
        handed, lasts_s = found
        states = [handed(t) for t in np.linspace(0.0, lasts_s, 1000).tolist()]
        fastest = max(hypot(*state.velocity_enu_m_s) for state in states) / 2.0
        hardest = max(hypot(*state.acceleration_enu_m_s2) for state in states)
        assert max(fastest, hardest) == pytest.approx(1.0, abs=0.01)


def test_no_hand_over_is_found_when_the_fence_would_be_left() -> None:
    flying_out = FormationState((59.0, 0.0, 5.0), (4.0, 0.0, 0.0))
    assert whole(blending(flying_out, point((59.5, 0.0, 5.0)), 0.0, LIMITS, [ZERO3])) is None
    assert whole(blending(flying_out, point((0.0, 0.0, 5.0)), 0.0, WIDE_LIMITS, [ZERO3])) is not None


def test_the_box_of_a_formation_is_the_fence_less_its_slots() -> None:
    assert reference_box(((-10.0, -10.0, 0.0), (10.0, 10.0, 5.0)), [(-3.0, 0.0, 0.0), (1.0, 2.0, 0.5)]) == (
        (-7.0, -10.0, 0.0),
        (9.0, 8.0, 4.5),
    )


# ---------------------------------------------------------------- reference plan of one vehicle


CHANGE = ReferenceChange(
    1, {"kind": "circle", "centre_enu_m": [0.0, 0.0, 2.0], "radius_m": 4.0, "period_s": 20.0}, 21.0
)
TARGET = {"kind": "target", "start_enu_m": [0.0, 0.0, 2.0], "offset_enu_m": [0.0, -2.0, 0.0]}


def plan() -> ReferencePlan:
    """The plan of vehicle 1 of the ring, as its agent holds it."""
    scenario = load_scenario(RING, ["fleet.law.name=cooperative"])
    references = agent_of(scenario, 1, session=1).guidance.references
    assert references is not None
    return references


def other(flown: int, waiting: int, role: Role = Role.FOLLOWER, begun_s: float = 0.0) -> PeerPacket:
    return PeerPacket(
        sender=Sender(vehicle_id=2, session=1, sequence=1, formation_hash=0),
        phase=FlightPhase.FORMATION,
        role=role,
        motion=Motion(
            position_enu_m=ZERO3, velocity_enu_m_s=ZERO3, acceleration_enu_m_s2=ZERO3, state_age_s=0.0, sent_s=0.0
        ),
        leader=LeaderReport(prc=2, beacon=None),
        slot=FlownSlot(ZERO3),
        reference=HeldReference(flown, waiting, begun_s),
    )


def commanded(references: ReferencePlan, change: ReferenceChange, others: Sequence[PeerPacket] = ()) -> Answer:
    return references.judge(change, 20.0, SLOTS, others, ZERO3)[0].carried_out()


def test_a_command_replaces_a_reference_whose_number_was_too_far_ahead() -> None:
    references = plan()
    assert commanded(references, replace(CHANGE, number=1000)).accepted
    references.update(1.1, 21.0, SLOTS, [other(0, 1000)], ())
    assert references.held.flown == 1000
    again = replace(CHANGE, number=1000, begins_s=40.0)
    assert commanded(references, again).notice.code is Code.CHANGE_TOO_OLD
    assert commanded(references, CHANGE).accepted
    assert references.held.waiting == 1


def test_a_change_begins_at_its_time_when_all_peers_that_may_lead_hold_it() -> None:
    references = plan()
    before = references.at(21.0)
    assert commanded(references, CHANGE) == accept(Code.REFERENCE_ACCEPTED, "reference 1 begins in 1.0 s")
    assert references.held == HeldReference(0, 1)
    references.update(1.0, 20.9, SLOTS, [other(0, 1)], ())
    assert references.held == HeldReference(0, 1)
    (event,) = references.update(1.1, 21.0, SLOTS, [other(0, 1)], ())
    assert references.held == HeldReference(1, 1, 21.0)
    assert references.at(21.0).position_enu_m == pytest.approx(before.position_enu_m)
    assert event.text.startswith("reference 0 -> 1 (hand-over of ")
    x, y, z = references.at(21.0 + 600.0).position_enu_m
    assert (hypot(x, y), z) == pytest.approx((4.0, 2.0))
    assert outcome(commanded(references, CHANGE)) == (True, Code.REFERENCE_KNOWN)


def test_a_change_is_cancelled_when_a_peer_that_may_lead_lacks_it() -> None:
    references = plan()
    before = references.at(30.0)
    commanded(references, CHANGE)
    text = "reference 1 does not begin: vehicle 2 does not have it"
    events = references.update(1.1, 21.0, SLOTS, [other(0, 0)], ())
    assert events == (Notice(Code.REFERENCE_CANCELLED, text),)
    assert references.held == HeldReference(0, 0)
    assert references.at(30.0) == before


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"number": 0}, "number 0 is not newer than 0"),
        ({"number": 1002}, "number 1002 is too far ahead of 0"),
        ({"begins_s": 19.0}, "begins at mission time 19.0 s, which is 20.0 s now"),
        ({"begins_s": 90.0}, "begins at mission time 90.0 s, which is 20.0 s now"),
        ({"begins_s": float("nan")}, "begins at mission time nan s"),
        ({"reference": {}}, "command: reference"),
        ({"reference": {"kind": "point", "a\n" * 9999: 1.0}}, "command: reference.a"),
        ({"reference": {"kind": "spiral"}}, "command: reference.kind: 'spiral': expected one of circle, figure_8"),
        ({"reference": CHANGE.reference | {"radius": 4.0}}, 'command: reference.radius: unknown key; did you mean "radius_m"?'),
        ({"reference": CHANGE.reference | {"radius_m": float("inf")}}, "command: reference.radius_m: inf is not a finite"),
        ({"reference": CHANGE.reference | {"radius_m": 99.5}}, "puts vehicle 1 at x = 100.5 m, outside the fence"),
        ({"reference": CHANGE.reference | {"period_s": 5.0}}, "command: reference.period_s: 5 s with ramp_s 5 asks for"),
        ({"reference": TARGET | {"max_speed_m_s": 26.0}}, "reference.max_speed_m_s: 26 asks for 26.0 m/s, envelope.max_speed"),
        ({"reference": TARGET | {"max_speed_m_s": 0.01}}, "the fleet is too fast, or too near the fence or an obstacle"),
        ({"reference": TARGET | {"name": "a/b"}}, "command: reference.name: 'a/b': expected at most 41"),
    ],
)  # fmt: skip
def test_a_reference_that_cannot_be_flown_is_refused_with_the_reason(changes: dict[str, object], text: str) -> None:
    references = plan()
    before = references.at(30.0)
    ok, notice = commanded(references, replace(CHANGE, **changes))
    reason = notice.text
    assert not ok
    assert reason.startswith("reference: ")
    assert text in reason
    assert "\n" not in reason
    assert len(reason) < 320
    references.update(100.0, 30.0, SLOTS, (), ())
    assert references.held == HeldReference(0, 0)
    assert references.at(30.0) == before


def test_the_fence_is_checked_with_the_slots_flown_not_the_configured_ones() -> None:
    wide = SLOTS | {4: (-97.0, 0.0, 0.0)}
    answer = plan().judge(CHANGE, 20.0, wide, (), ZERO3)[0].carried_out()
    assert outcome(answer) == (False, Code.REFERENCE_INVALID)
    assert "puts vehicle 4 at x = -101 m, outside the fence less clearance_m (-99.5 to 99.5)" in answer.notice.text


@pytest.mark.parametrize("number", [1, 2])
def test_a_command_replaces_a_reference_that_waits(number: int) -> None:
    """A wrong one may wait for a minute, and in hold until the fleet forms."""
    references = plan()
    commanded(references, replace(CHANGE, begins_s=80.0))
    assert commanded(references, replace(CHANGE, number=number)).accepted
    references.update(1.1, 21.0, SLOTS, [other(0, number)], ())
    assert references.held == HeldReference(number, number, 21.0)


def test_a_reference_that_is_about_to_begin_is_not_replaced() -> None:
    """Else one vehicle may begin it and another one not, and both begin the next one from there."""
    references = plan()
    commanded(references, CHANGE)
    late = replace(CHANGE, number=2, begins_s=23.0)
    answer = references.judge(late, 20.6, SLOTS, (), ZERO3, in_formation=True)[0].carried_out()
    assert answer == refuse(Code.CHANGE_IN_PROGRESS, "reference: 1 is about to begin")
    assert references.judge(late, 20.4, SLOTS, (), ZERO3, in_formation=True)[0].carried_out().accepted


def test_a_vehicle_that_missed_a_change_must_not_lead_until_it_adopts_the_leader_s_rft() -> None:
    references = plan()
    leader = other(1, 1, Role.LEADER, begun_s=3.0)
    restarted = replace(leader, phase=FlightPhase.OBSERVE)  # leader by its file only, without followers
    references.update(1.0, 20.0, SLOTS, [restarted], ())
    assert references.missing(1.0) is None
    references.update(1.0, 20.0, SLOTS, [leader], ())
    assert code_of(references.missing(1.0)) is Code.REFERENCE_DIFFERS
    assert code_of(references.missing(2.5)) is Code.REFERENCE_DIFFERS  # its successor needs the same
    assert references.missing(4.0) is None
    assert commanded(references, replace(CHANGE, begins_s=3.0), [leader]).notice.code is Code.REFERENCE_ACCEPTED
    assert references.missing(1.0) is None
    references.update(1.1, 20.1, SLOTS, [other(0, 1, Role.LEADER)], ())  # a packet from before the change began
    assert references.missing(1.1) is None
    assert references.at(20.0) == along(centred_at((0.0, 0.0, 2.0), lambda t: circle(t, 4.0, 20.0, 5.0)))(17.0)


def test_the_last_rft_restarts_with_mission_time() -> None:
    references = plan()
    commanded(references, CHANGE)
    references.update(1.1, 21.0, SLOTS, (), ())
    references.update(1.2, 20.99, SLOTS, (), ())  # corrected
    assert references.held == HeldReference(1, 1, 21.0)
    references.update(60.0, 0.0, SLOTS, (), ())  # landed
    assert references.held == HeldReference(1, 1, 0.0)
    assert references.at(0.0).position_enu_m == pytest.approx((4.0, 0.0, 2.0))


def test_a_vehicle_that_landed_alone_needs_the_change_again_before_it_leads() -> None:
    references = plan()
    commanded(references, CHANGE)
    references.update(1.1, 21.0, SLOTS, (), ())
    references.update(60.0, 0.0, SLOTS, (), ())
    leader = other(1, 1, Role.LEADER, begun_s=21.0)
    references.update(90.0, 70.0, SLOTS, [leader], ())  # its packets arrive again
    assert "vehicle 2 flies reference 1 since mission time 21.0 s" in references.missing(90.0).text
    assert references.judge(CHANGE, 70.0, SLOTS, [leader], ZERO3)[0].carried_out().accepted
    assert references.missing(90.0) is None


def sample(now_s: float, sequence: int) -> ReceivedTarget:
    """A target that moves east from x = 10 m at a steady 1 m/s."""
    return ReceivedTarget(now_s, "main", TargetSample(1, sequence, now_s, (1.0, 0.0, 0.0), (10.0 + now_s, 3.0, 0.3)))


def test_a_target_is_followed_from_the_old_rft_and_its_silence_is_reported() -> None:
    references = plan()
    before = references.at(21.0)
    commanded(references, ReferenceChange(1, TARGET, 21.0))
    (event,) = references.update(0.0, 21.0, SLOTS, (), ())
    assert event == Notice(Code.REFERENCE_CHANGED, "reference 0 -> 1 (follows target main)")
    assert references.at(21.0) == before
    assert references.target_age_s is None
    events: list[Notice] = []
    for tick in range(1, 1501):
        now_s = tick * 0.02
        events += references.update(now_s, 21.0 + now_s, SLOTS, (), [sample(now_s, tick)] if tick % 5 == 0 else ())
    assert codes_of(events) == [Code.TARGET_RECEIVED]
    assert references.target_age_s == pytest.approx(0.0)
    assert references.at(51.0).position_enu_m == pytest.approx(
        (40.0, 1.0, 2.0), abs=0.02
    )  # 2 m south, at its own altitude
    for tick in range(1501, 1801):
        events += references.update(tick * 0.02, 21.0 + tick * 0.02, SLOTS, (), ())
    assert codes_of(events) == [Code.TARGET_RECEIVED, Code.TARGET_LOST]
    assert references.target_age_s == pytest.approx(6.0)
    assert references.at(57.0).velocity_enu_m_s == pytest.approx(ZERO3, abs=1e-3)
    assert references.at(57.0).position_enu_m[0] == pytest.approx(41.5, abs=0.7)


def test_r_stays_while_mission_time_is_stopped() -> None:
    references = plan()
    commanded(references, ReferenceChange(1, TARGET, 21.0))
    references.update(0.0, 21.0, SLOTS, (), ())
    stood = references.at(21.0)
    for tick in range(1, 100):
        references.update(tick * 0.02, 21.0, SLOTS, (), [sample(tick * 0.02, tick)])
    assert references.at(21.0) == stood
