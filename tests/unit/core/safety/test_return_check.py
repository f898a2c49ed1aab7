"""The command `return`: separation of return paths, mode request, end of the return."""

import dataclasses
from math import dist

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from common import SLOTS, code_of, outcome, slot_peer, with_fields
from companion.core.command.phase import PhaseMachine
from companion.core.consensus.peers import PeerState
from companion.core.safety.fleet_checks import FleetChecks
from companion.core.safety.return_check import Path, ReturnCheck, apart, home_elsewhere, home_shared
from companion.geometry.frames import enu_from_geodetic
from companion.types.autopilot import (
    AckSample,
    AutopilotMode,
    HomeSample,
    LandedState,
    PositionError,
    RallySample,
    SetMode,
    VehicleState,
)
from companion.types.commands import CommandName
from companion.types.flight import RULES, FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.notices import Answer, Code, Notice
from companion.types.peers import PeerPacket
from companion.types.status import Status
from companion.types.values import Vector3
from one_agent import AIR, ORIGIN, AgentFlight, ImmediateAutopilot, flown_to, levelled, tick

P, M, C = FlightPhase, AutopilotMode, CommandName
RETURNS = ReturnCheck(2, separation_m=1.0, braking_m_s2=2.0, responds_s=0.45, goes_on_s=0.55)


# ---------------------------------------------------------------- paths


@pytest.mark.parametrize(
    ("a", "b", "apart_m"),
    [
        (((0.0, 0.0), (10.0, 0.0)), ((5.0, -1.0), (5.0, 1.0)), 0.0),  # across
        (((0.0, 0.0), (10.0, 0.0)), ((3.0, 2.0), (7.0, 2.0)), 2.0),  # side by side
        (((0.0, 0.0), (10.0, 0.0)), ((10.0, 0.0), (10.0, 5.0)), 0.0),  # an end touches
        (((0.0, 0.0), (10.0, 0.0)), ((4.0, 0.0), (14.0, 0.0)), 0.0),  # along the same line
        (((0.0, 0.0), (10.0, 0.0)), ((13.0, 4.0), (20.0, 4.0)), 5.0),
        (((0.0, 0.0), (0.0, 0.0)), ((3.0, 4.0), (3.0, 4.0)), 5.0),  # both hover above home
        (((0.0, 0.0), (10.0, 0.0)), ((5.0, 3.0), (5.0, 3.0)), 3.0),  # one hovers beside the path
        (((0.0, 0.0), (10.0, 10.0)), ((6.0, 0.0), (6.0, 5.0)), 0.5**0.5),  # ends before the other path
        (((0.0, 0.0), (4.0, 0.0)), ((4.5, -2.0), (4.5, 2.0)), 0.5),  # its line is crossed beyond its end
        (((0.0, 0.0), (4.0, 0.0)), ((1.0, 0.01), (3.0, 0.5)), 0.01),  # nearly touches
        (((0.5, 0.5), (0.5, 0.5)), ((1.5, 0.5), (0.6, 0.5)), 0.1),
        (((2.0, 0.1), (2.0, 0.3)), ((0.0, 0.0), (4.0, 0.0)), 0.1),  # ends just before it
        (((0.0, 0.0), (10.0, 0.0)), ((5.0, 3.0), (5.0, 0.0)), 0.0),  # an end touches in the middle
        (((0.0, 0.0), (0.8, 0.0)), ((0.4, 2.0), (0.4, 2.0)), 2.0),  # a short path
    ],
)
def test_smallest_distance_of_two_paths(a: Path, b: Path, apart_m: float) -> None:
    for one, other in ((a, b), (b, a), (a[::-1], b), (a, b[::-1])):
        assert apart(one, other) == pytest.approx(apart_m, abs=1e-12)


def peer_in(phase: FlightPhase, at: Vector3) -> PeerPacket:
    return with_fields(slot_peer(1), phase=phase, position_enu_m=at)


def refusal(
    at: Vector3, home: Vector3 | None, *others: PeerPacket, peer_home: Vector3 | None = None, elsewhere: str = ""
) -> Notice | None:
    vehicle = replace(AIR, position_enu_m=at, home_enu_m=home and home[:2], returns_elsewhere=elsewhere)
    return refused(vehicle, *(with_fields(peer, home_enu_m=peer_home and peer_home[:2]) for peer in others))


def refused(vehicle: VehicleState, *others: PeerPacket, leads_alone: bool = False) -> Notice | None:
    """By vehicle 2, which brakes with 2 m/s2 and has just heard the others."""
    peers = [PeerState(peer, received_s=0.0, least_apart_s=0.0, measured_s=0.0) for peer in others]
    return RETURNS.refusal(vehicle, peers, leads_alone)


def test_separate_return_paths_are_accepted() -> None:
    assert (
        refusal((0.0, 10.0, 5.0), (0.0, 0.0, 0.0), peer_in(P.FORMATION, (3.0, 10.0, 5.0)), peer_home=(3.0, 0.0, 0.0))
        is None
    )
    assert refusal((0.0, 10.0, 5.0), (0.0, 0.0, 0.0)) is None  # no peers


def test_crossing_return_paths_are_refused_at_any_height() -> None:
    other = peer_in(P.HOLD, (3.0, 10.0, 50.0))
    assert refusal((0.0, 10.0, 5.0), (3.0, 0.0, 0.0), other, peer_home=(0.0, 0.0, 0.0)) == Notice(
        Code.RETURN_PATH_TOO_CLOSE,
        "separation: on its straight path home vehicle 2 comes within 0.00 m of vehicle 1 or of its path home; expected"
        " at least separation_m, 1 m; land instead",
    )


@pytest.mark.parametrize("phase", [P.HOLD, P.ENGAGE, P.FORMATION, P.RELEASE, P.RETURN, P.OBSERVE])
def test_return_paths_of_peers_are_checked(phase: FlightPhase) -> None:
    """The peer's return path crosses this vehicle's home; its position is far from it."""
    other, home = peer_in(phase, (0.0, -8.0, 5.0)), (0.0, 0.0, 0.0)
    assert "comes within 0.00 m" in refusal((0.0, 1.0, 5.0), home, other, peer_home=(0.0, 8.0, 0.0)).text
    assert refusal((0.0, 1.0, 5.0), home, other) is None


@pytest.mark.parametrize("phase", [P.READY, P.ARMED, P.TAKEOFF, P.LAND])
def test_only_the_position_counts_for_a_peer_that_takes_off_lands_or_is_on_the_ground(phase: FlightPhase) -> None:
    home = (0.0, 0.0, 0.0)
    assert refusal((0.0, 6.0, 5.0), home, peer_in(phase, (0.0, -8.0, 5.0)), peer_home=(0.0, 8.0, 0.0)) is None
    assert "within 0.50 m" in refusal((0.0, 6.0, 5.0), home, peer_in(phase, (0.5, 3.0, 0.0))).text


COORDINATE_M = st.floats(-4.0, 4.0) | st.sampled_from([-1.0, 0.0, 1.0, 2.0])
PLACE = st.tuples(COORDINATE_M, COORDINATE_M, st.just(5.0))


@given(PLACE, PLACE, PLACE, PLACE)
def test_every_path_within_separation_is_refused(at: Vector3, home: Vector3, other: Vector3, its_home: Vector3) -> None:
    """However the two paths lie: none is left out as too far away to be compared."""
    too_close = apart((at[:2], home[:2]), (other[:2], its_home[:2])) < 1.0
    too_close = too_close or dist(home, its_home) < 1.0
    assert (refusal(at, home, peer_in(P.HOLD, other), peer_home=its_home) is not None) is too_close


def test_return_is_refused_when_home_is_unknown() -> None:
    assert code_of(refusal((0.0, 6.0, 5.0), None)) is Code.HOME_UNKNOWN


@pytest.mark.parametrize("phase", sorted(P))
def test_homes_nearer_than_separation_m_are_refused_whatever_the_other_does(phase: FlightPhase) -> None:
    far_away = peer_in(phase, (30.0, -1.0, 5.0))
    shared = refusal((0.0, 6.0, 5.0), (0.0, 0.0, 0.0), far_away, peer_home=(0.6, 0.0, 0.0))
    assert shared == Notice(
        Code.HOME_SHARED,
        "home: the autopilots of vehicles 2 and 1 have homes 0.60 m apart; expected at least separation_m, 1 m; land"
        " instead",
    )
    assert refusal((0.0, 6.0, 5.0), (0.0, 0.0, 0.0), far_away, peer_home=(0.0, -1.0, 0.0)) is None


def test_return_is_refused_where_it_may_end_elsewhere() -> None:
    found = refusal((0.0, 6.0, 5.0), (0.0, 0.0, 0.0), elsewhere="rally points")
    assert found == Notice(Code.RETURNS_ELSEWHERE, "rally points; land instead")


# ---------------------------------------------------------------- in motion

HOMEWARD = replace(AIR, position_enu_m=(0.0, 10.0, 5.0), home_enu_m=(0.0, 0.0))
EAST = (3.0, 0.0, 0.0)


def test_the_path_home_begins_where_the_vehicle_will_have_stopped() -> None:
    beside = peer_in(P.HOLD, (3.5, 10.0, 5.0))
    assert refused(HOMEWARD, beside) is None
    moving = replace(HOMEWARD, velocity_enu_m_s=EAST)  # it stops 3.6 m to the east, above the other
    assert code_of(refused(moving, beside)) is Code.RETURN_PATH_TOO_CLOSE


def test_peers_stop_and_return_from_where_they_stop_as_well() -> None:
    comes = with_fields(peer_in(P.FORMATION, (-3.5, 10.0, 5.0)), velocity_enu_m_s=EAST, home_enu_m=(-8.0, 0.0))
    assert code_of(refused(HOMEWARD, comes)) is Code.RETURN_PATH_TOO_CLOSE
    assert refused(HOMEWARD, with_fields(comes, velocity_enu_m_s=(0.0, 0.0, 0.0))) is None
    side_by_side = replace(HOMEWARD, velocity_enu_m_s=EAST)
    assert refused(side_by_side, with_fields(comes, home_enu_m=(-3.5, 0.0))) is None


def test_a_vehicle_that_returns_stops_at_its_home_at_the_latest() -> None:
    """At 4 m/s it would need 5.8 m to stop, through the path of the other; its home is 3 m ahead."""
    near_home = with_fields(
        peer_in(P.RETURN, (-4.0, 5.0, 5.0)), velocity_enu_m_s=(4.0, 0.0, 0.0), home_enu_m=(-1.5, 5.0)
    )
    assert refused(HOMEWARD, near_home) is None
    assert code_of(refused(HOMEWARD, with_fields(near_home, phase=P.FORMATION))) is Code.RETURN_PATH_TOO_CLOSE


def test_a_vehicle_on_its_way_home_is_counted_with_the_noise_of_both() -> None:
    noisy = PositionError(0.6, 1.0)
    vehicle = replace(HOMEWARD, position_error=noisy)
    on_its_way = with_fields(peer_in(P.RETURN, (1.5, 10.0, 5.0)), home_enu_m=(1.5, 0.0), position_error=noisy)
    found = refused(vehicle, on_its_way)
    assert code_of(found) is Code.RETURN_PATH_TOO_CLOSE and "3 sigma of both positions, 1.8 m" in found.text
    assert refused(vehicle, with_fields(on_its_way, phase=P.HOLD)) is None  # it is watched
    exact = PositionError(0.05, 0.1)
    assert refused(replace(HOMEWARD, position_error=exact), with_fields(on_its_way, position_error=exact)) is None


def test_followers_of_a_leader_without_successors_stop_later() -> None:
    """They fly on until its beacon is too old."""
    vehicle = replace(HOMEWARD, velocity_enu_m_s=EAST)
    behind = with_fields(peer_in(P.FORMATION, (-2.5, 10.0, 5.0)), velocity_enu_m_s=EAST, home_enu_m=(-2.5, 0.0))
    assert refused(vehicle, behind) is None
    assert code_of(refused(vehicle, behind, leads_alone=True)) is Code.RETURN_PATH_TOO_CLOSE


@pytest.mark.parametrize("name", [C.LAND, C.RETURN])
def test_a_leader_without_successors_is_warned_before_it_leaves(name: CommandName) -> None:
    checks = FleetChecks(1, slots_have_height=True, ground_spread_m=1.0, separation_m=1.0, returns=RETURNS)
    follower = with_fields(slot_peer(2), phase=P.FORMATION, role=Role.FOLLOWER)
    slot, far = FlownSlot(SLOTS[1]), replace(HOMEWARD, position_enu_m=(0.0, 30.0, 5.0))
    refusal, warning = checks.judge(name, far, slot, [follower], Role.LEADER)
    assert (refusal, code_of(warning)) == (None, Code.NO_SUCCESSOR) and "vehicle 2 holds" in warning.text
    successor = dataclasses.replace(checks, successors=frozenset({2}))
    assert successor.judge(name, far, slot, [follower], Role.LEADER) == (None, None)
    assert checks.judge(name, far, slot, [with_fields(follower, role=Role.LEADER)], Role.LEADER) == (None, None)
    assert checks.judge(name, far, slot, [follower], Role.FOLLOWER) == (None, None)
    assert checks.judge(name, far, slot, [with_fields(follower, phase=P.HOLD)], Role.LEADER) == (None, None)


def test_the_peer_that_comes_nearest_below_what_is_expected_of_it_is_named() -> None:
    """One that already returns at 1.7 m, of whose noise 1.8 m are expected, or one in hold at 0.8 m."""
    noisy = PositionError(0.6, 1.0)
    returns = with_fields(peer_in(P.RETURN, (-1.7, 10.0, 5.0)), home_enu_m=(-1.7, 0.0), position_error=noisy)
    holds = with_fields(peer_in(P.HOLD, (0.8, 5.0, 5.0)), vehicle_id=7)
    found = refused(replace(HOMEWARD, position_error=noisy), returns, holds)
    assert found == Notice(
        Code.RETURN_PATH_TOO_CLOSE,
        "separation: on its straight path home vehicle 2 comes within 0.80 m of vehicle 7 or of its path home; expected at"
        " least separation_m, 1 m; land instead",
    )


def test_without_an_error_of_one_of_both_no_noise_is_counted() -> None:
    noisy = PositionError(0.6, 1.0)
    on_its_way = with_fields(peer_in(P.RETURN, (1.5, 10.0, 5.0)), home_enu_m=(1.5, 0.0))
    assert refused(replace(HOMEWARD, position_error=noisy), on_its_way) is None
    assert refused(HOMEWARD, with_fields(on_its_way, position_error=noisy)) is None


def test_one_that_returns_stops_at_its_home_whatever_the_direction() -> None:
    """Its stop takes 5.8 m, through the path of the other; to its home it is 3 m, obliquely."""
    for north in (1.0, -1.0):
        speed = (4.0 * 0.6, 4.0 * 0.8 * north, 0.0)
        at = (-4.0, 5.0 - 2.4 * north, 5.0)
        home = (at[0] + 3.0 * 0.6, at[1] + 3.0 * 0.8 * north)
        near_home = with_fields(peer_in(P.RETURN, at), velocity_enu_m_s=speed, home_enu_m=home)
        assert refused(HOMEWARD, near_home) is None
        assert code_of(refused(HOMEWARD, with_fields(near_home, phase=P.FORMATION))) is Code.RETURN_PATH_TOO_CLOSE
        beside = with_fields(near_home, home_enu_m=(at[0] + 3.0 * 0.8, at[1] - 3.0 * 0.6 * north))  # not on its way
        assert code_of(refused(HOMEWARD, beside)) is Code.RETURN_PATH_TOO_CLOSE


def test_exactly_the_separation_is_enough() -> None:
    beside = peer_in(P.LAND, (1.0, 5.0, 5.0))
    assert refused(HOMEWARD, beside) is None
    assert code_of(refused(HOMEWARD, with_fields(beside, position_enu_m=(0.9995, 5.0, 5.0)))) is not None
    assert (
        refusal((0.0, 6.0, 5.0), (0.0, 0.0, 0.0), peer_in(P.HOLD, (30.0, 0.0, 5.0)), peer_home=(1.0, 0.0, 0.0)) is None
    )


def test_of_several_homes_the_nearest_is_named_and_an_unknown_one_does_not_count() -> None:
    homes = {3: (0.9, 0.0), 5: (0.0, 0.4), 6: None, 8: (-0.7, 0.0)}
    peers = [with_fields(slot_peer(1), vehicle_id=i, home_enu_m=home) for i, home in homes.items()]
    found = home_shared(2, 1.0, (0.0, 0.0), peers)
    assert found is not None and "vehicles 2 and 5 have homes 0.40 m apart" in found.text
    assert home_shared(2, 0.4, (0.0, 0.0), peers) is None
    assert home_shared(2, 1.0, (0.0, 0.0), []) is None


def test_a_home_that_is_not_where_the_vehicle_stands_is_named_with_its_place() -> None:
    vehicle = VehicleState(position_enu_m=(1.0, 2.0, 3.0), home_enu_m=(4.0, -2.0))
    assert home_elsewhere(5.0, vehicle) == Notice(
        Code.HOME_ELSEWHERE, "home: the autopilot's is 5.0 m from the vehicle, at 4.0, -2.0 m; `return` ends there"
    )
    assert home_elsewhere(5.001, vehicle) is None
    assert home_elsewhere(5.0, VehicleState()) is None


def test_a_stop_lasts_the_response_and_the_braking_from_the_speed_on() -> None:
    """From 4 m/s along (0.6, 0.8): 0.45 s and 1 s, 5.8 m. The paths begin there, and at the present place."""
    vehicle = replace(HOMEWARD, velocity_enu_m_s=(2.4, 3.2, 9.0), home_enu_m=(30.0, 10.0))
    stop_m = (0.0 + 5.8 * 0.6, 10.0 + 5.8 * 0.8)
    for beyond_m, is_free in ((0.99, False), (1.01, True)):
        beyond = peer_in(
            P.LAND, (stop_m[0] - 0.1718 * beyond_m, stop_m[1] + 0.9851 * beyond_m, 5.0)
        )  # across the path home
        assert (refused(vehicle, beyond) is None) is is_free
    for behind_m, is_free in ((0.99, False), (1.01, True)):
        assert (refused(vehicle, peer_in(P.LAND, (-behind_m, 10.0, 5.0))) is None) is is_free


def test_a_leader_alone_keeps_off_where_a_follower_stops_that_flies_on_for_a_while() -> None:
    """At (1.8, 2.4) m/s a stop takes 0.45 s and 0.75 s, 3.6 m; 0.55 s later it is 1.65 m farther on."""
    vehicle = replace(HOMEWARD, position_enu_m=(0.0, -5.0, 5.0), home_enu_m=(0.0, 20.0))
    for apart_m, is_free in ((0.99, False), (1.01, True)):
        x = -apart_m - 0.6 * (3.6 + 1.65)
        follower = with_fields(peer_in(P.FORMATION, (x, 0.0, 5.0)), velocity_enu_m_s=(1.8, 2.4, 0.0))
        assert refused(vehicle, follower) is None
        assert (refused(vehicle, follower, leads_alone=True) is None) is is_free
        holds = with_fields(follower, phase=P.HOLD)
        assert refused(vehicle, holds, leads_alone=True) is None


def test_a_peer_is_where_it_has_flown_to_since_it_was_measured() -> None:
    """Until the newest of the own positions; one that was measured later stays where it was. Its stop takes 1.9 m."""
    comes = with_fields(peer_in(P.LAND, (-3.0, 5.0, 5.0)), velocity_enu_m_s=(2.0, 0.0, 0.0))
    parts = with_fields(peer_in(P.LAND, (-1.01, 5.0, 5.0)), velocity_enu_m_s=(-2.0, 0.0, 0.0))
    for packet, own_s, measured_s, is_free in (
        (comes, 0.0, 0.0, True),
        (comes, 0.04, 0.0, True),
        (comes, 0.06, 0.0, False),
        (comes, 0.06, 0.5, True),
        (parts, 0.0, 0.0, True),
        (parts, 0.0, 0.5, True),
    ):
        own, peers = replace(HOMEWARD, position_time_s=own_s), [PeerState(packet, 0.5, 0.0, measured_s)]
        assert (RETURNS.refusal(own, peers, leads_alone=False) is None) is is_free


# ---------------------------------------------------------------- phases


def returning(phase: FlightPhase = P.HOLD) -> tuple[PhaseMachine, ImmediateAutopilot, float]:
    """A phase machine whose autopilot returns, entered from this phase."""
    machine, autopilot, now_s = flown_to(phase)
    assert machine.command(C.RETURN, now_s, autopilot.state) == (True, Notice(Code.PHASE_CHANGED, "return begins"))
    if phase is P.FORMATION:
        now_s = levelled(machine, autopilot, now_s)
    else:
        autopilot.execute(tick(machine, now_s, autopilot.state, ()))
    tick(machine, now_s + 0.02, autopilot.state, ())
    assert (machine.phase, autopilot.state.mode) == (P.RETURN, M.RETURN)
    return machine, autopilot, now_s + 0.04


@pytest.mark.parametrize("phase", [P.HOLD, P.FORMATION])
def test_return_is_flown_by_the_autopilot_until_disarmed(phase: FlightPhase) -> None:
    machine, autopilot, now_s = returning(phase)
    assert not machine.streams(autopilot.state)
    for minute in range(60):
        assert tick(machine, now_s + 60.0 * minute, autopilot.state, ()) == ()
    assert machine.phase is P.RETURN
    down = replace(autopilot.state, landed=LandedState.ON_GROUND, mode=M.HOLD)  # PX4's mode changes at disarming
    tick(machine, now_s + 3600.0, down, ())
    assert machine.phase is P.RETURN
    tick(machine, now_s + 3600.2, replace(down, armed=False), ())
    assert machine.phase is P.OBSERVE
    assert machine.events[-1] == Notice(Code.PHASE_CHANGED, "return -> observe")


@pytest.mark.parametrize("phase", sorted(set(P) - RULES[C.RETURN].allowed - {P.RETURN, P.PREPARE, P.ARM, P.LAND}))
def test_return_begins_only_in_formation_or_hold(phase: FlightPhase) -> None:
    machine, autopilot, now_s = flown_to(phase)
    answer = machine.command(C.RETURN, now_s, autopilot.state)
    assert outcome(answer) == (False, Code.WRONG_PHASE)
    assert answer.notice.text.endswith(f"phase {phase}, only in engage, formation, hold, release")


def test_repeated_return_command_changes_nothing() -> None:
    machine, autopilot, now_s = returning()
    assert machine.command(C.RETURN, now_s, autopilot.state) == (
        True,
        Notice(Code.ALREADY_DONE, "return already in progress"),
    )
    assert tick(machine, now_s, autopilot.state, ()) == ()


@pytest.mark.parametrize(("name", "mode"), [(C.HOLD, M.HOLD), (C.LAND, M.LAND)])
def test_hold_and_land_end_a_return(name: CommandName, mode: AutopilotMode) -> None:
    machine, autopilot, now_s = returning()
    assert machine.command(name, now_s, autopilot.state)[0]
    for step in range(40):
        autopilot.execute(tick(machine, now_s + 0.02 * step, autopilot.state, ()))
    assert autopilot.state.mode is mode
    assert machine.phase is RULES[name].via if name is C.LAND else RULES[name].to


def test_abort_stops_a_return_except_during_the_landing() -> None:
    machine, autopilot, now_s = returning()
    descends = replace(autopilot.state, landed=LandedState.LANDING)
    assert outcome(machine.abort(now_s, descends)) == (True, Code.LANDING_CONTINUES)
    assert tick(machine, now_s, descends, ()) == ()
    assert machine.abort(now_s, autopilot.state)[0]
    for step in range(40):
        autopilot.execute(tick(machine, now_s + 0.02 * step, autopilot.state, ()))
    assert (machine.phase, autopilot.state.mode) == (P.HOLD, M.HOLD)


def test_abort_does_not_stop_motors_just_after_a_return() -> None:
    machine, autopilot, now_s = returning()
    assert machine.abort(now_s, replace(autopilot.state, landed=LandedState.ON_GROUND)) == (
        True,
        Notice(Code.PHASE_CHANGED, "lands"),
    )


@pytest.mark.parametrize("mode", [M.HOLD, M.LAND, M.OFFBOARD, M.OTHER])
def test_pilot_mode_ends_a_return(mode: AutopilotMode) -> None:
    machine, autopilot, now_s = returning(P.FORMATION)
    pilots = replace(autopilot.state, mode=mode, mode_name="THEIRS")
    assert tick(machine, now_s, pilots, ()) == ()
    assert machine.phase is P.OBSERVE
    assert not machine.streams(pilots)


@pytest.mark.parametrize("phase", [P.HOLD, P.FORMATION])
def test_return_not_requested_by_the_agent_is_passive(phase: FlightPhase) -> None:
    machine, autopilot, now_s = flown_to(phase)
    failsafe = replace(autopilot.state, mode=M.RETURN, mode_name="AUTO.RTL")
    assert tick(machine, now_s, failsafe, ()) == ()
    assert machine.phase is P.OBSERVE
    assert outcome(machine.abort(now_s, failsafe)) == (True, Code.FLOWN_BY_OTHERS)


@pytest.mark.parametrize("phase", [P.HOLD, P.FORMATION])
def test_vehicle_holds_when_the_return_mode_is_refused(phase: FlightPhase) -> None:
    machine, autopilot, now_s = flown_to(phase)
    before = autopilot.state
    machine.command(C.RETURN, now_s, before)
    refusal = AckSample(0.0, (SetMode,), False, "DO_SET_MODE temporarily rejected")
    asked: list[object] = []
    while machine.phase is P.RETURN:
        assert machine.streams(before) is (phase is P.FORMATION)  # braking, by then
        asked += tick(machine, now_s, before, [refusal])
        now_s += 0.02
        assert len(asked) < 20
    assert set(asked) == {SetMode(M.RETURN)}
    failed = "return -> release (return failed: DO_SET_MODE temporarily rejected)"
    assert Notice(Code.PROCEDURE_FAILED, failed) in machine.events
    for step in range(40):
        autopilot.execute(tick(machine, now_s + 0.02 * step, autopilot.state, ()))
    assert (machine.phase, autopilot.state.mode) == (P.HOLD, M.HOLD)


# ---------------------------------------------------------------- the agent


def answer(flight: AgentFlight) -> Answer:
    reply = flight.tick(C.RETURN).replies[0]
    return Answer(reply.accepted, Notice(reply.code, reply.reason))


def test_return_from_formation_levels_before_the_mode_change() -> None:
    flight = AgentFlight().fly_to(P.FORMATION)
    assert answer(flight) == (True, Notice(Code.PHASE_CHANGED, "return begins"))
    levels = 0
    while flight.mode is not M.RETURN:
        outbox = flight.tick()
        levels += outbox.attitude_target is not None
        assert outbox.peer_packet
        assert outbox.peer_packet.phase is P.RETURN
        assert levels < 20
    assert levels > 10
    assert all(flight.tick().attitude_target is None for _ in range(50))
    assert flight.agent.phase is P.RETURN


def test_return_check_uses_the_homes_that_peers_report() -> None:
    flight = AgentFlight().fly_to(P.HOLD)
    flight.peer_changes = {"home_enu_m": (0.0, 0.0)}
    flight.peer_phase, flight.peer_position = P.HOLD, (-3.0, 0.0, 1.0)  # on the other side of this one's home
    flight.position = (-1.5, 5.0, 1.0)
    flight.tick()
    refusal = answer(flight)
    assert outcome(refusal) == (False, Code.RETURN_PATH_TOO_CLOSE)
    assert "vehicle 2 comes within 0.00 m of vehicle 1" in refusal.notice.text
    assert flight.agent.phase is P.HOLD
    flight.peer_phase = P.LAND  # it lands at its position
    flight.tick()
    assert answer(flight)[0]


def test_home_is_that_of_the_autopilot_also_after_a_restart_in_flight() -> None:
    flight = AgentFlight()
    flight.armed, flight.landed, flight.mode, flight.home = True, LandedState.IN_AIR, M.HOLD, (-4.0, 7.0, 0.0)
    flight.fly_to(P.OBSERVE)
    for _ in range(50):
        flight.tick()
    assert flight.tick(C.HOLD).replies[0].accepted
    for _ in range(30):
        outbox = flight.tick()
    assert outbox.peer_packet and outbox.peer_packet.home_enu_m == pytest.approx((-4.0, 7.0), abs=0.02)
    assert flight.agent.phase is P.HOLD
    assert answer(flight)[0]


@pytest.mark.parametrize("for_s", [4.8, 5.2])
def test_a_home_is_known_for_five_seconds(for_s: float) -> None:
    flight = AgentFlight().fly_to(P.HOLD)
    flight.withheld = (HomeSample,)
    for _ in range(round(for_s / 0.02)):
        flight.tick()
    assert outcome(answer(flight)) == ((True, Code.PHASE_CHANGED) if for_s < 5.0 else (False, Code.HOME_UNKNOWN))


def test_a_home_that_is_none_is_refused_and_counted() -> None:
    """0, 0 is what an autopilot without a home would send."""
    flight = AgentFlight().fly_to(P.HOLD)
    flight.home = enu_from_geodetic(0.0, 0.0, 400.0, ORIGIN)
    assert answer(flight)[1].code is Code.HOME_UNKNOWN
    assert flight.agent.perception.rejected[Code.HOME_IMPLAUSIBLE] > 0


def test_rally_points_and_other_kinds_of_return_are_refused() -> None:
    flight = AgentFlight().fly_to(P.HOLD)
    flight.tick(telemetry=[*flight.telemetry(), RallySample(flight.now_s, has_rally_points=True)])
    assert flight.tick().peer_packet.home_enu_m is None  # others do not count on it either
    found = answer(flight)
    assert outcome(found) == (False, Code.RETURNS_ELSEWHERE) and "rally points" in found.notice.text
    flight.tick(telemetry=[*flight.telemetry(), RallySample(flight.now_s, has_rally_points=False)])
    flight.parameters["RTL_TYPE"] = 3
    for _ in range(300):
        flight.tick()
    found = answer(flight)
    assert outcome(found) == (False, Code.RETURNS_ELSEWHERE) and "RTL_TYPE: 3 (may end elsewhere)" in found.notice.text
    flight.parameters["RTL_TYPE"] = 0
    for _ in range(300):
        flight.tick()
    assert answer(flight)[0]


def test_a_home_elsewhere_or_shared_warns_before_arming() -> None:
    flight = AgentFlight()
    flight.peer_phase, flight.peer_position = P.READY, (3.0, 0.0, 0.0)
    for _ in range(150):
        flight.tick()
    assert status_of(flight).safety.warnings == ()
    flight.peer_changes = {"home_enu_m": (-1.5, 0.5)}
    assert [w.code for w in status_of(flight).safety.warnings] == [Code.HOME_SHARED]
    flight.landed = LandedState.UNDEFINED  # the home stays where it is
    flight.position = (-1.5, -4.0, 0.0)
    assert [w.code for w in status_of(flight).safety.warnings] == [Code.HOME_ELSEWHERE, Code.HOME_SHARED]


def status_of(flight: AgentFlight) -> Status:
    """The newest of the next second."""
    return [status for _ in range(50) if (status := flight.tick().status)][-1]


def test_return_is_accepted_outside_the_fence_and_refused_without_a_valid_position() -> None:
    flight = AgentFlight().fly_to(P.HOLD)
    flight.position = (-101.0, 0.0, 1.0)
    flight.peer_position = None
    flight.tick()
    flight.withheld = (type(flight.telemetry()[-1]),)
    for _ in range(60):
        flight.tick()
    assert outcome(answer(flight)) == (False, Code.POSITION_STALE)
    flight.withheld = ()
    flight.tick()
    assert answer(flight)[0]


def test_formation_does_not_wait_for_a_returning_vehicle() -> None:
    flight = AgentFlight().fly_to(P.FORMATION)
    flight.peer_phase = P.RETURN
    statuses = [status for _ in range(20) if (status := flight.tick().status)]
    assert statuses[-1].neighbourhood.neighbours == ()
