"""Commands: arbitration (one operator holds command, none is executed twice) and clearance before the phase machine.

The first operator to give a command holds command until another operator takes it. Command numbers rise over all operators;
the status has the last one, so that they depend on no clock.

ABORT is idempotent. It is admitted from any operator, with any number and session, and changes neither the holder nor the last
number. The other commands of its tick are not executed, not even when they are sent again.

A command whose check takes several ticks is answered when it is done.

A check is a command that is judged and not executed. It needs the same session, and the operator who may command, and takes
nothing: neither command nor a number. So it is judged as often as it is sent.
"""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct
from msgspec.structs import replace

from companion.core.command.phase import PhaseCommand
from companion.core.consensus.stage import Consensus
from companion.core.formation.guidance import Guidance
from companion.core.preflight import Fitness
from companion.core.safety.failsafe import POSITION_IN_DOUBT, flags_notice
from companion.core.safety.fleet_checks import FleetChecks, id_shared
from companion.core.safety.safeguard import Safety
from companion.types.autopilot import VehicleState
from companion.types.commands import NOT_CHECKED, NUMBERS_AHEAD, Command, CommandName, CommandReply
from companion.types.flight import OF_THE_FLEET, RULES, HealthFlag, Role
from companion.types.notices import Answer, Code, Notice, refuse

ABORT_NUMBER = 0  # replaces the number of an abort, which another command may have


class Intake(Struct, frozen=True, gc=False):
    """The commands of one tick. `admitted` are to be executed; `answers` are in the order of `received`, None where due.

    `checks` are to be answered alone, under numbers below ABORT_NUMBER; `refused_checks` are answered already.
    """

    received: tuple[Command, ...] = ()
    admitted: tuple[Command, ...] = ()
    answers: tuple[Answer | None, ...] = ()
    events: tuple[Notice, ...] = ()
    holder: str = ""
    number: int = 0
    checks: tuple[Command, ...] = ()
    refused_checks: tuple[tuple[Command, Answer], ...] = ()


class CommandArbitration:
    """The operator who holds command ("" for none), and `number` of the last admitted command."""

    def __init__(self, session: int) -> None:
        """`session` is drawn at the agent's start; commands for an earlier one are refused."""
        self._session = session
        self._last: Command | None = None
        self._last_answer: Answer | None = None
        self.holder = ""
        self.number = 0
        self.idle = Intake()  # the result of every tick without commands
        self._unanswered: dict[int, Command] = {}  # commands whose check takes several ticks, by number
        self._aborted_by = ""  # operator of an abort since the last other command
        self._unanswered_checks: dict[int, Command] = {}  # by the number that they have within the agent
        self._check_number = ABORT_NUMBER

    def step(self, commands: tuple[Command, ...], checks: tuple[Command, ...] = ()) -> Intake:
        """Admit or answer the commands of one tick, and the checks of commands."""
        intake = self._admit_all(commands) if commands else self.idle
        return self._with_checks(intake, checks) if checks else intake

    def _admit_all(self, commands: tuple[Command, ...]) -> Intake:
        aborts = any(command.name is CommandName.ABORT for command in commands)
        admitted: list[Command] = []
        answers: list[Answer | None] = []
        events: tuple[Notice, ...] = ()
        for command in commands:
            if command.name is CommandName.ABORT:
                answers.append(None)
                events += self._abort(command)
                if not any(other.name is CommandName.ABORT for other in admitted):
                    admitted.append(replace(command, number=ABORT_NUMBER))
                continue
            repeated = command == self._last
            answer, changes = self.admit(command)
            if aborts and answer is None and not repeated:
                answer = self._last_answer = refuse(Code.ABORTED, f"{command.name}: an abort came at the same time")
            answers.append(answer)
            events += changes
            if answer is None and not repeated:
                admitted.append(command)
        self.idle = Intake(holder=self.holder, number=self.number)
        return Intake(commands, tuple(admitted), tuple(answers), events, self.holder, self.number)

    def _with_checks(self, intake: Intake, checks: tuple[Command, ...]) -> Intake:
        """One that is sent again before its answer is judged once."""
        judged, refused = [], []
        for check in checks:
            if check in self._unanswered_checks.values():
                continue
            refusal = self._refusal_of_sender(check)
            if check.name in NOT_CHECKED:
                refusal = Notice(Code.COMMAND_MALFORMED, "has no check")
            if refusal:
                refused.append((check, Answer(False, refusal.about(check.name))))
                continue
            self._check_number -= 1
            self._unanswered_checks[self._check_number] = check
            judged.append(replace(check, number=self._check_number))
        return replace(intake, checks=tuple(judged), refused_checks=tuple(refused))

    def replies(
        self, vehicle_id: int, intake: Intake, answers: Iterable[tuple[int, Answer]]
    ) -> tuple[CommandReply, ...]:
        """The replies to the commands of a tick, given the answers of the stages by command number.

        One that is not answered yet gets its reply when it is, also where it was not sent again meanwhile.
        """
        by_number = dict(answers)
        if self._last is not None:
            self._last_answer = by_number.get(self._last.number, self._last_answer)
        replies = []
        for command, known in zip(intake.received, intake.answers, strict=True):
            number = ABORT_NUMBER if command.name is CommandName.ABORT else command.number
            if answer := known or by_number.get(number):
                replies.append(_reply(vehicle_id, command, answer))
            else:
                self._unanswered[number] = command
            if known is None and number in by_number:
                self._unanswered.pop(number, None)
        answered = [number for number in self._unanswered if number in by_number]
        replies += [_reply(vehicle_id, self._unanswered.pop(number), by_number[number]) for number in answered]
        replies += [_reply(vehicle_id, check, answer) for check, answer in intake.refused_checks]
        checked = [number for number in self._unanswered_checks if number in by_number]
        replies += [
            _reply(vehicle_id, self._unanswered_checks.pop(number), _checked(by_number[number])) for number in checked
        ]
        return tuple(replies)

    def admit(self, command: Command) -> tuple[Answer | None, tuple[Notice, ...]]:
        """(answer, events) of a command other than ABORT. The answer is None for a command to execute.

        Else it is a refusal, a change of holder, or the answer given before to the same command.
        """
        if command == self._last:
            return self._last_answer, ()
        if refusal := self._refusal(command):
            return Answer(False, refusal.about(command.name)), ()
        self.number, self._last, self._last_answer, self._aborted_by = command.number, command, None, ""
        if command.name is CommandName.TAKE:
            held = self.holder == command.operator
            change = self._hand_to(command.operator)
            self._last_answer = Answer(True, change)
            return self._last_answer, () if held else (change,)
        if not self.holder:
            return None, (self._hand_to(command.operator),)
        return None, ()

    def _abort(self, command: Command) -> tuple[Notice, ...]:
        """The event of an ABORT by another operator than the holder: once, as it is repeated until all vehicles answer."""
        if command.operator in (self.holder, self._aborted_by):
            return ()
        self._aborted_by = command.operator
        text = f"{command.operator} aborts; {self.holder or 'no operator'} holds command"
        return (Notice(Code.ABORT_BY_OTHER, text),)

    def _refusal_of_sender(self, command: Command) -> Notice | None:
        if command.session != self._session:
            return Notice(Code.WRONG_SESSION, "it is for an earlier start of this vehicle's agent; give it again")
        if command.name is not CommandName.TAKE and self.holder not in ("", command.operator):
            text = f"{self.holder} holds command; take it over: companion fleet take, or Take command on the page"
            return Notice(Code.OTHER_HOLDS_COMMAND, text)
        return None

    def _refusal(self, command: Command) -> Notice | None:
        if refusal := self._refusal_of_sender(command):
            return refusal
        if command.number <= self.number:
            text = f"old command: number {command.number} is not newer than {self.number}"
            return Notice(Code.COMMAND_OLD, text)
        if command.number > self.number + NUMBERS_AHEAD:
            text = f"number {command.number} is too large; expected at most {self.number + NUMBERS_AHEAD}"
            return Notice(Code.COMMAND_NUMBER_TOO_LARGE, text)
        return None

    def _hand_to(self, operator: str) -> Notice:
        before, self.holder = self.holder, operator
        if before == operator:
            return Notice(Code.COMMAND_TAKEN, f"{operator} holds command already")
        text = f"{operator} takes command from {before}" if before else f"{operator} holds command"
        return Notice(Code.COMMAND_TAKEN, text)


def _reply(vehicle_id: int, command: Command, answer: Answer) -> CommandReply:
    notice = answer.notice
    return CommandReply(
        vehicle_id, command.number, answer.accepted, notice.code, notice.text, command.operator, notice.accepts
    )


def _checked(answer: Answer) -> Answer:
    """The answer to a check, by what the stages say to the command."""
    if not answer.accepted:
        return answer
    return Answer(True, Notice(Code.CHECK_PASSED, f"would be accepted: {answer.notice.text}"))


NEEDS_NOTHING = (CommandName.LAND, CommandName.HOLD, CommandName.DISARM)


class CommandDispatcher:
    """Checks of phase commands against this vehicle and the fleet. It holds no state."""

    def __init__(self, checks: FleetChecks) -> None:
        self._checks = checks

    def step(
        self,
        intake: Intake,
        vehicle: VehicleState,
        fitness: Fitness,
        consensus: Consensus,
        guidance: Guidance,
        safety: Safety,
    ) -> tuple[PhaseCommand, ...]:
        """The admitted commands that RULES or ABORT cover, each with what refuses it or goes with it as a warning.

        Then the checks of such commands.
        """
        admitted, checks = (
            [
                self._cleared(command, vehicle, fitness, consensus, guidance, safety)
                for command in commands
                if command.name in RULES or command.name is CommandName.ABORT
            ]
            for commands in (intake.admitted, intake.checks)
        )
        return *admitted, *[replace(check, is_check=True) for check in checks]

    def _cleared(
        self,
        command: Command,
        vehicle: VehicleState,
        fitness: Fitness,
        consensus: Consensus,
        guidance: Guidance,
        safety: Safety,
    ) -> PhaseCommand:
        name, number = command.name, command.number
        if name is CommandName.ABORT:
            return PhaseCommand(number, name)
        leaves_ground = RULES[name].on_ground and name not in NEEDS_NOTHING
        if leaves_ground and (shared := id_shared(vehicle)):  # the cause of what flags there are
            return PhaseCommand(number, name, unfit=shared.about(name))
        if unfit := _raised(name, safety.flags):
            return PhaseCommand(number, name, unfit=flags_notice(unfit).about(name))
        refusal, warning = self._judge(name, vehicle, fitness, consensus, guidance)
        return PhaseCommand(number, name, refusal=refusal and refusal.about(name), warning=warning)

    def _judge(
        self, name: CommandName, vehicle: VehicleState, fitness: Fitness, consensus: Consensus, guidance: Guidance
    ) -> tuple[Notice | None, Notice | None]:
        """(refusal, warning) of a command that is otherwise possible."""
        checks, peers = self._checks, consensus.peers.packets
        if name is CommandName.RETURN:
            refusal = checks.refusal_of_return(vehicle, consensus.peers.present.values(), consensus.lead.role)
            return refusal, checks.judge(name, vehicle, guidance.slot, peers, consensus.lead.role)[1]
        if name is CommandName.FORM and (refusal := _refusal_to_form(fitness, consensus, guidance)):
            return refusal, None
        refusal, warning = checks.judge(name, vehicle, guidance.slot, peers, consensus.lead.role)
        if name is CommandName.FORM and not refusal:
            refusal, warning = guidance.refusal_to_enter, _both(warning, guidance.warning_to_enter)
        return refusal, warning


def _refusal_to_form(fitness: Fitness, consensus: Consensus, guidance: Guidance) -> Notice | None:
    """The first of: preflight audit, and of a leader a reference that differs from the fleet's."""
    refusal = fitness.refusal
    if not refusal and consensus.lead.role is Role.LEADER:
        refusal = guidance.refusal_to_lead
    return refusal


def _both(first: Notice | None, second: Notice | None) -> Notice | None:
    """One notice with the code of the first and both texts."""
    if first is None or second is None:
        return first or second
    return Notice(first.code, f"{first.text}; {second.text}")


def _raised(name: CommandName, flags: frozenset[HealthFlag]) -> frozenset[HealthFlag]:
    """The flags that refuse a command. A return needs only a known position, all others a healthy vehicle.

    A fleet that is not received refuses no flight of a single vehicle, but its formation.
    """
    if name in NEEDS_NOTHING:
        return frozenset()
    if name is CommandName.RETURN:
        return flags & POSITION_IN_DOUBT
    return flags if name is CommandName.FORM else flags - OF_THE_FLEET
