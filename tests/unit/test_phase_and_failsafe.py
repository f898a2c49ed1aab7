"""Every command in every phase, the pilot's take-over, and the failsafe table."""

from collections.abc import Iterable, Sequence
from itertools import chain, combinations

import pytest
from msgspec.structs import replace

from companion.core.envelope import EnvelopeLimits
from companion.core.failsafe import ACTIONS, failsafe_action
from companion.core.health import AgeLimits, health_flags
from companion.core.phase import (
    FLYING,
    LEVEL_BEFORE_HAND_OVER_S,
    RULES,
    TAKES_OVER_WITHIN_S,
    TO_THE_GROUND,
    PhaseMachine,
)
from companion.types import (
    CONTENT,
    AckSample,
    Arm,
    AutopilotKind,
    AutopilotMode,
    AutopilotRequest,
    CommandName,
    Disarm,
    FailsafeAction,
    FlightPhase,
    HealthFlag,
    LandedState,
    RequestOrigin,
    SetMode,
    TakeOff,
    Telemetry,
    VehicleState,
)

NEW = float("inf")  # truth that is always newer than what was asked
GROUND = VehicleState(
    mode_time_s=NEW,
    heartbeat_time_s=NEW,
    autopilot=AutopilotKind.PX4,
    mode=AutopilotMode.OTHER,
    mode_name="POSCTL",
    landed=LandedState.ON_GROUND,
    altitude_amsl_m=488.0,
)
AIR = replace(GROUND, armed=True, landed=LandedState.IN_AIR, mode=AutopilotMode.HOLD, position_enu_m=(0.0, 0.0, 2.5))


def tick(
    machine: PhaseMachine, now_s: float, vehicle: VehicleState, telemetry: Sequence[Telemetry]
) -> tuple[AutopilotRequest, ...]:
    """What the agent does with the machine in a tick without commands."""
    machine.follow_truth(vehicle)
    return machine.advance(now_s, vehicle, telemetry)


class Obedient:
    """An autopilot that does at once what it is asked."""

    def __init__(self) -> None:
        self.state = GROUND
        self.asked: list[AutopilotRequest] = []

    def obey(self, requests: Iterable[AutopilotRequest]) -> None:
        for request in requests:
            self.asked.append(request)
            match request:
                case SetMode(mode):
                    self.state = replace(self.state, mode=mode, mode_name=mode)
                case Arm():
                    self.state = replace(self.state, armed=True)
                case Disarm():
                    self.state = replace(self.state, armed=False)
                case TakeOff():
                    self.state = replace(AIR, mode=AutopilotMode.HOLD)


def flown_to(phase: FlightPhase) -> tuple[PhaseMachine, Obedient, float]:
    """A machine that came to `phase` by the ordinary way."""
    machine, autopilot, now_s = PhaseMachine(2.5), Obedient(), 0.0
    for name in (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF, CommandName.FORM):
        if machine.phase is phase:
            break
        assert machine.command(name, now_s, autopilot.state)[0]
        for _ in range(100):
            if machine.phase is phase:
                return machine, autopilot, now_s
            autopilot.obey(tick(machine, now_s, autopilot.state, ()))
            now_s += 0.02
    return machine, autopilot, now_s


def levelled(machine: PhaseMachine, autopilot: Obedient, now_s: float) -> float:
    """The time by which the autopilot has done what a hand-over from formation asks, after it streamed until then."""
    until_s = now_s + LEVEL_BEFORE_HAND_OVER_S
    while now_s < until_s:
        assert tick(machine, now_s, autopilot.state, ()) == ()
        assert machine.streams(autopilot.state) and machine.hands_over_level(now_s)
        now_s += 0.02
    autopilot.obey(tick(machine, now_s, autopilot.state, ()))
    return now_s


def test_the_ordinary_flight() -> None:
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
    machine.hand_over(now_s, autopilot.state, "no leader's word")
    assert machine.hands_over_level(now_s + LEVEL_BEFORE_HAND_OVER_S)
    assert not machine.hands_over_level(now_s + LEVEL_BEFORE_HAND_OVER_S + TAKES_OVER_WITHIN_S)
    assert machine.streams(autopilot.state)


def test_where_nothing_can_be_said_of_the_attitude_the_hold_is_asked_for_at_once() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    machine.hand_over_silently(now_s, autopilot.state, "silent")
    assert tick(machine, now_s, autopilot.state, ()) == (SetMode(AutopilotMode.HOLD),)


@pytest.mark.parametrize("phase", sorted(FLYING - TO_THE_GROUND))
def test_the_pilot_always_wins(phase: FlightPhase) -> None:
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


def test_the_pilot_wins_over_a_landing_that_has_begun() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.HOLD)
    machine.command(CommandName.LAND, now_s, autopilot.state)
    autopilot.obey(tick(machine, now_s, autopilot.state, ()))
    tick(machine, now_s + 0.02, autopilot.state, ())
    tick(machine, now_s + 0.04, replace(autopilot.state, mode=AutopilotMode.HOLD, mode_name="HOLD"), ())
    assert machine.phase is FlightPhase.OBSERVE


@pytest.mark.parametrize(
    "phase", [FlightPhase.OBSERVE, FlightPhase.READY, FlightPhase.ARMED, FlightPhase.HOLD, FlightPhase.FORMATION]
)
@pytest.mark.parametrize("name", list(RULES))
def test_every_command_in_every_phase_is_accepted_by_the_table_or_refused_in_words(
    phase: FlightPhase, name: CommandName
) -> None:
    machine, autopilot, now_s = flown_to(phase)
    assert machine.phase is phase
    before = machine.phase
    accepted, reason = machine.command(name, now_s, autopilot.state)
    if accepted:
        assert machine.phase in (RULES[name].via, RULES[name].to)
    else:
        assert machine.phase is before
        assert name in reason


@pytest.mark.parametrize("name", list(RULES))
def test_before_its_heartbeat_the_autopilot_is_asked_nothing(name: CommandName) -> None:
    machine = PhaseMachine(2.5)
    silent = replace(GROUND, autopilot=None)
    assert machine.command(name, 0.0, silent) == (False, f"{name}: no HEARTBEAT has come from the autopilot yet")
    assert tick(machine, 0.0, silent, ()) == ()


def test_every_command_that_brings_about_a_phase_is_in_the_table() -> None:
    assert set(CommandName) - set(RULES) == set(CONTENT) | {CommandName.TAKE, CommandName.ABORT}


@pytest.mark.parametrize("phase", [FlightPhase.OBSERVE, FlightPhase.READY, FlightPhase.HOLD, FlightPhase.FORMATION])
def test_the_lead_changes_in_formation_in_hold_and_on_the_ground(phase: FlightPhase) -> None:
    machine, autopilot, _ = flown_to(phase)
    assert machine.refusal_of_lead(autopilot.state) == ""


def test_the_lead_is_not_given_to_who_lands_or_is_flown_by_a_pilot() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    machine.command(CommandName.LAND, now_s, autopilot.state)
    assert machine.refusal_of_lead(autopilot.state) == (
        "lead is not possible in phase land, only in formation, in hold or on the ground"
    )
    machine.give_up("the pilot flies")
    assert "phase observe" in machine.refusal_of_lead(autopilot.state)


def aborted(machine: PhaseMachine, autopilot: Obedient, now_s: float) -> FlightPhase:
    """Where an accepted abort leads."""
    assert machine.abort(now_s, autopilot.state)[0]
    for step in range(50):
        autopilot.obey(tick(machine, now_s + 0.02 * step, autopilot.state, ()))
    return machine.phase


@pytest.mark.parametrize(
    "phase", [FlightPhase.OBSERVE, FlightPhase.PREPARE, FlightPhase.READY, FlightPhase.ARM, FlightPhase.ARMED]
)
def test_abort_on_the_ground_disarms_from_every_phase(phase: FlightPhase) -> None:
    machine, autopilot, now_s = (PhaseMachine(2.5), Obedient(), 0.0) if phase is FlightPhase.OBSERVE else began(phase)
    assert aborted(machine, autopilot, now_s) is FlightPhase.OBSERVE
    assert autopilot.asked[-1] == Disarm()
    assert not autopilot.state.armed


def began(phase: FlightPhase) -> tuple[PhaseMachine, Obedient, float]:
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


def test_a_vehicle_that_lands_goes_on_landing_when_all_is_aborted() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.HOLD)
    machine.command(CommandName.LAND, now_s, autopilot.state)
    autopilot.obey(tick(machine, now_s, autopilot.state, ()))
    asked = len(autopilot.asked)
    assert machine.abort(now_s, autopilot.state) == (True, "goes on landing")
    tick(machine, now_s + 0.02, autopilot.state, ())
    assert machine.phase is FlightPhase.LAND
    assert len(autopilot.asked) == asked


def test_abort_stops_no_motors_of_a_vehicle_that_was_flying_a_moment_ago() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.FORMATION)
    autopilot.state = replace(autopilot.state, landed=LandedState.ON_GROUND)
    assert machine.abort(now_s, autopilot.state) == (True, "lands")
    for step in range(10):
        autopilot.obey(tick(machine, now_s + 0.02 * step, autopilot.state, ()))
    assert Disarm() not in autopilot.asked


@pytest.mark.parametrize("mode", [AutopilotMode.OTHER, AutopilotMode.LAND, AutopilotMode.RETURN])
def test_abort_leaves_a_vehicle_to_its_pilot(mode: AutopilotMode) -> None:
    machine = PhaseMachine(2.5)
    piloted = replace(AIR, mode=mode, mode_name="POSCTL")
    assert machine.abort(0.0, piloted) == (True, "left to who flies it, in mode POSCTL")
    assert tick(machine, 0.0, piloted, ()) == ()


def test_abort_before_the_autopilots_heartbeat_asks_nothing() -> None:
    machine = PhaseMachine(2.5)
    assert not machine.abort(0.0, replace(GROUND, autopilot=None))[0]


def test_on_the_ground_a_landing_waits_for_the_disarming_whatever_the_mode() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.HOLD)
    machine.command(CommandName.LAND, now_s, autopilot.state)
    autopilot.obey(tick(machine, now_s, autopilot.state, ()))
    down = replace(autopilot.state, mode=AutopilotMode.HOLD, landed=LandedState.ON_GROUND)
    tick(machine, now_s + 5.0, down, ())
    assert machine.phase is FlightPhase.LAND
    tick(machine, now_s + 6.0, replace(down, armed=False), ())
    assert machine.phase is FlightPhase.OBSERVE
    assert "someone else" not in machine.events[-1]


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


def test_after_a_restart_in_the_air_nothing_is_asked_and_arming_is_refused() -> None:
    machine = PhaseMachine(2.5)
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
    accepted, reason = machine.command(CommandName.TAKEOFF, now_s, replace(autopilot.state, altitude_amsl_m=None))
    assert not accepted
    assert "altitude" in reason
    assert machine.phase is FlightPhase.ARMED


def test_a_refusal_is_relayed_in_words_and_retries_are_bounded() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.READY)
    machine.command(CommandName.ARM, now_s, autopilot.state)
    refusal = AckSample(0.0, (Arm, Disarm), False, "COMPONENT_ARM_DISARM temporarily rejected")
    asked = 0
    for count in range(1000):
        asked += len(tick(machine, now_s + 0.02 * count, autopilot.state, [refusal]))
    assert 5 <= asked <= 12
    assert machine.phase is FlightPhase.READY
    assert "COMPONENT_ARM_DISARM temporarily rejected" in machine.events[-1]


def test_a_hold_asked_for_just_after_offboard_stays_a_hold() -> None:
    """The OFFBOARD request may overtake the hold: the agent must then ask again instead of thinking itself held."""
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


def test_the_failsafe_table_over_every_set_of_flags() -> None:
    assert set(ACTIONS) == set(HealthFlag)
    flags = list(HealthFlag)
    for chosen in chain.from_iterable(combinations(flags, r) for r in range(len(flags) + 1)):
        action = failsafe_action(chosen)
        assert action == max((ACTIONS[f] for f in chosen), default=FailsafeAction.NONE)
        assert (action is FailsafeAction.NONE) is (set(chosen) <= {HealthFlag.LEADER_AWAITED})


def test_on_the_ground_no_landing_is_asked_for_again() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.HOLD)
    machine.command(CommandName.LAND, now_s, autopilot.state)
    autopilot.obey(tick(machine, now_s, autopilot.state, ()))
    tick(machine, now_s + 0.02, autopilot.state, ())
    down = replace(autopilot.state, mode=AutopilotMode.OTHER, mode_name="POSCTL", landed=LandedState.ON_GROUND)
    for count in range(500):
        assert tick(machine, now_s + 5.0 + 0.02 * count, down, ()) == ()


def test_it_never_arms_again_what_the_pilot_disarmed() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.READY)
    machine.command(CommandName.ARM, now_s, autopilot.state)
    assert tick(machine, now_s, autopilot.state, ()) == (Arm(),)
    accepted = AckSample(0.0, (Arm, Disarm), True, "COMPONENT_ARM_DISARM accepted")
    assert tick(machine, now_s + 0.02, autopilot.state, (accepted,)) == ()
    for count in range(2, 600):  # disarmed before any heartbeat showed it armed
        assert tick(machine, now_s + 0.02 * count, autopilot.state, ()) == ()
    assert machine.phase is FlightPhase.READY


def test_the_reason_of_a_failure_is_not_another_commands() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.READY)
    machine.command(CommandName.ARM, now_s, autopilot.state)
    other = AckSample(0.0, (RequestOrigin,), False, "REQUEST_MESSAGE denied")
    for count in range(600):
        tick(machine, now_s + 0.02 * count, autopilot.state, (other,))
    assert machine.events[-1] == "arm -> ready (arm failed: no answer from the autopilot)"


def test_what_was_true_before_it_was_asked_for_does_not_count() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.HOLD)
    machine.command(CommandName.FORM, now_s, autopilot.state)
    old = replace(autopilot.state, mode=AutopilotMode.OFFBOARD, mode_time_s=now_s + 0.1)
    for count in range(30):
        tick(machine, now_s + 0.02 * count, old, ())
    assert machine.phase is FlightPhase.ENGAGE
    tick(machine, now_s + 0.7, replace(old, mode_time_s=now_s + 0.7), ())
    assert machine.phase is FlightPhase.FORMATION


def test_setpoints_stream_for_a_while_before_offboard_is_asked_for() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.HOLD)
    machine.command(CommandName.FORM, now_s, autopilot.state)
    for count in range(14):
        assert tick(machine, now_s + 0.02 * count, autopilot.state, ()) == ()
        assert machine.streams(autopilot.state)


@pytest.mark.parametrize("phase", [FlightPhase.READY, FlightPhase.ARMED])
def test_a_pilot_who_takes_off_is_noticed_and_can_be_landed(phase: FlightPhase) -> None:
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
    assert "disarmed" in machine.events[-1]


def test_a_mode_that_someone_sets_on_the_ground_is_noticed() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.READY)
    tick(machine, now_s, replace(autopilot.state, mode=AutopilotMode.OTHER, mode_name="MANUAL"), ())
    assert machine.phase is FlightPhase.OBSERVE


def test_a_climb_is_done_at_its_height() -> None:
    machine, autopilot, now_s = flown_to(FlightPhase.ARMED)
    machine.command(CommandName.TAKEOFF, now_s, autopilot.state)
    tick(machine, now_s, autopilot.state, ())
    low = replace(AIR, position_enu_m=(0.0, 0.0, 1.0))
    tick(machine, now_s + 1.0, low, ())
    assert machine.phase is FlightPhase.TAKEOFF
    tick(machine, now_s + 2.0, AIR, ())
    assert machine.phase is FlightPhase.HOLD


def test_a_mode_that_px4_tells_twice_a_second_is_never_too_old() -> None:
    """Measured: 0.51 to 0.53 s from one CURRENT_MODE to the next, whatever rate was asked for."""
    limits = EnvelopeLimits(0.5, 7.0, 0.3, 1.6, 10.0, (-9.0, -9.0, -9.0), (9.0, 9.0, 9.0))
    vehicle = VehicleState(position_time_s=9.99, attitude_time_s=9.99, mode_time_s=10.0 - 0.53, heartbeat_time_s=9.5)
    flags = health_flags(10.0, vehicle, None, AgeLimits(), limits)
    assert HealthFlag.MODE_STALE not in flags
    silent = health_flags(10.0, replace(vehicle, mode_time_s=10.0 - 0.9), None, AgeLimits(), limits)
    assert HealthFlag.MODE_STALE in silent
