"""Command arbitration: holder of command and command numbers, alone and within an agent."""

import pytest
from msgspec.structs import replace

from common import codes_of, outcome, texts_of
from companion.core.command.arbitration import NUMBERS_AHEAD, CommandArbitration
from companion.types.commands import Command, CommandName, CommandReply
from companion.types.flight import FlightPhase
from companion.types.notices import Code, Notice, accept, refuse
from one_agent import SESSION, AgentFlight

C = CommandName


def command(number: int, operator: str = "anna", name: CommandName = C.HOLD, session: int = 7) -> Command:
    return Command(name, number, operator, session)


def refusal(arbitration: CommandArbitration, given: Command) -> Code | None:
    """Code of the refusal; None for a command to execute."""
    answer, _ = arbitration.admit(given)
    assert answer is None or answer[0] is False
    return answer.notice.code if answer else None


def test_the_first_operator_holds_command_and_another_is_refused() -> None:
    arbitration = CommandArbitration(session=7)
    assert arbitration.holder == ""
    _, events = arbitration.admit(command(5))
    assert texts_of(events) == ["anna holds command"]
    assert (arbitration.holder, arbitration.number) == ("anna", 5)
    assert refusal(arbitration, command(6, "boris")) is Code.OTHER_HOLDS_COMMAND
    assert (arbitration.holder, arbitration.number) == ("anna", 5)
    assert refusal(arbitration, command(6)) is None


def test_command_is_taken_over_by_take() -> None:
    arbitration = CommandArbitration(session=7)
    arbitration.admit(command(5))
    taken, events = arbitration.admit(command(6, "boris", C.TAKE))
    assert texts_of(events) == ["boris takes command from anna"]
    assert outcome(taken) == (True, Code.COMMAND_TAKEN)
    assert arbitration.holder == "boris"
    assert refusal(arbitration, command(7)) is Code.OTHER_HOLDS_COMMAND
    assert refusal(arbitration, command(7, "boris")) is None
    assert outcome(arbitration.admit(command(8, "boris", C.TAKE))[0]) == (True, Code.COMMAND_TAKEN)


def test_command_can_be_taken_when_no_operator_holds_it() -> None:
    arbitration = CommandArbitration(session=7)
    assert outcome(arbitration.admit(command(1, "boris", C.TAKE))[0]) == (True, Code.COMMAND_TAKEN)


@pytest.mark.parametrize("number", [1, 4, 5])
def test_an_old_command_is_refused_from_any_operator(number: int) -> None:
    arbitration = CommandArbitration(session=7)
    arbitration.admit(command(4, name=C.TAKEOFF))
    arbitration.admit(command(5, "boris", C.TAKE))
    for name, operator in ((C.TAKE, "anna"), (C.LAND, "boris")):
        assert refusal(arbitration, command(number, operator, name)) is Code.COMMAND_OLD
    assert (arbitration.holder, arbitration.number) == ("boris", 5)


def test_a_refused_command_cannot_be_repeated_later() -> None:
    """A recorded refused command must not be executed later."""
    arbitration = CommandArbitration(session=7)
    intake = arbitration.step((command(4, name=C.TAKEOFF),))
    arbitration.replies(1, intake, [(4, refuse(Code.BATTERY_LOW, "the battery is empty"))])
    arbitration.admit(command(5))
    assert refusal(arbitration, command(4, name=C.TAKEOFF)) is Code.COMMAND_OLD


def test_the_last_command_repeated_gets_its_answer_again() -> None:
    arbitration = CommandArbitration(session=7)
    answer = accept(Code.PHASE_CHANGED, "release")
    arbitration.replies(1, arbitration.step((command(4),)), [(4, answer)])
    assert arbitration.admit(command(4)) == (answer, ())
    assert refusal(arbitration, command(4, name=C.LAND)) is Code.COMMAND_OLD  # a different command with its number


def test_a_command_for_another_start_of_the_agent_is_refused() -> None:
    arbitration = CommandArbitration(session=7)
    for name in C:
        assert refusal(arbitration, command(4, name=name, session=8)) is Code.WRONG_SESSION
    assert (arbitration.holder, arbitration.number) == ("", 0)


def test_a_number_too_far_ahead_is_refused() -> None:
    arbitration = CommandArbitration(session=7)
    assert refusal(arbitration, command(NUMBERS_AHEAD + 1)) is Code.COMMAND_NUMBER_TOO_LARGE
    assert refusal(arbitration, command(NUMBERS_AHEAD)) is None
    assert refusal(arbitration, command(NUMBERS_AHEAD + 1)) is None


@pytest.mark.parametrize(
    "abort",
    [
        command(1, "carla", C.ABORT),
        command(2**62, "carla", C.ABORT),
        command(5, "carla", C.ABORT, session=99),
        command(5, "anna", C.ABORT, session=0),
    ],
)
def test_an_abort_needs_neither_command_nor_number_nor_session(abort: Command) -> None:
    arbitration = CommandArbitration(session=7)
    arbitration.step((command(5),))
    intake = arbitration.step((abort,))
    assert [admitted.name for admitted in intake.admitted] == [C.ABORT]
    assert (arbitration.holder, arbitration.number) == ("anna", 5)
    assert refusal(arbitration, command(6)) is None  # the next command has the next number


def test_aborts_of_one_tick_are_executed_once_and_all_are_answered() -> None:
    arbitration = CommandArbitration(session=7)
    hold, first, second = command(5), command(5, "boris", C.ABORT), command(9, "carla", C.ABORT)
    intake = arbitration.step((hold, first, second))
    assert [admitted.name for admitted in intake.admitted] == [C.ABORT]
    answers = [(admitted.number, accept(Code.ALREADY_DONE, "")) for admitted in intake.admitted]
    replies = arbitration.replies(1, intake, answers)
    assert [(reply.number, reply.code) for reply in replies] == [
        (5, Code.ABORTED),
        (5, Code.ALREADY_DONE),
        (9, Code.ALREADY_DONE),
    ]


@pytest.mark.parametrize("name", [C.RETURN, C.LAND])
def test_an_abort_goes_before_the_other_commands_of_its_tick(name: CommandName) -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    other = flight.command(name)
    outbox = flight.tick(given=(flight.command(C.ABORT), other))
    assert [(reply.number, reply.accepted) for reply in outbox.replies if reply.number == other.number] == [
        (other.number, False)
    ]
    assert flight.tick(given=(other,)).replies[0].code is Code.ABORTED  # sent again, because the reply may be lost
    for _ in range(50):
        flight.tick()
    assert flight.agent.phase is FlightPhase.HOLD


def test_a_command_is_answered_once_ticks_later_when_its_check_is_done() -> None:
    arbitration = CommandArbitration(session=7)
    given = command(4, name=C.REFERENCE)
    assert arbitration.replies(1, arbitration.step((given,)), ()) == ()
    repeated = arbitration.step((given,))
    assert repeated.admitted == ()
    assert arbitration.replies(1, repeated, ()) == ()
    answer = (4, accept(Code.REFERENCE_ACCEPTED, ""))
    assert [reply.number for reply in arbitration.replies(1, arbitration.step(()), [answer])] == [4]
    assert arbitration.replies(1, arbitration.step(()), ()) == ()
    again = arbitration.step((given,))
    assert [reply.code for reply in arbitration.replies(1, again, ())] == [Code.REFERENCE_ACCEPTED]


def test_the_repeated_abort_of_another_operator_is_one_event() -> None:
    arbitration = CommandArbitration(session=7)
    arbitration.step((command(2),))
    events = [event for _ in range(5) for event in arbitration.step((command(1, "carla", C.ABORT),)).events]
    assert events == [Notice(Code.ABORT_BY_OTHER, "carla aborts; anna holds command")]
    assert arbitration.step((command(1, name=C.ABORT),)).events == ()


# ---------------------------------------------------------------- within an agent


def test_a_second_operator_is_refused_in_flight() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    outbox = flight.tick(given=(flight.command(C.LAND, "boris"), flight.command(C.FORM)))
    assert list(map(outcome, outbox.replies)) == [(False, Code.OTHER_HOLDS_COMMAND), (True, Code.ALREADY_DONE)]
    assert flight.agent.phase is FlightPhase.FORMATION
    flight.tick(given=(flight.command(C.TAKE, "boris"),))
    assert Notice(Code.COMMAND_TAKEN, "boris takes command from anna@ground") in flight.events
    assert flight.tick(given=(flight.command(C.LAND, "boris"),)).replies[0].accepted
    assert flight.agent.phase is FlightPhase.LAND


def test_a_recorded_take_off_is_refused() -> None:
    flight = AgentFlight()
    flight.tick()
    prepare = flight.command(C.PREPARE)
    first = flight.tick(given=(prepare, prepare)).replies
    assert first == (CommandReply(2, prepare.number, True, Code.PHASE_CHANGED, "prepare begins", "anna@ground"),) * 2
    assert flight.tick(given=(prepare,)).replies == first[:1]  # its answer may have been lost
    flight.tick(C.DISARM)
    for _ in range(50):
        flight.tick()
    assert flight.agent.phase is FlightPhase.OBSERVE
    replayed = [
        prepare,
        replace(prepare, number=prepare.number + 1),
        replace(flight.command(C.PREPARE), session=SESSION + 1),
    ]
    replies = flight.tick(given=tuple(replayed)).replies
    assert [reply.accepted for reply in replies] == [False] * 3
    assert [reply.code is Code.COMMAND_OLD for reply in replies] == [True, True, False]
    assert flight.agent.phase is FlightPhase.OBSERVE


def test_the_status_has_the_holder_of_command_and_the_peers() -> None:
    flight = AgentFlight()
    for _ in range(20):
        flight.tick()
    flight.tick(C.PREPARE)
    status = next(status for _ in range(10) if (status := flight.tick().status))
    assert (status.command.holder, status.command.command_number, status.agent.session) == ("anna@ground", 1, SESSION)
    assert (status.neighbourhood.peers, status.autopilot.battery_percent) == ((1,), 90.0)


def test_abort_is_executed_when_telemetry_is_stale() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    reply = flight.tick(telemetry=[], given=(flight.command(C.ABORT, "carla"),)).replies[0]
    assert reply.accepted, reply.reason
    for _ in range(50):
        flight.tick()
    assert flight.agent.phase is FlightPhase.HOLD


def test_a_repeated_abort_changes_nothing_more() -> None:
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    for _ in range(100):
        assert flight.tick(C.ABORT).replies[0].accepted
    assert flight.agent.phase is FlightPhase.HOLD
    phases = [event.code for event in flight.events].count(Code.PHASE_CHANGED)
    for _ in range(100):
        assert flight.tick(C.ABORT).replies[0].accepted
    assert [event.code for event in flight.events].count(Code.PHASE_CHANGED) == phases


def test_a_repeated_abort_on_the_ground_makes_no_events() -> None:
    flight = AgentFlight()
    flight.tick()
    for _ in range(100):
        assert flight.tick(C.ABORT).replies[0].accepted
    assert flight.events == [Notice(Code.ABORT_BY_OTHER, "anna@ground aborts; no operator holds command")]
    assert flight.agent.phase is FlightPhase.OBSERVE


def test_arming_is_refused_beside_another_vehicle() -> None:
    flight = AgentFlight()
    flight.peer_position, flight.peer_phase = (-1.5, 0.4, 0.0), FlightPhase.OBSERVE
    flight.tick()
    flight.tick(C.PREPARE)
    for _ in range(50):
        flight.tick()
    reply = flight.tick(C.ARM).replies[0]
    assert outcome(reply) == (False, Code.VEHICLE_TOO_CLOSE)
    assert "vehicle 1 is 0.40 m from vehicle 2; expected at least separation_m, 1 m" in reply.reason
    status = next(status for _ in range(10) if (status := flight.tick().status))
    assert Code.VEHICLE_TOO_CLOSE in codes_of(status.safety.lacks)
