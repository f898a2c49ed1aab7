"""From which value on the state of the vehicle raises a health flag, and for how long. The values stand here again."""

from __future__ import annotations

from math import inf, radians

import pytest
from msgspec.structs import replace

from common import slot_peer
from companion.core.consensus.peers import PeerState
from companion.core.consensus.stage import Consensus, LeadView, Neighbours, PeerSets
from companion.core.safety.failsafe import HealthLimits, fleet_flags, health_flags
from companion.core.safety.limits import OutputLimits
from companion.geometry.airspace import Fence
from companion.types.autopilot import AutopilotKind, PositionError, VehicleState
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.status import SeparationReport

F, P = HealthFlag, FlightPhase
LIMITS = HealthLimits(
    OutputLimits(radians(25.0), 2.0, 0.3, 1.6, 10.0, Fence((-50.0, -50.0, -5.0), (50.0, 50.0, 50.0))),
    low_battery_percent=25.0,
    critical_battery_percent=10.0,
)

WELL = VehicleState(
    position_time_s=0.0,
    attitude_time_s=0.0,
    mode_time_s=0.0,
    heartbeat_time_s=0.0,
    landed_time_s=0.0,
    frame_known=True,
    autopilot=AutopilotKind.PX4,
)
# Seconds without a sample, of the time that has this name.
STALE_AFTER_S = {
    "position_time_s": (F.POSITION_STALE, 0.04),
    "attitude_time_s": (F.ATTITUDE_STALE, 0.1),
    "mode_time_s": (F.MODE_STALE, 1.2),
    "heartbeat_time_s": (F.ARMED_STALE, 3.0),
    "landed_time_s": (F.LANDED_STALE, 3.0),
    "pose_time_s": (F.POSE_LOST, 0.2),
}
STAYS_FOR_S = {"pose_refused_s": (F.POSE_REFUSED, 1.0), "failsafe_s": (F.FAILSAFE_ACTIVE, 5.0)}


def at_s(now_s: float, **changes: object) -> VehicleState:
    """All samples of this time, except for what is given."""
    return replace(WELL, **dict.fromkeys((name for name in STALE_AFTER_S if name != "pose_time_s"), now_s) | changes)


def test_a_sample_is_stale_after_this_time_and_not_before() -> None:
    for name, (flag, after_s) in STALE_AFTER_S.items():
        for age_s, expected in ((after_s, set()), (1.001 * after_s, {flag})):
            assert health_flags(age_s, at_s(age_s, **{name: 0.0}), LIMITS) == expected


def test_a_cause_that_is_over_keeps_its_flag_for_this_time() -> None:
    for name, (flag, for_s) in STAYS_FOR_S.items():
        for age_s, expected in ((0.999 * for_s, {flag}), (for_s, set())):
            assert health_flags(age_s, at_s(age_s, **{name: 0.0}), LIMITS) == expected


@pytest.mark.parametrize(
    ("flag", "sound", "wrong"),
    [
        (F.GROUND_UNKNOWN, {}, {"ground_unknown": True}),
        (F.GROUND_UNKNOWN, {}, {"ground_unknown": True, "frame_known": False}),
        (F.FRAME_UNKNOWN, {}, {"frame_known": False}),
        (F.FRAME_CONTRADICTED, {}, {"frame_contradicted": True}),
        (F.POSITION_JUMPED, {"held_back_m": 5.0, "jump_time_s": 1.0}, {"held_back_m": 5.1, "jump_time_s": 1.0}),
        (F.POSITION_JUMPED, {"held_back_m": 5.1, "jump_time_s": 9.5}, {"held_back_m": 5.1, "jump_time_s": 9.499}),
        (F.OUTSIDE_FENCE, {"position_enu_m": (50.0, 50.0, 50.0)}, {"position_enu_m": (0.0, -50.1, 0.0)}),
        (F.ESTIMATOR_BAD, {"position_error": PositionError(5.0, 9.0)}, {"position_error": PositionError(5.1, 0.0)}),
        (F.ESTIMATOR_BAD, {"position_error": None}, {"position_error": None, "estimator_healthy": False}),
        (F.POSITION_UNAIDED, {}, {"position_unaided": True}),
        (F.TILT_EXCEEDED, {"roll_rad": radians(34.9)}, {"roll_rad": radians(35.1)}),
        (F.TILT_EXCEEDED, {"pitch_rad": radians(-34.9)}, {"pitch_rad": radians(-35.1)}),
        (  # 24.7 degrees about each axis are 34.4 about both, 25.3 are 35.2
            F.TILT_EXCEEDED,
            {"roll_rad": radians(24.7), "pitch_rad": radians(24.7)},
            {"roll_rad": radians(25.3), "pitch_rad": radians(25.3)},
        ),
        (F.BATTERY_LOW, {"battery_percent": 25.0}, {"battery_percent": 24.9}),
    ],
)
def test_the_value_from_which_on_the_state_raises_a_flag(
    flag: HealthFlag, sound: dict[str, object], wrong: dict[str, object]
) -> None:
    assert health_flags(10.0, at_s(10.0, **sound), LIMITS) == set()
    assert health_flags(10.0, at_s(10.0, **wrong), LIMITS) == {flag}


def test_a_charge_counts_from_zero_on_and_below_the_limits_that_are_set() -> None:
    low = {F.BATTERY_LOW}
    charges = ((-1.0, set()), (0.0, {*low, F.BATTERY_CRITICAL}), (9.9, {*low, F.BATTERY_CRITICAL}), (10.0, low))
    for percent, expected in charges:
        assert health_flags(10.0, at_s(10.0, battery_percent=percent), LIMITS) == expected
        assert health_flags(10.0, at_s(10.0, battery_percent=percent), HealthLimits(LIMITS.envelope)) == set()


def test_the_largest_error_of_a_position_is_five_metres_unless_it_is_set() -> None:
    far_off = at_s(10.0, position_error=PositionError(5.1, 0.0))
    assert health_flags(10.0, far_off, HealthLimits(LIMITS.envelope)) == {F.ESTIMATOR_BAD}
    assert health_flags(10.0, far_off, HealthLimits(LIMITS.envelope, max_position_error_m=6.0)) == set()


def test_a_vehicle_without_a_position_is_nowhere_outside_the_fence() -> None:
    state = at_s(10.0, position_time_s=-inf, position_enu_m=(99.0, 0.0, 0.0))
    assert health_flags(10.0, state, LIMITS) == {F.POSITION_STALE}


def test_a_duplicate_id_is_remembered_for_three_seconds() -> None:
    other = {4: PeerState(slot_peer(4), 0.0, 0.0, 0.0)}
    peers = PeerSets(known=other, present=other, fresh=other, duplicate_id_s=0.0)
    lead = LeadView(Role.LEADER, (0, 0), None, 0.0, None, reference_s=0.0, heading=None)
    consensus = Consensus(prc=1, lead=lead, neighbours=Neighbours(), peers=peers)
    for age_s, expected in ((2.999, {F.DUPLICATE_ID}), (3.0, set())):
        assert fleet_flags(age_s, P.HOLD, consensus, SeparationReport()) == expected
