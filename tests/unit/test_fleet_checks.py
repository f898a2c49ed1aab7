"""The fleet as a whole: altitudes on the ground, and slots against what the estimators say of themselves."""

from dataclasses import replace as replaced

import pytest
from msgspec.structs import replace

from companion.core.fleet_checks import FleetChecks
from companion.types import (
    CommandName,
    FlightPhase,
    FlownSlot,
    PeerPacket,
    PositionError,
    Role,
    Vector3,
    VehicleState,
)

SLOTS: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (-1.5, 0.0, 0.0), 3: (-3.0, 0.0, 0.0), 4: (-3.0, 0.0, 1.0)}
OWN = FlownSlot(SLOTS[2])
CHECKS = FleetChecks(2, slots_have_height=True, ground_spread_m=1.0, separation_m=1.0)


def peer(vehicle_id: int, z_m: float = 0.0, error: PositionError | None = None, air: bool = False) -> PeerPacket:
    phase = FlightPhase.HOLD if air else FlightPhase.READY
    at, zero = (3.0 * vehicle_id - 6.0, 0.0, z_m), (0.0, 0.0, 0.0)
    return PeerPacket(
        vehicle_id,
        1,
        1,
        0,
        phase,
        Role.FOLLOWER,
        at,
        zero,
        zero,
        0.0,
        0.0,
        2,
        None,
        FlownSlot(SLOTS[vehicle_id]),
        error,
    )


def vehicle(z_m: float = 0.0, error: PositionError | None = None) -> VehicleState:
    return VehicleState(position_enu_m=(0.0, 0.0, z_m), position_error=error)


# ---------------------------------------------------------------- on the ground


@pytest.mark.parametrize("name", [CommandName.ARM, CommandName.TAKEOFF])
def test_altitudes_that_differ_keep_the_fleet_on_the_ground(name: CommandName) -> None:
    refusal, _ = CHECKS.judge(name, vehicle(0.3), OWN, [peer(1, 0.0), peer(3, 1.4)], Role.FOLLOWER)
    assert refusal == "altitude: on the ground vehicle 3 is 1.4 m above vehicle 1, more than ground_spread_m 1"


@pytest.mark.parametrize(
    ("own_m", "peers"),
    [
        (0.0, []),
        (0.3, [peer(1, -0.3), peer(3, 0.6)]),
        (0.0, [peer(1, 30.0, air=True)]),  # it flies already
    ],
)
def test_altitudes_that_agree_let_it_take_off(own_m: float, peers: list[PeerPacket]) -> None:
    assert CHECKS.judge(CommandName.TAKEOFF, vehicle(own_m), OWN, peers, Role.FOLLOWER) == ("", "")


@pytest.mark.parametrize("name", [CommandName.ARM, CommandName.TAKEOFF])
@pytest.mark.parametrize("height_m", [0.0, 20.0])  # one that flies there is in the way, too
def test_nobody_takes_off_nearer_to_another_than_the_fleets_separation(name: CommandName, height_m: float) -> None:
    beside = replace(peer(3, air=height_m > 0.0), position_enu_m=(0.6, -0.5, height_m))
    refusal, _ = CHECKS.judge(name, vehicle(), OWN, [peer(1), beside], Role.FOLLOWER)
    assert refusal == (
        "separation: in the plane vehicle 3 is 0.78 m from vehicle 2; expected at least separation_m, 1 m"
    )
    assert CHECKS.lacks(vehicle(), [peer(1), beside]) == (refusal,)


def test_landing_near_another_is_warned_of_and_never_refused() -> None:
    refusal, warning = CHECKS.judge(
        CommandName.LAND, vehicle(3.0), OWN, [replace(peer(1), position_enu_m=(0.1, 0.0, 0.0))], Role.FOLLOWER
    )
    assert refusal == ""
    assert "in the plane vehicle 1 is 0.10 m from vehicle 2" in warning


# ---------------------------------------------------------------- before it forms


def judged(own_m: float | None, *others: tuple[int, float | None]) -> tuple[str, str]:
    """`own_m` and the second of `others` are errors, the same in the plane and in height."""
    own = None if own_m is None else PositionError(own_m, own_m)
    heard = [peer(i, error=None if m is None else PositionError(m, m), air=True) for i, m in others]
    return CHECKS.judge(CommandName.FORM, vehicle(error=own), OWN, heard, Role.FOLLOWER)


def test_slots_within_three_sigma_are_refused() -> None:
    refusal, _ = judged(0.6, (1, 0.01), (3, 0.6))
    assert refusal == (
        "the slots of vehicles 2 and 3 are 1.5 m apart, 2.5 sigma of their estimators' errors; expected at least 3 sigma, 1.8 m"
    )


def test_slots_within_six_sigma_are_warned_of() -> None:
    refusal, warning = judged(0.29, (1, 0.29), (3, 0.1))  # as a PX4 with GPS reports it
    assert refusal == ""
    assert warning == (
        "the slots of vehicles 2 and 1 are 1.5 m apart, 5.2 sigma of their estimators' errors; better 6 sigma, 1.7 m"
    )


@pytest.mark.parametrize(
    ("spacing_m", "fits_m", "warned_m", "refused_m"),
    [
        (1.5, (0.02, 0.1, 0.24), (0.3, 0.49), (0.51, 0.8, 2.0)),
        (3.0, (0.3, 0.49), (0.51, 0.8, 0.99), (1.01, 1.2, 2.0)),
        (5.0, (0.3, 0.5, 0.8), (0.84, 1.2, 1.6), (1.7, 2.0)),
    ],
)
def test_what_a_receiver_reports_says_how_close_it_may_fly(
    spacing_m: float, fits_m: tuple[float, ...], warned_m: tuple[float, ...], refused_m: tuple[float, ...]
) -> None:
    """The table of the README: 3 times the reported error at the least, better 6 times."""
    checks = FleetChecks(1, slots_have_height=True, ground_spread_m=1.0, separation_m=1.0)
    for errors_m, wanted in ((fits_m, (False, False)), (warned_m, (False, True)), (refused_m, (True, False))):
        for error_m in errors_m:
            error = PositionError(error_m, 3.0)  # on level slots, height does not count
            other = replace(peer(2, error=error, air=True), slot=FlownSlot((0.0, spacing_m, 0.0)))
            refusal, warning = checks.judge(
                CommandName.FORM, vehicle(error=error), FlownSlot(SLOTS[1]), [other], Role.FOLLOWER
            )
            assert (bool(refusal), bool(warning)) == wanted, error_m


def test_slots_far_apart_and_errors_of_nothing_are_left_alone() -> None:
    assert judged(0.05, (1, 0.05)) == ("", "")
    assert judged(0.0, (1, 0.0)) == ("", "")


def test_an_estimator_that_says_nothing_is_told_of() -> None:
    assert judged(None, (1, 0.1)) == ("", "no error reported by the estimator of vehicle 2")
    assert judged(0.01, (1, None), (3, None)) == ("", "no error reported by the estimator of vehicle 1, 3")
    refusal, _ = judged(0.6, (1, None), (3, 0.6))
    assert "2 and 3" in refusal


def test_height_counts_where_the_law_flies_it_and_only_there() -> None:
    own = vehicle(error=PositionError(0.05, 0.6))
    above = [peer(4, error=PositionError(0.05, 0.6), air=True)]
    with_height = FleetChecks(3, slots_have_height=True, ground_spread_m=1.0, separation_m=1.0)
    assert "1.2 sigma" in with_height.judge(CommandName.FORM, own, FlownSlot(SLOTS[3]), above, Role.FOLLOWER)[0]
    without = FleetChecks(3, slots_have_height=False, ground_spread_m=1.0, separation_m=1.0)
    assert "0.0 sigma" in without.judge(CommandName.FORM, own, FlownSlot(SLOTS[3]), above, Role.FOLLOWER)[0]


def test_a_vehicle_does_not_join_those_that_fly_another_formation() -> None:
    other = replace(peer(1, air=True), phase=FlightPhase.FORMATION, slot=FlownSlot(SLOTS[1], formation=3))
    refusal, _ = CHECKS.judge(CommandName.FORM, vehicle(), OWN, [other], Role.FOLLOWER)
    assert refusal == "this vehicle flies formation 0, vehicle 1 flies 3; give this one that formation first"


def test_of_all_that_form_at_once_nobody_flies_another_formation_than_who_leads() -> None:
    leader = replace(peer(1, air=True), role=Role.LEADER, slot=FlownSlot(SLOTS[1], formation=3))
    refusal, _ = CHECKS.judge(CommandName.FORM, vehicle(), OWN, [leader, peer(3, air=True)], Role.FOLLOWER)
    assert refusal == (
        "this vehicle flies formation 0, vehicle 1, which leads, 3; form that one alone first, and this one takes over its"
        " formation"
    )
    assert "vehicle 1, which leads" in CHECKS.judge(CommandName.FORM, vehicle(), OWN, [leader], Role.LEADER)[0]
    second = replace(leader, vehicle_id=3)  # of several the smallest id's counts
    assert CHECKS.judge(CommandName.FORM, vehicle(), OWN, [second], Role.LEADER)[0] == ""
    follower = replace(leader, role=Role.FOLLOWER)
    stands = replace(leader, phase=FlightPhase.READY)
    formed = replace(peer(3, air=True), phase=FlightPhase.FORMATION)
    for others in ([follower], [stands], [leader, formed]):
        assert CHECKS.judge(CommandName.FORM, vehicle(), OWN, others, Role.FOLLOWER)[0] == ""


# ---------------------------------------------------------------- ways into the slots


def holding(vehicle_id: int, at: Vector3, phase: FlightPhase = FlightPhase.HOLD) -> PeerPacket:
    return replace(peer(vehicle_id, air=True), position_enu_m=at, phase=phase)


def refusal_from(own_at: Vector3, *peers: PeerPacket, checks: FleetChecks = CHECKS) -> str:
    return checks.refusal_to_form_together(VehicleState(position_enu_m=own_at), OWN, peers)


def test_ways_that_cross_are_refused_and_say_what_to_do() -> None:
    refusal = refusal_from((20.0, 0.0, 2.0), holding(1, (18.5, 0.2, 2.0)), holding(3, (17.0, 0.0, 2.0)))
    assert refusal.startswith("on straight ways into their slots vehicles 2 and 1 come within 0.1")
    assert "expected at least separation_m, 1 m; land, and give a formation command there" in refusal


def test_who_stands_like_the_slots_may_form_wherever_the_fleet_is() -> None:
    assert refusal_from((98.5, 7.0, 2.0), holding(1, (100.0, 7.0, 2.0)), holding(3, (97.0, 7.3, 2.0))) == ""


@pytest.mark.parametrize("phase", [FlightPhase.OBSERVE, FlightPhase.LAND, FlightPhase.RETURN, FlightPhase.READY])
def test_who_does_not_form_has_no_way_into_a_slot(phase: FlightPhase) -> None:
    assert refusal_from((20.0, 0.0, 2.0), holding(1, (18.5, 0.2, 2.0), phase)) == ""


def test_slots_nearer_than_the_separation_are_another_matter() -> None:
    far = replaced(CHECKS, separation_m=1.6)
    assert refusal_from((-1.5, 0.0, 2.0), holding(1, (0.0, 0.0, 2.0)), checks=far) == ""


def test_where_slots_have_no_height_ways_cross_in_the_plane() -> None:
    above = holding(1, (18.5, 0.0, 6.0))
    assert refusal_from((20.0, 0.0, 2.0), above) == ""
    assert "vehicles 2 and 1" in refusal_from((20.0, 0.0, 2.0), above, checks=replaced(CHECKS, slots_have_height=False))
