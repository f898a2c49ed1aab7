"""Who commands, and which commands are new: alone, and in front of a whole agent."""

import pytest
from msgspec.structs import replace
from test_agent import SESSION, Flight

from companion.core.command_desk import NUMBERS_AHEAD, CommandDesk
from companion.types import Command, CommandName, CommandReply, FlightPhase

C = CommandName


def command(number: int, operator: str = "anna", name: CommandName = C.HOLD, session: int = 7) -> Command:
    return Command(name, number, operator, session)


def refusal(desk: CommandDesk, given: Command) -> str:
    """In words; "" where it is to be obeyed."""
    answer = desk.take_in(given).answer
    assert answer is None or answer[0] is False
    return answer[1] if answer else ""


def test_the_first_operator_holds_command_and_another_is_told_who_that_is() -> None:
    desk = CommandDesk(session=7)
    assert desk.holder == ""
    assert refusal(desk, command(5)) == ""
    assert (desk.holder, desk.number) == ("anna", 5)
    assert refusal(desk, command(6, "boris")) == ("hold: anna holds command; take it over with: companion fleet take")
    assert (desk.holder, desk.number) == ("anna", 5)
    assert refusal(desk, command(6)) == ""
    assert desk.events == ["anna holds command"]


def test_command_is_taken_over_by_saying_so() -> None:
    desk = CommandDesk(session=7)
    desk.take_in(command(5))
    taken = desk.take_in(command(6, "boris", C.TAKE))
    assert taken.answer == (True, "boris takes command from anna")
    assert desk.holder == "boris"
    assert "boris holds command" in refusal(desk, command(7))
    assert refusal(desk, command(7, "boris")) == ""
    assert desk.take_in(command(8, "boris", C.TAKE)).answer == (True, "boris holds command already")
    assert desk.events[:2] == ["anna holds command", "boris takes command from anna"]


def test_a_command_of_nobodys_vehicle_can_be_taken() -> None:
    desk = CommandDesk(session=7)
    assert desk.take_in(command(1, "boris", C.TAKE)).answer == (True, "boris holds command")


@pytest.mark.parametrize("number", [1, 4, 5])
def test_an_old_command_is_refused_whoever_gave_it(number: int) -> None:
    desk = CommandDesk(session=7)
    desk.take_in(command(4, name=C.TAKEOFF))
    desk.take_in(command(5, "boris", C.TAKE))
    for name, operator in ((C.TAKE, "anna"), (C.ABORT, "anna"), (C.LAND, "boris")):
        expected = f"{name}: old command: number {number} is not newer than 5"
        assert refusal(desk, command(number, operator, name)) == expected
    assert (desk.holder, desk.number) == ("boris", 5)


def test_a_refused_command_is_used_up_as_well() -> None:
    """What was refused when it was given must not be obeyed when it is given again later."""
    desk = CommandDesk(session=7)
    order = desk.take_in(command(4, name=C.TAKEOFF))
    order.answer = (False, "the battery is empty")
    desk.take_in(command(5))
    assert "old command" in refusal(desk, command(4, name=C.TAKEOFF))


def test_the_very_last_command_again_gets_its_answer_again() -> None:
    desk = CommandDesk(session=7)
    order = desk.take_in(command(4))
    order.answer = (True, "release")
    assert desk.take_in(command(4)) is order
    assert "old command" in refusal(desk, command(4, name=C.LAND))  # another one with its number is not it


def test_a_command_for_another_start_of_the_agent_is_refused() -> None:
    desk = CommandDesk(session=7)
    for name in C:
        assert "earlier start" in refusal(desk, command(4, name=name, session=8))
    assert (desk.holder, desk.number) == ("", 0)


def test_one_wrong_number_does_not_use_up_all_that_are_left() -> None:
    desk = CommandDesk(session=7)
    assert "too large" in refusal(desk, command(NUMBERS_AHEAD + 1))
    assert refusal(desk, command(NUMBERS_AHEAD)) == ""
    assert refusal(desk, command(NUMBERS_AHEAD + 1)) == ""


def test_everybody_may_abort_and_holds_no_command_for_that() -> None:
    desk = CommandDesk(session=7)
    assert refusal(desk, command(1, "carla", C.ABORT)) == ""
    assert desk.holder == ""
    desk.take_in(command(2))
    assert refusal(desk, command(3, "carla", C.ABORT)) == ""
    assert desk.holder == "anna"
    assert desk.events[-1] == "carla aborts; anna holds command"
    assert "old command" in refusal(desk, command(2, "carla", C.ABORT))


# ---------------------------------------------------------------- in front of an agent


def test_two_operators_cannot_fight_over_a_flying_vehicle() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    outbox = flight.tick(given=(flight.command(C.LAND, "boris"), flight.command(C.FORM)))
    assert [(reply.accepted, reply.reason) for reply in outbox.replies] == [
        (False, "land: anna@ground holds command; take it over with: companion fleet take"),
        (True, "already formation"),
    ]
    assert flight.agent.phase is FlightPhase.FORMATION
    flight.tick(given=(flight.command(C.TAKE, "boris"),))
    assert "boris takes command from anna@ground" in flight.events
    assert flight.tick(given=(flight.command(C.LAND, "boris"),)).replies[0].accepted
    assert flight.agent.phase is FlightPhase.LAND


def test_a_recorded_take_off_does_not_start_a_vehicle_again() -> None:
    flight = Flight()
    flight.tick()
    prepare = flight.command(C.PREPARE)
    first = flight.tick(given=(prepare, prepare)).replies
    assert first == (CommandReply(2, prepare.number, True, "prepare"),) * 2
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
    assert ["old command" in reply.reason for reply in replies] == [True, True, False]
    assert flight.agent.phase is FlightPhase.OBSERVE


def test_the_status_tells_who_holds_command_and_what_the_vehicle_hears() -> None:
    flight = Flight()
    for _ in range(20):
        flight.tick()
    flight.tick(C.PREPARE)
    status = next(status for _ in range(10) if (status := flight.tick().status))
    assert (status.holder, status.command_number, status.session) == ("anna@ground", 1, SESSION)
    assert (status.peers, status.battery_percent) == ((1,), 90.0)


def test_abort_reaches_a_flying_agent_whose_data_is_stale() -> None:
    flight = Flight().fly_to(FlightPhase.FORMATION)
    reply = flight.tick(telemetry=[], given=(flight.command(C.ABORT, "carla"),)).replies[0]
    assert reply.accepted, reply.reason
    for _ in range(50):
        flight.tick()
    assert flight.agent.phase is FlightPhase.HOLD


def test_nobody_arms_beside_another_vehicle() -> None:
    flight = Flight()
    flight.peer_position, flight.peer_phase = (-1.5, 0.4, 0.0), FlightPhase.OBSERVE
    flight.tick()
    flight.tick(C.PREPARE)
    for _ in range(50):
        flight.tick()
    reply = flight.tick(C.ARM).replies[0]
    assert not reply.accepted
    assert reply.reason == (
        "arm: separation: in the plane vehicle 1 is 0.40 m from vehicle 2; expected at least separation_m, 1 m"
    )
    status = next(status for _ in range(10) if (status := flight.tick().status))
    assert any(words.startswith("separation: ") for words in status.lacks)
