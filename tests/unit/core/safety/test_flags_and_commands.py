"""Whole agents: the commands that each flag refuses in the phase that allows them, and a stopping agent in each phase."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from agent_on_bytes import BOTH, FlightOnBytes
from companion.core.safety.safeguard import Safety
from companion.types.autopilot import AutopilotKind
from companion.types.commands import CommandName
from companion.types.flight import FLAG_TEXTS, FlightPhase, HealthFlag
from companion.types.notices import Code

C, P, F = CommandName, FlightPhase, HealthFlag
# The phase that each command is given in.
GIVEN_IN = {
    C.PREPARE: P.OBSERVE,
    C.ARM: P.READY,
    C.TAKEOFF: P.ARMED,
    C.FORM: P.HOLD,
    C.DISARM: P.ARMED,
    C.HOLD: P.FORMATION,
    C.LAND: P.HOLD,
    C.RETURN: P.HOLD,
    C.ABORT: P.FORMATION,
}
TELEMETRY = (
    *("ATTITUDE_QUATERNION", "EXTENDED_SYS_STATE", "SYS_STATUS", "CURRENT_MODE", "HEARTBEAT", "LOCAL_POSITION_NED"),
    *("COMMAND_ACK",),
)
OF_THE_FLEET = {
    F.LEADER_AWAITED,
    F.LEADER_LOST,
    F.FLEET_LINK_LOST,
    F.SEPARATION_VIOLATED,
    F.NOT_SHAKEN_OFF,
    F.PEER_IN_DOUBT,
}
REFUSES: dict[CommandName, set[HealthFlag]] = {
    C.PREPARE: set(F) - OF_THE_FLEET,
    C.ARM: set(F) - OF_THE_FLEET,
    C.TAKEOFF: set(F) - OF_THE_FLEET,
    C.FORM: set(F),
    C.RETURN: {
        *(F.POSITION_STALE, F.FRAME_UNKNOWN, F.GROUND_UNKNOWN, F.FRAME_CONTRADICTED, F.POSITION_JUMPED),
        F.POSITION_UNAIDED,
    },
    C.DISARM: set(),
    C.HOLD: set(),
    C.LAND: set(),
    C.ABORT: set(),
}

OWN_MODE = {  # AUTO.LAND and AUTO.RTL; LAND and RTL
    (AutopilotKind.PX4, C.LAND): 4 << 16 | 6 << 24,
    (AutopilotKind.PX4, C.RETURN): 4 << 16 | 5 << 24,
    (AutopilotKind.ARDUPILOT, C.LAND): 9,
    (AutopilotKind.ARDUPILOT, C.RETURN): 6,
}


def raise_flags(flight: FlightOnBytes, flags: set[HealthFlag]) -> None:
    """From now on the safeguard reports these flags besides its own; `flags` may change later."""
    safeguard: Any = flight.agent.safeguard
    step = safeguard.step

    def with_flags(*arguments: Any) -> Safety:
        safety: Safety = step(*arguments)
        return replace(safety, flags=safety.flags | flags)

    safeguard.step = with_flags


@BOTH
@pytest.mark.parametrize("name", GIVEN_IN)
def test_the_commands_that_each_flag_refuses(kind: AutopilotKind, name: CommandName) -> None:
    flight, phase = FlightOnBytes(kind).fly_to(GIVEN_IN[name]), GIVEN_IN[name]
    flags: set[HealthFlag] = set()
    raise_flags(flight, flags)
    for flag in sorted(REFUSES[name]):
        flags.add(flag)
        flight.tick(name)
        accepted, code, reason = flight.replies[-1]
        assert (accepted, code) == (False, Code(flag))
        assert FLAG_TEXTS[flag] in reason
        assert flight.agent.phase is phase
        flags.remove(flag)
    flags |= set(F) - REFUSES[name]
    flight.tick(name)
    assert flight.replies[-1][0], flight.replies[-1]
    assert flight.agent.phase is not phase


@BOTH
@pytest.mark.parametrize("name", [name for name in GIVEN_IN if REFUSES[name]])
def test_a_command_that_several_flags_refuse_names_all_of_them(kind: AutopilotKind, name: CommandName) -> None:
    flight = FlightOnBytes(kind).fly_to(GIVEN_IN[name])
    raise_flags(flight, set(F))
    flight.tick(name)
    accepted, _code, reason = flight.replies[-1]
    assert not accepted
    assert all(FLAG_TEXTS[flag] in reason for flag in REFUSES[name])


def test_each_command_that_changes_the_phase_stands_here() -> None:
    contents = {C.LEAD, C.FORMATION, C.REFERENCE, C.TAKE}
    assert set(GIVEN_IN) == set(REFUSES) == set(C) - contents


@BOTH
@pytest.mark.parametrize("phase", [P.OBSERVE, P.READY, P.ARMED, P.HOLD])
def test_a_stopping_agent_leaves_a_vehicle_alone_that_it_does_not_fly(kind: AutopilotKind, phase: FlightPhase) -> None:
    flight = FlightOnBytes(kind).fly_to(phase)
    commands, targets = len(flight.autopilot.commands), len(flight.autopilot.targets)
    flight.stopping = True
    flight.ticks(4.0)
    assert flight.agent.phase is phase
    assert flight.agent.has_handed_over
    assert (len(flight.autopilot.commands), len(flight.autopilot.targets)) == (commands, targets)


@BOTH
def test_a_stopping_agent_whose_autopilot_has_ended_does_not_wait_for_it(kind: AutopilotKind) -> None:
    flight = FlightOnBytes(kind).fly_to(P.FORMATION)
    flight.stopping = True
    flight.autopilot.withheld = TELEMETRY
    flight.ticks(1.3)  # it may be the link
    assert not flight.agent.has_handed_over
    flight.ticks(0.5)
    assert flight.agent.has_handed_over
    assert flight.events[-1].code is Code.HAND_OVER_FAILED


@BOTH
@pytest.mark.parametrize("name", [None, C.HOLD, C.LAND, C.RETURN])
def test_a_stopping_agent_hands_over_the_stream_of_every_phase(kind: AutopilotKind, name: CommandName | None) -> None:
    """Out of formation by hold. A hold, a landing or a return that has begun is completed."""
    flight = FlightOnBytes(kind).fly_to(P.FORMATION)
    if name:
        flight.tick(name)
    flight.stopping = True
    flight.ticks(1.0)
    wanted = {None: P.HOLD, C.HOLD: P.HOLD, C.LAND: P.LAND, C.RETURN: P.RETURN}[name]
    assert flight.agent.phase is wanted
    assert flight.agent.has_handed_over
    assert flight.events[-1].code is not Code.PROCEDURE_FAILED
    target = flight.autopilot.targets[-1]
    assert max(abs(component) for component in target.q[1:3]) < 1e-6


@BOTH
@pytest.mark.parametrize("name", [C.LAND, C.RETURN])
def test_a_flag_in_the_first_moments_of_a_landing_or_return_does_not_end_it(
    kind: AutopilotKind, name: CommandName
) -> None:
    """A flag that holds at once in formation, while setpoints are still sent: the autopilot's mode is requested after them."""
    flight = FlightOnBytes(kind).fly_to(P.FORMATION)
    flight.tick(name)
    sent = len(flight.autopilot.targets)
    flight.autopilot.up_m = 60.0  # above the fence
    flight.ticks(0.1)
    assert flight.status is not None
    assert F.OUTSIDE_FENCE in flight.status.safety.flags
    assert len(flight.autopilot.targets) > sent
    flight.ticks(1.0)
    assert flight.agent.phase is {C.LAND: P.LAND, C.RETURN: P.RETURN}[name]
    assert flight.autopilot.custom_mode == OWN_MODE[kind, name]


def test_a_command_in_the_wrong_phase_is_refused_for_the_phase_and_not_for_a_flag() -> None:
    """On the ground no vehicle has a leader beacon: `form` needs a take-off, not a leader."""
    flight = FlightOnBytes(AutopilotKind.PX4).fly_to(P.READY)
    raise_flags(flight, {F.LEADER_LOST})
    flight.tick(C.FORM)
    assert flight.replies[-1][:2] == (False, Code.WRONG_PHASE)
    flight.tick(C.PREPARE)  # done already
    assert flight.replies[-1][:2] == (True, Code.ALREADY_DONE)
