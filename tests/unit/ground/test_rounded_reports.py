"""Formation changes that the ground computes from reports, whose slots are rounded to 0.1 mm."""

from __future__ import annotations

from math import inf, radians

from hypothesis import given
from hypothesis import strategies as st

from companion.core.formation.limits import FormationLimits
from companion.geometry.formations import SHAPES, rotated, slots_of
from companion.ground.changes import assign_slots, change_to, refusal_of
from companion.types.formation import FlownSlot
from companion.types.tick import Outbox
from companion.wire.rounding import round_outbox
from ground_fleet import reported

SPACING_M = 2.0
shapes = st.sampled_from(sorted(SHAPES))
headings_deg = st.floats(-180.0, 180.0)


@given(st.integers(2, 8), shapes, headings_deg, shapes, headings_deg, st.floats(0.2, 3.0))
def test_vehicles_accept_at_the_largest_speed_what_was_computed_from_their_reports(
    count: int, before: str, before_deg: float, after: str, after_deg: float, speed_m_s: float
) -> None:
    ids = range(1, count + 1)
    flown = dict(zip(ids, slots_of(SHAPES[before], count, SPACING_M, radians(before_deg)), strict=True))
    sent = [round_outbox(Outbox(status=reported(i, slot=FlownSlot(flown[i])))).status for i in ids]
    statuses = [status for status in sent if status]
    told = {status.agent.vehicle_id: status.formation.slot.position_enu_m for status in statuses}
    change = change_to(
        assign_slots(told, slots_of(SHAPES[after], count, SPACING_M, radians(after_deg))), statuses, speed_m_s
    )
    limits = FormationLimits(SPACING_M, speed_m_s, ((-inf, -inf, -inf), (inf, inf, inf)))
    assert limits.refusal_of_change(flown, dict(change.slots_enu_m), change.lasts_s) is None


@given(st.integers(2, 8), shapes, headings_deg, headings_deg)
def test_reported_slots_at_the_least_distance_may_be_turned(
    count: int, shape: str, before_deg: float, by_deg: float
) -> None:
    ids = range(1, count + 1)
    flown = dict(zip(ids, slots_of(SHAPES[shape], count, SPACING_M, radians(before_deg)), strict=True))
    sent = [round_outbox(Outbox(status=reported(i, slot=FlownSlot(flown[i])))).status for i in ids]
    turned = {s.agent.vehicle_id: rotated(s.formation.slot.position_enu_m, radians(by_deg), 1.0) for s in sent if s}
    assert refusal_of(turned, SPACING_M, has_height=True) is None
