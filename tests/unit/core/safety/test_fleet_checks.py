"""Checks of the fleet: altitudes on the ground, slot distances against reported position errors."""

import dataclasses
from math import radians, tan

import pytest
from msgspec.structs import replace

from common import SLOTS, code_of, slot_peer, with_fields
from companion.config.fleet import Envelope
from companion.core.safety.fleet_checks import FleetChecks, slow_to_brake
from companion.core.safety.return_check import ReturnCheck
from companion.types.autopilot import AutopilotKind, PositionError, VehicleState
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.notices import Code, Notice
from companion.types.peers import PeerPacket
from companion.types.values import GRAVITY_M_S2
from one_agent import FLEET, AgentFlight

C = CommandName
OWN = FlownSlot(SLOTS[2])
RETURNS = ReturnCheck(2, separation_m=1.0, braking_m_s2=2.0, responds_s=0.45, goes_on_s=0.55)
CHECKS = FleetChecks(2, slots_have_height=True, ground_spread_m=1.0, separation_m=1.0, returns=RETURNS)


def vehicle(z_m: float = 0.0, error: PositionError | None = None) -> VehicleState:
    return VehicleState(position_enu_m=(0.0, 0.0, z_m), position_error=error)


# ---------------------------------------------------------------- on the ground


@pytest.mark.parametrize("name", [CommandName.ARM, CommandName.TAKEOFF])
def test_takeoff_is_refused_when_altitudes_differ(name: CommandName) -> None:
    refusal, _ = CHECKS.judge(name, vehicle(0.3), OWN, [slot_peer(1, 0.0), slot_peer(3, 1.4)], Role.FOLLOWER)
    assert code_of(refusal) is Code.ALTITUDES_DIFFER
    assert "vehicle 3 is 1.4 m above vehicle 1" in refusal.text


def test_two_autopilots_with_one_id_keep_it_on_the_ground() -> None:
    (refusal,) = CHECKS.lacks(replace(vehicle(), interleaves=True), [])
    assert refusal.code is Code.AUTOPILOT_ID_SHARED


@pytest.mark.parametrize("name", [CommandName.ARM, CommandName.TAKEOFF])
@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_a_vehicle_without_the_altitude_that_its_take_off_needs_is_not_armed(
    name: CommandName, kind: AutopilotKind
) -> None:
    checks = dataclasses.replace(CHECKS, take_off_by_altitude=frozenset({AutopilotKind.PX4}))
    indoors = VehicleState(autopilot=kind, frame_known=True)
    refusal, _ = checks.judge(name, indoors, OWN, [], Role.FOLLOWER)
    if kind is AutopilotKind.ARDUPILOT:
        assert refusal is None
    else:
        assert code_of(refusal) is Code.ALTITUDE_UNKNOWN
        assert "indoors set the origin once" in refusal.text
        assert checks.lacks(indoors, []) == (refusal,)
    with_origin = VehicleState(autopilot=kind, frame_known=True, altitude_amsl_m=0.0)
    assert checks.judge(name, with_origin, OWN, [], Role.FOLLOWER) == (None, None)


@pytest.mark.parametrize(
    ("own_m", "peers"),
    [
        (0.0, []),
        (0.3, [slot_peer(1, -0.3), slot_peer(3, 0.6)]),
        (0.0, [slot_peer(1, 30.0, air=True)]),  # it flies already
    ],
)
def test_takeoff_is_accepted_when_altitudes_agree(own_m: float, peers: list[PeerPacket]) -> None:
    assert CHECKS.judge(CommandName.TAKEOFF, vehicle(own_m), OWN, peers, Role.FOLLOWER) == (None, None)


@pytest.mark.parametrize("name", [CommandName.ARM, CommandName.TAKEOFF])
@pytest.mark.parametrize("height_m", [0.0, 20.0])  # on the ground, and in the air above
def test_takeoff_is_refused_within_the_separation_of_a_peer(name: CommandName, height_m: float) -> None:
    beside = with_fields(slot_peer(3, air=height_m > 0.0), position_enu_m=(0.6, -0.5, height_m))
    refusal, _ = CHECKS.judge(name, vehicle(), OWN, [slot_peer(1), beside], Role.FOLLOWER)
    assert code_of(refusal) is Code.VEHICLE_TOO_CLOSE
    assert "vehicle 3 is 0.78 m from vehicle 2; expected at least separation_m, 1 m" in refusal.text
    assert CHECKS.lacks(vehicle(), [slot_peer(1), beside]) == (refusal,)


def test_landing_near_a_peer_is_a_warning() -> None:
    refusal, warning = CHECKS.judge(
        CommandName.LAND, vehicle(3.0), OWN, [with_fields(slot_peer(1), position_enu_m=(0.1, 0.0, 0.0))], Role.FOLLOWER
    )
    assert refusal is None
    assert code_of(warning) is Code.VEHICLE_TOO_CLOSE


# ---------------------------------------------------------------- before it forms


def judged(own_m: float | None, *others: tuple[int, float | None]) -> tuple[Notice | None, Notice | None]:
    """`own_m` and the second item of `others` are position errors, horizontal and vertical."""
    own = None if own_m is None else PositionError(own_m, own_m)
    peers = [slot_peer(i, error=None if m is None else PositionError(m, m), air=True) for i, m in others]
    return CHECKS.judge(CommandName.FORM, vehicle(error=own), OWN, peers, Role.FOLLOWER)


def test_slots_within_three_sigma_are_refused() -> None:
    refusal, _ = judged(0.6, (1, 0.01), (3, 0.6))
    assert code_of(refusal) is Code.POSITION_ERROR_LARGE
    assert refusal.text == (
        "the slots of vehicles 2 and 3 are 1.5 m apart, 2.5 sigma of their estimators' errors; expected at least 3 sigma, 1.8 m"
    )


def test_slots_within_six_sigma_are_a_warning() -> None:
    refusal, warning = judged(0.29, (1, 0.29), (3, 0.1))  # as a PX4 with GPS reports it
    assert refusal is None
    assert warning.text == (
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
def test_slot_spacing_limits_by_reported_position_error(
    spacing_m: float, fits_m: tuple[float, ...], warned_m: tuple[float, ...], refused_m: tuple[float, ...]
) -> None:
    """The table of the README: at least 3 times the reported error, better 6 times."""
    checks = FleetChecks(1, slots_have_height=True, ground_spread_m=1.0, separation_m=1.0, returns=RETURNS)
    for errors_m, wanted in ((fits_m, (False, False)), (warned_m, (False, True)), (refused_m, (True, False))):
        for error_m in errors_m:
            error = PositionError(error_m, 3.0)  # on level slots, height does not count
            other = replace(slot_peer(2, error=error, air=True), slot=FlownSlot((0.0, spacing_m, 0.0)))
            refusal, warning = checks.judge(
                CommandName.FORM, vehicle(error=error), FlownSlot(SLOTS[1]), [other], Role.FOLLOWER
            )
            assert (bool(refusal), bool(warning)) == wanted, error_m


def test_exactly_six_sigma_are_enough_and_exactly_three_are_a_warning() -> None:
    assert judged(0.25, (1, 0.25)) == (None, None)
    refusal, warning = judged(0.5, (1, 0.5))
    assert refusal is None and "3.0 sigma" in warning.text


def test_distant_slots_and_zero_errors_are_accepted() -> None:
    assert judged(0.05, (1, 0.05)) == (None, None)
    assert judged(0.0, (1, 0.0)) == (None, None)


def test_unknown_position_error_is_a_warning() -> None:
    assert judged(None, (1, 0.1)) == (
        None,
        Notice(Code.POSITION_ERROR_UNKNOWN, "no error reported by the estimator of vehicle 2"),
    )
    _, warning = judged(0.01, (1, None), (3, None))
    assert warning.text == "no error reported by the estimator of vehicle 1, 3"
    refusal, _ = judged(0.6, (1, None), (3, 0.6))
    assert "2 and 3" in refusal.text


def test_vertical_error_counts_only_when_the_law_controls_altitude() -> None:
    own = vehicle(error=PositionError(0.05, 0.6))
    above = [slot_peer(4, error=PositionError(0.05, 0.6), air=True)]
    with_height = FleetChecks(3, slots_have_height=True, ground_spread_m=1.0, separation_m=1.0, returns=RETURNS)
    assert "1.2 sigma" in with_height.judge(CommandName.FORM, own, FlownSlot(SLOTS[3]), above, Role.FOLLOWER)[0].text
    without = FleetChecks(3, slots_have_height=False, ground_spread_m=1.0, separation_m=1.0, returns=RETURNS)
    assert "0.0 sigma" in without.judge(CommandName.FORM, own, FlownSlot(SLOTS[3]), above, Role.FOLLOWER)[0].text


def test_joining_is_refused_when_peers_fly_another_formation() -> None:
    other = replace(slot_peer(1, air=True), phase=FlightPhase.FORMATION, slot=FlownSlot(SLOTS[1], formation=3))
    refusal, _ = CHECKS.judge(CommandName.FORM, vehicle(), OWN, [other], Role.FOLLOWER)
    assert code_of(refusal) is Code.FORMATION_DIFFERS
    assert refusal.text.startswith("this vehicle has formation 0, vehicle 1 flies 3")


def test_joining_is_refused_when_the_leader_has_another_formation() -> None:
    leader = replace(slot_peer(1, air=True), role=Role.LEADER, slot=FlownSlot(SLOTS[1], formation=3))
    refusal, _ = CHECKS.judge(CommandName.FORM, vehicle(), OWN, [leader, slot_peer(3, air=True)], Role.FOLLOWER)
    assert code_of(refusal) is Code.FORMATION_DIFFERS
    assert "leader 1 has 3" in refusal.text
    assert "leader 1 has 3" in CHECKS.judge(CommandName.FORM, vehicle(), OWN, [leader], Role.LEADER)[0].text
    same = with_fields(leader, vehicle_id=4, slot=FlownSlot(SLOTS[3]))
    several = [same, with_fields(leader, vehicle_id=3), leader]
    assert "leader 1 has 3" in CHECKS.judge(CommandName.FORM, vehicle(), OWN, several, Role.FOLLOWER)[0].text
    second = with_fields(leader, vehicle_id=3)  # of several the smallest id's counts
    assert CHECKS.judge(CommandName.FORM, vehicle(), OWN, [second], Role.LEADER)[0] is None
    follower = replace(leader, role=Role.FOLLOWER)
    on_ground = replace(leader, phase=FlightPhase.READY)
    formed = replace(slot_peer(3, air=True), phase=FlightPhase.FORMATION)
    for others in ([follower], [on_ground], [leader, formed]):
        assert CHECKS.judge(CommandName.FORM, vehicle(), OWN, others, Role.FOLLOWER)[0] is None


@pytest.mark.parametrize(
    "name", sorted(set(CommandName) - {C.ARM, C.TAKEOFF, C.LAND, C.RETURN, C.FORM}, key=lambda name: name.value)
)
def test_other_commands_are_not_judged(name: CommandName) -> None:
    beside = with_fields(slot_peer(1), position_enu_m=(0.1, 0.0, 9.0))
    assert CHECKS.judge(name, vehicle(), OWN, [beside], Role.LEADER) == (None, None)


def test_a_leader_that_lands_beside_another_is_warned_of_both() -> None:
    follows = replace(slot_peer(3, air=True), phase=FlightPhase.FORMATION, role=Role.FOLLOWER)
    beside = with_fields(follows, vehicle_id=4, position_enu_m=(0.6, 0.8 - 1e-9, 3.0))
    refusal, warning = CHECKS.judge(CommandName.LAND, vehicle(3.0), OWN, [follows, beside], Role.LEADER)
    assert refusal is None and warning is not None
    assert warning == Notice(
        Code.VEHICLE_TOO_CLOSE,
        "separation: in the plane vehicle 4 is 1.00 m from vehicle 2; expected at least separation_m, 1 m;"
        " no successor is in formation: without a command of their own, vehicles 3, 4 hold where they stop",
    )
    far = with_fields(beside, position_enu_m=(0.6, 0.8, 3.0))
    _, warning = CHECKS.judge(CommandName.LAND, vehicle(3.0), OWN, [far], Role.LEADER)
    assert code_of(warning) is Code.NO_SUCCESSOR
    assert warning.text.endswith("without a command of its own, vehicle 4 holds where it stops")


def test_the_nearest_counts_in_the_plane_from_wherever_the_vehicle_stands() -> None:
    own = VehicleState(position_enu_m=(3.0, -4.0, 2.0))
    near = [
        with_fields(slot_peer(i), position_enu_m=at)
        for i, at in ((1, (3.0, -3.5, 9.0)), (3, (3.4, -4.0, 0.0)), (4, (2.4, -3.3, 2.0)))
    ]
    found = CHECKS.lacks(own, near)[-1]
    assert "vehicle 3 is 0.40 m from vehicle 2" in found.text


@pytest.mark.parametrize(("own_m", "spread_m"), [(0.25, 1.0), (0.0, 1.25), (2.0, 1.75)])
def test_the_heights_of_all_on_the_ground_count_the_own_one_too(own_m: float, spread_m: float) -> None:
    peers = [
        with_fields(slot_peer(1, air=air), vehicle_id=i, position_enu_m=(9.0 * i, 9.0, z_m))
        for i, z_m, air in ((1, 0.5, False), (3, 1.25, False), (4, 7.0, True), (5, 0.25, False))
    ]
    found = CHECKS.lacks(vehicle(own_m), peers)
    if spread_m <= 1.0:
        assert found == ()
        return
    high, low = (3, 2) if own_m == 0.0 else (2, 5)
    assert found == (
        Notice(
            Code.ALTITUDES_DIFFER,
            f"altitude: on the ground vehicle {high} is {spread_m:.1f} m above vehicle {low}, more than ground_spread_m 1",
        ),
    )


def test_all_that_keeps_a_vehicle_on_the_ground_is_named_at_once() -> None:
    checks = dataclasses.replace(CHECKS, take_off_by_altitude=frozenset({AutopilotKind.PX4}))
    own = VehicleState(interleaves=True, frame_known=True, autopilot=AutopilotKind.PX4)
    beside = with_fields(slot_peer(3), position_enu_m=(0.1, 0.0, 5.0))
    found = checks.lacks(own, [beside])
    assert [notice.code for notice in found] == [
        *(Code.AUTOPILOT_ID_SHARED, Code.ALTITUDE_UNKNOWN, Code.ALTITUDES_DIFFER, Code.VEHICLE_TOO_CLOSE),
    ]
    refusal, _ = checks.judge(CommandName.ARM, own, OWN, [beside], Role.FOLLOWER)
    assert refusal == Notice(found[0].code, "; ".join(notice.text for notice in found))
    for altitude in ({"altitude_amsl_m": 0.0}, {"frame_known": False}, {"autopilot": AutopilotKind.ARDUPILOT}):
        assert Code.ALTITUDE_UNKNOWN not in [notice.code for notice in checks.lacks(replace(own, **altitude), [])]


def test_what_it_may_take_off_with_is_named_in_order() -> None:
    slow = Notice(Code.BRAKES_SLOWLY, "slow")
    checks = dataclasses.replace(CHECKS, slow_to_brake=slow)
    own = VehicleState(home_enu_m=(0.6, 0.8))
    shares = with_fields(slot_peer(3), home_enu_m=(0.0, 0.8))
    assert [notice.code for notice in checks.warnings(own, [shares])] == [
        *(Code.HOME_ELSEWHERE, Code.HOME_SHARED, Code.BRAKES_SLOWLY),
    ]
    assert "vehicles 2 and 3 have homes 0.60 m apart" in checks.warnings(own, [shares])[1].text
    assert checks.warnings(VehicleState(), [shares]) == (slow,)
    assert CHECKS.warnings(replace(own, home_enu_m=(0.6, 0.79)), [with_fields(shares, home_enu_m=(1.6, 0.79))]) == ()


def test_errors_count_along_the_line_between_the_slots() -> None:
    """Slots at (3, 0, 4): 0.6 of the horizontal error of one axis, 0.8 of the vertical one, of both vehicles."""
    own, other = PositionError(1.0, 0.3), PositionError(1.0, 0.4)
    above = replace(slot_peer(3, error=other, air=True), slot=FlownSlot((4.0, 2.0, 7.0)))
    slot = FlownSlot((1.0, 2.0, 3.0))
    _, warning = CHECKS.judge(CommandName.FORM, vehicle(error=own), slot, [above], Role.FOLLOWER)
    sigma_m = ((0.6 * 1.0) ** 2 + (0.8 * 0.5) ** 2) ** 0.5
    assert warning is None and 5.0 / sigma_m > 6.0
    tenfold = PositionError(1.3, 0.65)
    above = with_fields(above, position_error=PositionError(1.3, 0.0))
    _, warning = CHECKS.judge(CommandName.FORM, vehicle(error=tenfold), slot, [above], Role.FOLLOWER)
    sigma_m = ((0.6 * 1.3) ** 2 + (0.8 * 0.65) ** 2) ** 0.5
    assert warning is not None
    assert (
        f"5.0 m apart, {5.0 / sigma_m:.1f} sigma" in warning.text and f"6 sigma, {6.0 * sigma_m:.1f} m" in warning.text
    )


def test_slots_at_one_place_and_errors_of_nothing_are_no_division_by_zero() -> None:
    exact = PositionError(0.0, 0.0)
    same = replace(slot_peer(3, error=exact, air=True), slot=OWN)
    refusal, _ = CHECKS.judge(CommandName.FORM, vehicle(error=exact), OWN, [same], Role.FOLLOWER)
    assert refusal is not None and "0.0 m apart, 0.0 sigma" in refusal.text
    known = replace(same, position_error=PositionError(1.0, 0.5))
    refusal, _ = CHECKS.judge(CommandName.FORM, vehicle(error=exact), OWN, [known], Role.FOLLOWER)
    assert refusal is not None and refusal.text.endswith("expected at least 3 sigma, 2.1 m")  # level, one axis of two


def test_the_nearest_slots_are_warned_of_and_who_reports_no_error_is_named_besides() -> None:
    _, warning = judged(0.3, (1, 0.3), (3, None))
    assert warning is not None
    assert warning.code is Code.POSITION_ERROR_LARGE
    assert warning.text.startswith("the slots of vehicles 2 and 1 are 1.5 m apart")
    assert warning.text.endswith("; no error reported by the estimator of vehicle 3")


# ---------------------------------------------------------------- what it can brake from


def braked(margin_m: float, tilt_deg: float) -> Notice | None:
    """Of vehicle 2 of three in a line, `margin_m` farther apart than separation_m."""
    slots = {i: ((i - 1) * (1.0 + margin_m), 0.0, 0.0) for i in (1, 2, 3)}
    return slow_to_brake(2, slots, 1.0, 0.3 * GRAVITY_M_S2 * tan(radians(tilt_deg)), tilt_deg)


def test_a_vehicle_with_little_tilt_says_from_which_speed_it_can_brake() -> None:
    warning = braked(1.0, 5.0)
    assert warning is not None
    assert warning.code is Code.BRAKES_SLOWLY
    assert warning.text == (
        "braking: with max_tilt_deg 5 vehicle 2 brakes by 0.26 m/s^2, and within the 1.00 m that its slot and that of"
        " vehicle 1 are farther apart than separation_m from 0.72 m/s; one that comes faster, as under a pilot, comes"
        " nearer; for 1 m/s slots 2.94 m apart, or more tilt"
    )


@pytest.mark.parametrize(
    ("margin_m", "tilt_deg", "warned"),
    [(0.5, 25.0, False), (0.2, 25.0, True), (1.0, 10.0, False), (1.0, 9.0, True), (2.0, 5.0, False), (2.0, 4.0, True)],
)
def test_little_tilt_needs_slots_that_are_far_apart(margin_m: float, tilt_deg: float, warned: bool) -> None:
    assert (braked(margin_m, tilt_deg) is not None) is warned


def test_it_brakes_for_the_nearest_slot_from_a_metre_a_second_on() -> None:
    slots = {1: (9.0, 0.0, 0.0), 2: (0.0, 0.0, 0.0), 3: (0.0, 2.0, 0.0), 4: (0.0, 0.0, -3.0)}
    assert slow_to_brake(2, slots, 1.0, 0.5, 3.0) is None  # within 1 m by 0.5 m/s^2 from 1 m/s
    found = slow_to_brake(2, slots, 1.0, 0.49, 3.0)
    assert found is not None and "that of vehicle 3 are" in found.text


def test_slots_at_the_separation_leave_no_speed_and_one_vehicle_needs_none() -> None:
    assert code_of(braked(0.0, 45.0)) is Code.BRAKES_SLOWLY
    assert "slots inf m apart" in str(braked(1.0, 5e-324))  # the smallest tilt that a file may hold
    assert slow_to_brake(2, {2: (0.0, 0.0, 0.0)}, 1.0, 0.1, 3.0) is None


@pytest.mark.parametrize(("tilt_deg", "warned"), [(25.0, False), (5.0, True)])
def test_a_vehicle_on_the_ground_warns_of_little_tilt(tilt_deg: float, warned: bool) -> None:
    flight = AgentFlight(fleet=replace(FLEET, envelope=Envelope(max_tilt_deg=tilt_deg)))
    status = [status for _ in range(50) if (status := flight.tick().status)][-1]
    codes = [warning.code for warning in status.safety.warnings]
    assert (Code.BRAKES_SLOWLY in codes) is warned
