"""The command `return`: whose ways home keep apart, how the mode is asked for, and what ends it."""

import pytest
from msgspec.structs import replace
from test_agent import Flight
from test_fleet_checks import peer
from test_phase_and_failsafe import AIR, Obedient, flown_to, levelled, tick

from companion.core.homeward import Way, apart, refusal_of_return
from companion.core.phase import RULES, PhaseMachine
from companion.types import (
    AckSample,
    AutopilotMode,
    CommandName,
    FlightPhase,
    HeartbeatSample,
    LandedState,
    PeerPacket,
    SetMode,
    Vector3,
)

P, M, C = FlightPhase, AutopilotMode, CommandName


# ---------------------------------------------------------------- ways


@pytest.mark.parametrize(
    ("a", "b", "apart_m"),
    [
        (((0.0, 0.0), (10.0, 0.0)), ((5.0, -1.0), (5.0, 1.0)), 0.0),  # across
        (((0.0, 0.0), (10.0, 0.0)), ((3.0, 2.0), (7.0, 2.0)), 2.0),  # side by side
        (((0.0, 0.0), (10.0, 0.0)), ((10.0, 0.0), (10.0, 5.0)), 0.0),  # an end touches
        (((0.0, 0.0), (10.0, 0.0)), ((4.0, 0.0), (14.0, 0.0)), 0.0),  # along the same line
        (((0.0, 0.0), (10.0, 0.0)), ((13.0, 4.0), (20.0, 4.0)), 5.0),
        (((0.0, 0.0), (0.0, 0.0)), ((3.0, 4.0), (3.0, 4.0)), 5.0),  # both hover above home
        (((0.0, 0.0), (10.0, 0.0)), ((5.0, 3.0), (5.0, 3.0)), 3.0),  # one stands beside the way
        (((0.0, 0.0), (10.0, 10.0)), ((6.0, 0.0), (6.0, 5.0)), 0.5**0.5),  # ends before the other way
    ],
)
def test_how_near_two_ways_come(a: Way, b: Way, apart_m: float) -> None:
    for one, other in ((a, b), (b, a), (a[::-1], b), (a, b[::-1])):
        assert apart(one, other) == pytest.approx(apart_m, abs=1e-12)


def heard(phase: FlightPhase, at: Vector3) -> PeerPacket:
    return replace(peer(1), phase=phase, position_enu_m=at)


def refusal(at: Vector3, home: Vector3 | None, *others: PeerPacket, stood: Vector3 | None = None) -> str:
    vehicle = replace(AIR, position_enu_m=at, stood_enu_m=home)
    return refusal_of_return(2, 1.0, vehicle, others, {} if stood is None else {1: stood})


def test_ways_that_keep_apart_are_free() -> None:
    assert refusal((0.0, 10.0, 5.0), (0.0, 0.0, 0.0), heard(P.FORMATION, (3.0, 10.0, 5.0)), stood=(3.0, 0.0, 0.0)) == ""
    assert refusal((0.0, 10.0, 5.0), (0.0, 0.0, 0.0)) == ""  # nobody is there


def test_ways_that_cross_are_refused_whatever_the_heights() -> None:
    other = heard(P.HOLD, (3.0, 10.0, 50.0))
    assert refusal((0.0, 10.0, 5.0), (3.0, 0.0, 0.0), other, stood=(0.0, 0.0, 0.0)) == (
        "separation: on its straight way home vehicle 2 comes within 0.00 m of vehicle 1 or of its way home; expected at"
        " least separation_m, 1 m; land instead"
    )


@pytest.mark.parametrize("phase", [P.HOLD, P.ENGAGE, P.FORMATION, P.RELEASE, P.RETURN, P.OBSERVE])
def test_the_way_home_counts_of_all_that_may_go_home_and_their_place_where_it_is_unknown(phase: FlightPhase) -> None:
    """The other's way home leads through the home of this one; its place is far from it."""
    other, home = heard(phase, (0.0, -8.0, 5.0)), (0.0, 0.0, 0.0)
    assert "comes within 0.00 m" in refusal((0.0, 1.0, 5.0), home, other, stood=(0.0, 8.0, 0.0))
    assert refusal((0.0, 1.0, 5.0), home, other) == ""


@pytest.mark.parametrize("phase", [P.READY, P.ARMED, P.TAKEOFF, P.LAND])
def test_of_who_stands_climbs_or_lands_only_the_place_counts(phase: FlightPhase) -> None:
    home = (0.0, 0.0, 0.0)
    assert refusal((0.0, 6.0, 5.0), home, heard(phase, (0.0, -8.0, 5.0)), stood=(0.0, 8.0, 0.0)) == ""
    assert "within 0.50 m" in refusal((0.0, 6.0, 5.0), home, heard(phase, (0.5, 3.0, 0.0)))


def test_who_does_not_know_its_home_does_not_return() -> None:
    assert "its way home is unknown" in refusal((0.0, 6.0, 5.0), None)


# ---------------------------------------------------------------- phases


def returning(phase: FlightPhase = P.HOLD) -> tuple[PhaseMachine, Obedient, float]:
    """A machine whose autopilot returns, out of this phase."""
    machine, autopilot, now_s = flown_to(phase)
    assert machine.command(C.RETURN, now_s, autopilot.state) == (True, "return")
    if phase is P.FORMATION:
        now_s = levelled(machine, autopilot, now_s)
    else:
        autopilot.obey(tick(machine, now_s, autopilot.state, ()))
    tick(machine, now_s + 0.02, autopilot.state, ())
    assert (machine.phase, autopilot.state.mode) == (P.RETURN, M.RETURN)
    return machine, autopilot, now_s + 0.04


@pytest.mark.parametrize("phase", [P.HOLD, P.FORMATION])
def test_a_return_is_the_autopilots_own_and_ends_disarmed_however_long_it_takes(phase: FlightPhase) -> None:
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
    assert machine.events[-1] == "return -> observe"


@pytest.mark.parametrize("phase", sorted(set(P) - RULES[C.RETURN].allowed - {P.RETURN, P.PREPARE, P.ARM, P.LAND}))
def test_a_return_begins_in_formation_or_in_hold_alone(phase: FlightPhase) -> None:
    machine, autopilot, now_s = flown_to(phase)
    accepted, reason = machine.command(C.RETURN, now_s, autopilot.state)
    assert not accepted
    assert reason == f"return is not possible in phase {phase}, only in engage, formation, hold, release"


def test_the_same_command_again_changes_nothing() -> None:
    machine, autopilot, now_s = returning()
    assert machine.command(C.RETURN, now_s, autopilot.state) == (True, "already return")
    assert tick(machine, now_s, autopilot.state, ()) == ()


@pytest.mark.parametrize(("name", "mode"), [(C.HOLD, M.HOLD), (C.LAND, M.LAND)])
def test_hold_and_land_end_a_return(name: CommandName, mode: AutopilotMode) -> None:
    machine, autopilot, now_s = returning()
    assert machine.command(name, now_s, autopilot.state)[0]
    for step in range(40):
        autopilot.obey(tick(machine, now_s + 0.02 * step, autopilot.state, ()))
    assert autopilot.state.mode is mode
    assert machine.phase is RULES[name].via if name is C.LAND else RULES[name].to


def test_abort_stops_a_return_on_its_way_and_lets_it_land_at_home() -> None:
    machine, autopilot, now_s = returning()
    descends = replace(autopilot.state, landed=LandedState.LANDING)
    assert machine.abort(now_s, descends) == (True, "goes on landing")
    assert tick(machine, now_s, descends, ()) == ()
    assert machine.abort(now_s, autopilot.state)[0]
    for step in range(40):
        autopilot.obey(tick(machine, now_s + 0.02 * step, autopilot.state, ()))
    assert (machine.phase, autopilot.state.mode) == (P.HOLD, M.HOLD)


def test_abort_stops_no_motors_of_one_that_was_flying_home_a_moment_ago() -> None:
    machine, autopilot, now_s = returning()
    assert machine.abort(now_s, replace(autopilot.state, landed=LandedState.ON_GROUND)) == (True, "lands")


@pytest.mark.parametrize("mode", [M.HOLD, M.LAND, M.OFFBOARD, M.OTHER])
def test_the_pilot_wins_over_a_return_that_has_begun(mode: AutopilotMode) -> None:
    machine, autopilot, now_s = returning(P.FORMATION)
    pilots = replace(autopilot.state, mode=mode, mode_name="THEIRS")
    assert tick(machine, now_s, pilots, ()) == ()
    assert machine.phase is P.OBSERVE
    assert not machine.streams(pilots)


@pytest.mark.parametrize("phase", [P.HOLD, P.FORMATION])
def test_a_return_that_the_agent_did_not_ask_for_is_somebody_elses(phase: FlightPhase) -> None:
    machine, autopilot, now_s = flown_to(phase)
    failsafe = replace(autopilot.state, mode=M.RETURN, mode_name="AUTO.RTL")
    assert tick(machine, now_s, failsafe, ()) == ()
    assert machine.phase is P.OBSERVE
    assert machine.abort(now_s, failsafe) == (True, "left to who flies it, in mode AUTO.RTL")


@pytest.mark.parametrize("phase", [P.HOLD, P.FORMATION])
def test_an_autopilot_that_does_not_return_holds(phase: FlightPhase) -> None:
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
    assert "return -> release (return failed: DO_SET_MODE temporarily rejected)" in machine.events
    for step in range(40):
        autopilot.obey(tick(machine, now_s + 0.02 * step, autopilot.state, ()))
    assert (machine.phase, autopilot.state.mode) == (P.HOLD, M.HOLD)


# ---------------------------------------------------------------- the agent


def answer(flight: Flight) -> tuple[bool, str]:
    reply = flight.tick(C.RETURN).replies[0]
    return reply.accepted, reply.reason


def test_an_agent_in_formation_levels_and_sends_the_autopilot_home() -> None:
    flight = Flight().fly_to(P.FORMATION)
    assert answer(flight) == (True, "return")
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


def test_it_remembers_where_the_others_stood_and_refuses_to_cross_their_ways() -> None:
    flight = Flight()
    flight.peer_phase, flight.peer_position = P.ARMED, (0.0, 0.0, 0.0)
    flight.fly_to(P.HOLD)
    flight.peer_phase, flight.peer_position = P.HOLD, (-3.0, 0.0, 1.0)  # on the other side of this one's home
    for _ in range(200):
        flight.tick()
    flight.position = (-1.5, 5.0, 1.0)
    flight.tick()
    accepted, reason = answer(flight)
    assert not accepted
    assert "return: separation: on its straight way home vehicle 2 comes within 0.00 m of vehicle 1" in reason
    assert flight.agent.phase is P.HOLD
    flight.peer_phase = P.LAND  # it comes down where it is
    flight.tick()
    assert answer(flight)[0]


def test_after_a_restart_in_the_air_it_does_not_know_its_home() -> None:
    flight = Flight()
    flight.armed, flight.landed, flight.mode = True, LandedState.IN_AIR, M.HOLD
    late = [sample for sample in flight.telemetry() if not isinstance(sample, HeartbeatSample)]
    flight.tick(telemetry=late)  # what it hears first says nothing of being armed
    for _ in range(20):
        flight.tick()
    assert flight.tick(C.HOLD).replies[0].accepted
    for _ in range(30):
        flight.tick()
    assert flight.agent.phase is P.HOLD
    assert answer(flight) == (
        False,
        "return: its way home is unknown, as this agent has not seen it stand on the ground; land instead",
    )


def test_outside_the_fence_it_may_come_home_but_not_from_a_place_in_doubt() -> None:
    flight = Flight().fly_to(P.HOLD)
    flight.position = (-101.0, 0.0, 1.0)
    flight.peer_position = None
    flight.tick()
    flight.withheld = (type(flight.telemetry()[-1]),)
    for _ in range(60):
        flight.tick()
    accepted, reason = answer(flight)
    assert not accepted
    assert reason == "return: position older than allowed"
    flight.withheld = ()
    flight.tick()
    assert answer(flight)[0]


def test_others_do_not_wait_for_who_returns() -> None:
    flight = Flight().fly_to(P.FORMATION)
    flight.peer_phase = P.RETURN
    statuses = [status for _ in range(20) if (status := flight.tick().status)]
    assert statuses[-1].neighbours == ()
