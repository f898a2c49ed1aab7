"""Every command in every phase, the pilot's take-over, and the failsafe table."""

import pytest
from msgspec.structs import replace

from common import code_of, outcome
from companion.core.command.hand_over import LEVEL_BEFORE_HAND_OVER_S, TAKES_OVER_WITHIN_S
from companion.core.command.phase import FLYING, TO_THE_GROUND, PhaseMachine
from companion.core.election.leadership import refusal_of_lead
from companion.core.safety.failsafe import HealthLimits, health_flags
from companion.core.safety.limits import OutputLimits
from companion.geometry.airspace import Fence
from companion.mavlink.autopilot_types import PROFILES
from companion.types.autopilot import (
    AckSample,
    Arm,
    AutopilotMode,
    Disarm,
    LandedState,
    RequestOrigin,
    SetMode,
    TakeOff,
    VehicleState,
)
from companion.types.commands import CONTENT, CommandName
from companion.types.flight import RULES, FlightPhase, HealthFlag
from companion.types.notices import Code, Notice
from one_agent import AIR, GROUND, ImmediateAutopilot, flown_to, levelled, tick

REASON = Notice(Code.AGENT_STOPPING, "a test")


def test_a_flight_from_take_off_to_landing() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    assert machine.phase is FlightPhase.FORMATION
    assert [type(r) for r in autopilot.asked] == [SetMode, Arm, TakeOff, SetMode]
    assert machine.command(CommandName.LAND, now_s, autopilot.state)[0]
    now_s = levelled(machine, autopilot, now_s)
    assert autopilot.state.mode is AutopilotMode.LAND
    tick(machine, now_s + 0.02, autopilot.state, ())
    assert machine.phase is FlightPhase.LAND
    tick(machine, now_s + 5.0, replace(autopilot.state, armed=False), ())
    assert machine.phase is FlightPhase.OBSERVE


def test_setpoints_stream_until_the_autopilot_has_taken_over() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    machine.command(CommandName.HOLD, now_s, autopilot.state)
    assert machine.phase is FlightPhase.RELEASE
    levelled(machine, autopilot, now_s)
    assert not machine.streams(autopilot.state)


def test_a_hand_over_is_level_until_the_autopilot_should_have_taken_over() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    machine.hand_over(now_s, autopilot.state, REASON)
    assert machine.handing_over.levels(now_s + LEVEL_BEFORE_HAND_OVER_S)
    assert not machine.handing_over.levels(now_s + LEVEL_BEFORE_HAND_OVER_S + TAKES_OVER_WITHIN_S)
    assert machine.streams(autopilot.state)


def test_a_moving_vehicle_brakes_before_it_levels_unless_its_velocity_is_in_doubt() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    moving = replace(autopilot.state, velocity_enu_m_s=(2.0, 0.0, 0.0))
    machine.hand_over(now_s, moving, REASON)
    assert machine.streams(moving) and not machine.handing_over.levels(now_s)
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    machine.hand_over_level(now_s, moving, REASON)
    assert machine.streams(moving) and machine.handing_over.levels(now_s)


def test_a_hold_is_requested_at_once_when_the_attitude_is_unknown() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    machine.hand_over_silently(now_s, autopilot.state, REASON)
    assert tick(machine, now_s, autopilot.state, ()) == (SetMode(AutopilotMode.HOLD),)


@pytest.mark.parametrize("phase", sorted(FLYING - TO_THE_GROUND))
def test_a_pilot_mode_ends_control_in_every_flying_phase(phase: FlightPhase) -> None:
    machine, autopilot, now_s = flown_to(phase)
    if phase is FlightPhase.RELEASE:
        machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
        machine.command(CommandName.HOLD, now_s, autopilot.state)
    assert machine.phase is phase
    flown_by_pilot = replace(AIR, mode=AutopilotMode.OTHER, mode_name="POSCTL")
    assert tick(machine, now_s, flown_by_pilot, ()) == ()
    assert machine.phase is FlightPhase.OBSERVE
    assert not machine.streams(flown_by_pilot)
    for count in range(500):
        assert tick(machine, now_s + 0.02 * count, flown_by_pilot, ()) == ()


def test_a_pilot_mode_ends_a_landing() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.HOLD)
    machine.command(CommandName.LAND, now_s, autopilot.state)
    autopilot.execute(tick(machine, now_s, autopilot.state, ()))
    tick(machine, now_s + 0.02, autopilot.state, ())
    tick(machine, now_s + 0.04, replace(autopilot.state, mode=AutopilotMode.HOLD, mode_name="HOLD"), ())
    assert machine.phase is FlightPhase.OBSERVE


@pytest.mark.parametrize(
    "phase", [FlightPhase.OBSERVE, FlightPhase.READY, FlightPhase.ARMED, FlightPhase.HOLD, FlightPhase.FORMATION]
)
@pytest.mark.parametrize("name", list(RULES))
def test_every_command_in_every_phase_is_accepted_by_the_table_or_refused(
    phase: FlightPhase, name: CommandName
) -> None:
    machine, autopilot, now_s = flown_to(phase)
    assert machine.phase is phase
    before = machine.phase
    accepted, notice = machine.command(name, now_s, autopilot.state)
    if accepted:
        assert machine.phase in (RULES[name].via, RULES[name].to)
    else:
        assert machine.phase is before
        assert name in notice.text


@pytest.mark.parametrize("name", list(RULES))
def test_nothing_is_requested_before_the_heartbeat(name: CommandName) -> None:
    machine = PhaseMachine(2.5, PROFILES)
    silent = replace(GROUND, autopilot=None)
    assert outcome(machine.command(name, 0.0, silent)) == (False, Code.NO_HEARTBEAT)
    assert tick(machine, 0.0, silent, ()) == ()


def test_every_command_that_changes_the_phase_is_in_the_table() -> None:
    assert set(CommandName) - set(RULES) == set(CONTENT) | {CommandName.TAKE, CommandName.ABORT}


@pytest.mark.parametrize("phase", [FlightPhase.OBSERVE, FlightPhase.READY, FlightPhase.HOLD, FlightPhase.FORMATION])
def test_leadership_changes_in_formation_in_hold_and_on_the_ground(phase: FlightPhase) -> None:
    machine, autopilot, _ = flown_to(phase)
    assert refusal_of_lead(machine.observe(0.0, autopilot.state), autopilot.state) is None


def test_leadership_is_refused_while_landing_or_flown_by_a_pilot() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    machine.command(CommandName.LAND, now_s, autopilot.state)
    assert code_of(refusal_of_lead(machine.observe(now_s, autopilot.state), autopilot.state)) is Code.WRONG_PHASE
    machine.give_up(REASON)
    assert code_of(refusal_of_lead(machine.observe(now_s, autopilot.state), autopilot.state)) is Code.WRONG_PHASE


def aborted(machine: PhaseMachine, autopilot: ImmediateAutopilot, now_s: float) -> FlightPhase:
    """The phase after an accepted abort."""
    assert machine.abort(now_s, autopilot.state)[0]
    for step in range(50):
        autopilot.execute(tick(machine, now_s + 0.02 * step, autopilot.state, ()))
    return machine.phase


@pytest.mark.parametrize(
    "phase", [FlightPhase.OBSERVE, FlightPhase.PREPARE, FlightPhase.READY, FlightPhase.ARM, FlightPhase.ARMED]
)
def test_abort_on_the_ground_disarms_from_every_phase(phase: FlightPhase) -> None:
    machine, autopilot, now_s = (
        (PhaseMachine(2.5, PROFILES), ImmediateAutopilot(), 0.0) if phase is FlightPhase.OBSERVE else began(phase)
    )
    assert aborted(machine, autopilot, now_s) is FlightPhase.OBSERVE
    assert autopilot.asked == [] if phase is FlightPhase.OBSERVE else autopilot.asked[-1] == Disarm()
    assert not autopilot.state.armed


def began(phase: FlightPhase) -> tuple[PhaseMachine, ImmediateAutopilot, float]:
    """A machine in this phase, also in one that is only passed through."""
    leads_there = next((name for name, rule in RULES.items() if rule.via is phase), None)
    before = {FlightPhase.PREPARE: FlightPhase.OBSERVE, FlightPhase.ARM: FlightPhase.READY}.get(phase)
    if before is None or leads_there is None:
        return flown_to(phase)
    machine, autopilot, now_s = flown_to(before)
    machine.command(leads_there, now_s, autopilot.state)
    assert machine.phase is phase
    return machine, autopilot, now_s


@pytest.mark.parametrize("phase", [FlightPhase.HOLD, FlightPhase.FORMATION])
def test_abort_in_the_air_goes_to_the_autopilots_own_hold(phase: FlightPhase) -> None:
    machine, autopilot, now_s = flown_to(phase)
    assert aborted(machine, autopilot, now_s) is FlightPhase.HOLD
    assert autopilot.state.mode is AutopilotMode.HOLD
    assert autopilot.state.armed


def test_abort_in_a_climb_holds_and_before_it_leaves_the_ground_disarms() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.ARMED)
    machine.command(CommandName.TAKEOFF, now_s, autopilot.state)
    autopilot.state = replace(AIR, mode=AutopilotMode.TAKEOFF, position_enu_m=(0.0, 0.0, 1.0))
    assert aborted(machine, autopilot, now_s) is FlightPhase.HOLD
    machine, autopilot, now_s = flown_to(FlightPhase.ARMED)
    machine.command(CommandName.TAKEOFF, now_s, autopilot.state)
    assert aborted(machine, autopilot, now_s) is FlightPhase.OBSERVE
    assert not autopilot.state.armed


def test_a_landing_continues_after_an_abort() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.HOLD)
    machine.command(CommandName.LAND, now_s, autopilot.state)
    autopilot.execute(tick(machine, now_s, autopilot.state, ()))
    asked = len(autopilot.asked)
    assert outcome(machine.abort(now_s, autopilot.state)) == (True, Code.LANDING_CONTINUES)
    tick(machine, now_s + 0.02, autopilot.state, ())
    assert machine.phase is FlightPhase.LAND
    assert len(autopilot.asked) == asked


def test_abort_stops_no_motors_just_after_flight() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    autopilot.state = replace(autopilot.state, landed=LandedState.ON_GROUND)
    assert machine.abort(now_s, autopilot.state) == (True, Notice(Code.PHASE_CHANGED, "lands"))
    for step in range(10):
        autopilot.execute(tick(machine, now_s + 0.02 * step, autopilot.state, ()))
    assert Disarm() not in autopilot.asked


@pytest.mark.parametrize("mode", [AutopilotMode.OTHER, AutopilotMode.LAND, AutopilotMode.RETURN])
def test_abort_leaves_a_vehicle_to_its_pilot(mode: AutopilotMode) -> None:
    machine = PhaseMachine(2.5, PROFILES)
    piloted = replace(AIR, mode=mode, mode_name="POSCTL")
    assert outcome(machine.abort(0.0, piloted)) == (True, Code.FLOWN_BY_OTHERS)
    assert tick(machine, 0.0, piloted, ()) == ()


def test_abort_is_refused_before_the_heartbeat() -> None:
    machine = PhaseMachine(2.5, PROFILES)
    assert not machine.abort(0.0, replace(GROUND, autopilot=None))[0]


def test_a_landing_ends_only_when_disarmed() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.HOLD)
    machine.command(CommandName.LAND, now_s, autopilot.state)
    autopilot.execute(tick(machine, now_s, autopilot.state, ()))
    down = replace(autopilot.state, mode=AutopilotMode.HOLD, landed=LandedState.ON_GROUND)
    tick(machine, now_s + 5.0, down, ())
    assert machine.phase is FlightPhase.LAND
    tick(machine, now_s + 6.0, replace(down, armed=False), ())
    assert machine.phase is FlightPhase.OBSERVE
    assert machine.events[-1].code is Code.PHASE_CHANGED


def test_offboard_shown_again_at_disarming_starts_no_stream() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    offboard = autopilot.state
    machine.command(CommandName.LAND, now_s, offboard)
    now_s = levelled(machine, autopilot, now_s)
    tick(machine, now_s + 0.02, autopilot.state, ())
    down = replace(offboard, landed=LandedState.ON_GROUND)  # PX4 shows the intended mode again before it is disarmed
    tick(machine, now_s + 5.0, down, ())
    assert machine.phase is FlightPhase.LAND
    assert not machine.streams(down)


def test_an_agent_restarted_in_flight_accepts_only_hold() -> None:
    machine = PhaseMachine(2.5, PROFILES)
    flying = replace(AIR, mode=AutopilotMode.OFFBOARD)
    for count in range(200):
        assert tick(machine, 0.02 * count, flying, ()) == ()
    assert not machine.streams(flying)
    for name in (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF, CommandName.FORM):
        assert not machine.command(name, 5.0, flying)[0]
    assert machine.command(CommandName.HOLD, 5.0, flying)[0]
    assert tick(machine, 5.0, flying, ()) == (SetMode(AutopilotMode.HOLD),)
    assert not machine.streams(flying)


def test_no_take_off_without_a_known_altitude() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.ARMED)
    answer = machine.command(CommandName.TAKEOFF, now_s, replace(autopilot.state, altitude_amsl_m=None))
    assert outcome(answer) == (False, Code.ALTITUDE_UNKNOWN)
    assert machine.phase is FlightPhase.ARMED


def test_a_refusal_is_relayed_and_retries_are_bounded() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.READY)
    machine.command(CommandName.ARM, now_s, autopilot.state)
    refusal = AckSample(0.0, (Arm, Disarm), False, "COMPONENT_ARM_DISARM temporarily rejected")
    asked = 0
    for count in range(1000):
        asked += len(tick(machine, now_s + 0.02 * count, autopilot.state, [refusal]))
    assert 5 <= asked <= 12
    assert machine.phase is FlightPhase.READY
    assert "COMPONENT_ARM_DISARM temporarily rejected" in machine.events[-1].text


def test_a_hold_just_after_the_offboard_request_is_requested_again() -> None:
    """The OFFBOARD request may overtake the hold: the agent must then request it again."""
    machine, autopilot, now_s = flown_to(FlightPhase.HOLD)
    machine.command(CommandName.FORM, now_s, autopilot.state)
    now_s += 0.4
    assert tick(machine, now_s, autopilot.state, ()) == (SetMode(AutopilotMode.OFFBOARD),)
    machine.command(CommandName.HOLD, now_s, autopilot.state)
    assert tick(machine, now_s, autopilot.state, ()) == (SetMode(AutopilotMode.HOLD),)
    offboard = replace(autopilot.state, mode=AutopilotMode.OFFBOARD, mode_name="OFFBOARD")
    asked = [request for count in range(1, 60) for request in tick(machine, now_s + 0.02 * count, offboard, ())]
    assert asked == [SetMode(AutopilotMode.HOLD)] * 2
    tick(machine, now_s + 2.0, autopilot.state, ())
    assert machine.phase is FlightPhase.HOLD


def test_no_landing_is_requested_again_on_the_ground() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.HOLD)
    machine.command(CommandName.LAND, now_s, autopilot.state)
    autopilot.execute(tick(machine, now_s, autopilot.state, ()))
    tick(machine, now_s + 0.02, autopilot.state, ())
    down = replace(autopilot.state, mode=AutopilotMode.OTHER, mode_name="POSCTL", landed=LandedState.ON_GROUND)
    for count in range(500):
        assert tick(machine, now_s + 5.0 + 0.02 * count, down, ()) == ()


def test_a_vehicle_disarmed_by_the_pilot_is_not_armed_again() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.READY)
    machine.command(CommandName.ARM, now_s, autopilot.state)
    assert tick(machine, now_s, autopilot.state, ()) == (Arm(),)
    accepted = AckSample(0.0, (Arm, Disarm), True, "COMPONENT_ARM_DISARM accepted")
    assert tick(machine, now_s + 0.02, autopilot.state, (accepted,)) == ()
    for count in range(2, 600):  # disarmed before any heartbeat showed it armed
        assert tick(machine, now_s + 0.02 * count, autopilot.state, ()) == ()
    assert machine.phase is FlightPhase.READY


def test_the_reason_of_a_failure_is_of_its_own_command() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.READY)
    machine.command(CommandName.ARM, now_s, autopilot.state)
    other = AckSample(0.0, (RequestOrigin,), False, "REQUEST_MESSAGE denied")
    for count in range(600):
        tick(machine, now_s + 0.02 * count, autopilot.state, (other,))
    assert machine.events[-1].text == "arm -> ready (arm failed: no answer from the autopilot)"


def test_telemetry_older_than_the_request_does_not_count() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.HOLD)
    machine.command(CommandName.FORM, now_s, autopilot.state)
    old = replace(autopilot.state, mode=AutopilotMode.OFFBOARD, mode_time_s=now_s + 0.1)
    for count in range(30):
        tick(machine, now_s + 0.02 * count, old, ())
    assert machine.phase is FlightPhase.ENGAGE
    tick(machine, now_s + 0.7, replace(old, mode_time_s=now_s + 0.7), ())
    assert machine.phase is FlightPhase.FORMATION


def test_setpoints_stream_before_offboard_is_requested() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.HOLD)
    machine.command(CommandName.FORM, now_s, autopilot.state)
    for count in range(14):
        assert tick(machine, now_s + 0.02 * count, autopilot.state, ()) == ()
        assert machine.streams(autopilot.state)


@pytest.mark.parametrize("phase", [FlightPhase.READY, FlightPhase.ARMED])
def test_a_take_off_by_the_pilot_leads_to_observe(phase: FlightPhase) -> None:
    machine, autopilot, now_s = flown_to(phase)
    flying = replace(autopilot.state, armed=True, landed=LandedState.IN_AIR)
    tick(machine, now_s, flying, ())
    assert machine.phase is FlightPhase.OBSERVE
    assert machine.command(CommandName.LAND, now_s, flying)[0]


@pytest.mark.parametrize("phase", [FlightPhase.ARMED, FlightPhase.HOLD, FlightPhase.FORMATION])
def test_a_disarmed_vehicle_is_only_observed(phase: FlightPhase) -> None:
    machine, autopilot, now_s = flown_to(phase)
    tick(machine, now_s, replace(autopilot.state, armed=False), ())
    assert machine.phase is FlightPhase.OBSERVE
    assert machine.events[-1].code is Code.AUTOPILOT_DISARMED


def test_a_mode_set_by_others_on_the_ground_leads_to_observe() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.READY)
    tick(machine, now_s, replace(autopilot.state, mode=AutopilotMode.OTHER, mode_name="MANUAL"), ())
    assert machine.phase is FlightPhase.OBSERVE


def test_a_climb_ends_at_its_height() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.ARMED)
    machine.command(CommandName.TAKEOFF, now_s, autopilot.state)
    tick(machine, now_s, autopilot.state, ())
    low = replace(AIR, position_enu_m=(0.0, 0.0, 1.0))
    tick(machine, now_s + 1.0, low, ())
    assert machine.phase is FlightPhase.TAKEOFF
    tick(machine, now_s + 2.0, AIR, ())
    assert machine.phase is FlightPhase.HOLD


def test_a_mode_reported_twice_a_second_is_not_stale_where_one_report_is_lost() -> None:
    """Measured: 0.51 to 0.53 s from one CURRENT_MODE to the next, whatever rate was asked for."""
    envelope = OutputLimits(0.5, 7.0, 0.3, 1.6, 10.0, Fence((-9.0, -9.0, -9.0), (9.0, 9.0, 9.0)))
    limits = HealthLimits(envelope)
    vehicle = VehicleState(
        position_time_s=9.99, attitude_time_s=9.99, mode_time_s=10.0 - 2 * 0.53, heartbeat_time_s=9.5
    )
    flags = health_flags(10.0, vehicle, limits)
    assert HealthFlag.MODE_STALE not in flags
    silent = health_flags(10.0, replace(vehicle, mode_time_s=10.0 - 1.3), limits)
    assert HealthFlag.MODE_STALE in silent


def refused(machine: PhaseMachine, vehicle: VehicleState, now_s: float, for_s: float) -> float:
    """Let the autopilot refuse each change of mode for this time, and change nothing."""
    answer: tuple[AckSample, ...] = ()
    for _ in range(round(for_s / 0.02)):
        now_s += 0.02
        asked = tick(machine, now_s, vehicle, answer)
        answer = (AckSample(now_s, (SetMode,), False, "DO_SET_MODE failed"),) if asked else ()
    return now_s


def test_a_refused_hold_becomes_a_landing_and_a_refused_landing_a_descent_with_setpoints() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    machine.hand_over(now_s, autopilot.state, REASON)
    now_s = refused(machine, autopilot.state, now_s, 2.0)
    assert machine.phase is FlightPhase.LAND
    assert "hold" not in machine.events[-1].text and "DO_SET_MODE failed" in machine.events[-1].text
    assert machine.streams(autopilot.state) and not machine.handing_over.descends(now_s)
    now_s = refused(machine, autopilot.state, now_s, 2.0)
    assert machine.streams(autopilot.state) and machine.handing_over.descends(now_s)
    now_s = refused(machine, autopilot.state, now_s, 200.0)  # longer than a landing may take
    assert machine.phase is FlightPhase.LAND and machine.handing_over.descends(now_s)
    landed = replace(autopilot.state, landed=LandedState.ON_GROUND)
    assert tick(machine, now_s, landed, ()) == (Disarm(),)
    assert machine.handing_over.descends(now_s)  # it would take off again
    tick(machine, now_s + 0.02, replace(landed, armed=False), ())
    assert machine.phase is FlightPhase.OBSERVE and not machine.streams(landed)


def test_a_landing_that_the_autopilot_takes_is_not_flown_with_setpoints() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    machine.hand_over(now_s, autopilot.state, REASON)
    now_s = refused(machine, autopilot.state, now_s, 2.0)
    landing = replace(autopilot.state, mode=AutopilotMode.LAND)
    tick(machine, now_s + 5.0, landing, ())
    assert not machine.streams(landing) and not machine.handing_over.descends(now_s + 5.0)


def test_a_hold_that_the_autopilot_ignores_becomes_a_landing_too() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    machine.hand_over(now_s, autopilot.state, REASON)
    for count in range(260):
        tick(machine, now_s + 0.02 * count, autopilot.state, ())
    assert machine.phase is FlightPhase.LAND


def test_a_vehicle_that_another_flies_is_left_to_it_when_a_hold_is_refused() -> None:
    machine = PhaseMachine(2.5, PROFILES)
    piloted = replace(AIR, mode=AutopilotMode.OTHER, mode_name="POSCTL")
    assert machine.command(CommandName.HOLD, 0.0, piloted)[0]
    refused(machine, piloted, 0.0, 2.0)
    assert machine.phase is FlightPhase.OBSERVE
