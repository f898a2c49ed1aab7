"""The ground's fold over status reports."""

from __future__ import annotations

from math import inf, pi, sqrt

import pytest
from msgspec.structs import replace

from companion.ground.fleet_status import SILENT_AFTER_S, FleetState, fold, rows
from companion.types import FlightPhase, FlownSlot, Heading, LandedState, LeaderWord, Role, Status, Vector3
from companion.wire.ground import Percentiles, StatusReport, Timing

NOTHING = Percentiles(0.0, 0.0, 0.0)
TIMING = Timing(50.0, 1, 0, NOTHING, NOTHING, 5.0, 49.0)
STATUS = Status(
    vehicle_id=1,
    session=1,
    fleet="platoon",
    formation_hash=5,
    law="weighted",
    phase=FlightPhase.FORMATION,
    mode_name="OFFBOARD",
    armed=True,
    landed=LandedState.IN_AIR,
    position_enu_m=(0.0, 0.0, 1.0),
    velocity_enu_m_s=(0.0, 0.0, 0.0),
    state_age_s=0.02,
    hover_thrust_norm=0.5,
    disturbance_enu_m_s2=(0.0, 0.0, 0.0),
    role=Role.FOLLOWER,
    epoch=0,
    prc=2,
    leader_word=None,
    leader_word_age_s=None,
    neighbours=(),
    slot=FlownSlot((0.0, 0.0, 0.0)),
    reference_enu_m=None,
    flags=(),
    rejected={},
    last_event="",
)


def leader(reference_enu_m: Vector3 = (1.0, 0.0, 1.0), **changes: object) -> Status:
    changes = {"role": Role.LEADER, "prc": 1, "reference_enu_m": reference_enu_m} | changes
    return replace(STATUS, **changes)  # type: ignore[arg-type]


def follower(vehicle_id: int, **changes: object) -> Status:
    return replace(STATUS, vehicle_id=vehicle_id, **changes)  # type: ignore[arg-type]


def heard(*statuses: Status, at_s: float = 100.0, state: FleetState | None = None) -> FleetState:
    state = state or FleetState()
    for status in statuses:
        state = fold(state, StatusReport(status, TIMING), at_s)
    return state


def error_of(state: FleetState, vehicle_id: int, now_s: float = 100.1) -> float | None:
    return next(row.error_to_slot_m for row in rows(state, now_s) if row.vehicle_id == vehicle_id)


def test_nobody_heard_is_an_empty_table() -> None:
    assert rows(FleetState(), 0.0) == []


def test_the_error_is_the_distance_from_slot_and_reference_together() -> None:
    """|(x - d) - r| worked by hand: ((-1, 0.5, 1) - (-1.5, 0, 0)) - (1, 0, 1) = (-0.5, 0.5, 0)."""
    state = heard(leader(), follower(2, position_enu_m=(-1.0, 0.5, 1.0), slot=FlownSlot((-1.5, 0.0, 0.0))))
    assert error_of(state, 1) == pytest.approx(1.0)
    assert error_of(state, 2) == pytest.approx(sqrt(0.5))


def test_a_slot_turns_with_its_formation() -> None:
    """Two metres behind, to the north."""
    turned = follower(2, position_enu_m=(1.0, -2.0, 1.0), slot=FlownSlot((-2.0, 0.0, 0.0)), heading=Heading(pi / 2.0))
    assert error_of(heard(leader(), turned), 2) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("landed", "known"),
    [
        (LandedState.UNDEFINED, False),
        (LandedState.ON_GROUND, False),
        (LandedState.IN_AIR, True),
        (LandedState.TAKEOFF, True),
        (LandedState.LANDING, True),
    ],
)
def test_a_vehicle_that_does_not_fly_has_no_error(landed: LandedState, known: bool) -> None:
    assert (error_of(heard(leader(), follower(2, landed=landed)), 2) is not None) is known


def test_without_a_leader_nobody_has_an_error() -> None:
    assert error_of(heard(follower(2)), 2) is None


def test_a_silent_leader_gives_no_reference() -> None:
    state = heard(follower(2), at_s=102.0, state=heard(leader(), at_s=100.0))
    assert error_of(state, 2, now_s=102.0) is None


def test_another_fleets_leader_is_not_asked() -> None:
    assert error_of(heard(leader(fleet="other"), follower(2)), 2) is None


def test_of_two_leaders_the_one_whose_word_was_heard_is_taken() -> None:
    state = heard(
        leader((10.0, 0.0, 1.0)),
        leader((20.0, 0.0, 1.0), vehicle_id=5),
        follower(2, leader_word=LeaderWord(5, 0, 100)),
        follower(3),
        follower(4, leader_word=LeaderWord(77, 0, 100)),
    )
    assert error_of(state, 2) == pytest.approx(20.0)
    assert error_of(state, 3) == pytest.approx(10.0)
    assert error_of(state, 4) == pytest.approx(10.0)
    assert error_of(state, 5) == pytest.approx(20.0)


def test_a_silent_vehicle_is_shown_with_its_age_and_never_goes_away() -> None:
    state = heard(leader(), follower(2), at_s=100.0)
    state = heard(leader(), at_s=99_999.0, state=state)
    talking, silent = rows(state, 100_000.0)
    assert (talking.vehicle_id, talking.silent) == (1, True is False)
    assert (silent.vehicle_id, silent.silent) == (2, True)
    assert silent.age_s == pytest.approx(99_900.0)
    assert silent.error_to_slot_m is None


@pytest.mark.parametrize(("age_s", "silent"), [(0.0, False), (SILENT_AFTER_S, False), (SILENT_AFTER_S + 1e-6, True)])
def test_silence_begins_after_one_second(age_s: float, silent: bool) -> None:
    assert rows(heard(leader(), at_s=0.0), age_s)[0].silent is silent


def test_data_age_counts_what_passed_on_board() -> None:
    state = heard(leader(state_age_s=0.4), follower(2, state_age_s=inf), at_s=100.0)
    first, second = rows(state, 100.1)
    assert first.age_s == pytest.approx(0.1)
    assert first.data_age_s == pytest.approx(0.5)
    assert second.data_age_s == inf


def test_the_newest_report_counts_and_the_fold_leaves_the_old_state_alone() -> None:
    before = heard(leader())
    after = heard(leader(rejected={"malformed": 2, "another": 3}, phase=FlightPhase.LAND), state=before)
    assert rows(before, 100.0)[0].rejected == 0
    assert rows(after, 100.0)[0].rejected == 5
    assert rows(after, 100.0)[0].phase is FlightPhase.LAND
    assert len(rows(after, 100.0)) == 1


def test_rows_come_by_fleet_and_id() -> None:
    state = heard(follower(10), follower(9), leader(fleet="alpha", vehicle_id=11))
    assert [(row.fleet, row.vehicle_id) for row in rows(state, 100.0)] == [
        ("alpha", 11),
        ("platoon", 9),
        ("platoon", 10),
    ]
