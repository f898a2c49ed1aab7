"""Who commands this vehicle, and which commands are new: of two operators one is heard, and nothing recorded is obeyed again.

The first operator who asks for something holds command until another one takes it. Numbers of commands rise over all
operators: whoever asks knows the last one from the status, so that no clock need be right.
"""

from __future__ import annotations

from companion.types import Command, CommandName

NUMBERS_AHEAD = 10**13  # 300 years of milliseconds: one wrong number cannot use up all that are left

FOR_EVERYBODY = (CommandName.TAKE, CommandName.ABORT)  # nobody need hold command for these


class Order:
    """A command on its way through a tick. Whoever refuses or obeys it says in `answer`: accepted, and why or what happens."""

    __slots__ = ("answer", "command")

    def __init__(self, command: Command) -> None:
        self.command = command
        self.answer: tuple[bool, str] | None = None


class CommandDesk:
    """One vehicle's. `holder` is "" while nobody holds command; `number` is the last command's that came to be obeyed.

    `events` tells who takes command and who aborts without it, until somebody takes it.
    """

    def __init__(self, session: int) -> None:
        """`session` is drawn at the agent's start; commands for an earlier one are refused."""
        self._session = session
        self._last: Order | None = None
        self.holder = ""
        self.number = 0
        self.events: list[str] = []

    def take_in(self, command: Command) -> Order:
        """An order to be obeyed, or one with its answer: a refusal, a change of the holder, or the same command's before."""
        if self._last is not None and command == self._last.command:
            return self._last
        order = Order(command)
        if refusal := self._refusal(command):
            order.answer = (False, f"{command.name}: {refusal}")
            return order
        self.number, self._last = command.number, order
        if command.name is CommandName.TAKE:
            self.events.append(self._hand_to(command.operator))
            order.answer = (True, self.events[-1])
        elif not self.holder and command.name is not CommandName.ABORT:
            self.events.append(self._hand_to(command.operator))
        elif command.operator != self.holder:
            self.events.append(f"{command.operator} aborts; {self.holder or 'nobody'} holds command")
        return order

    def _refusal(self, command: Command) -> str:
        if command.session != self._session:
            return "meant for an earlier start of this vehicle's agent; give it again"
        if command.name not in FOR_EVERYBODY and self.holder not in ("", command.operator):
            return f"{self.holder} holds command; take it over with: companion fleet take"
        if command.number <= self.number:
            return f"old command: number {command.number} is not newer than {self.number}"
        if command.number > self.number + NUMBERS_AHEAD:
            return f"number {command.number} is too large; expected at most {self.number + NUMBERS_AHEAD}"
        return ""

    def _hand_to(self, operator: str) -> str:
        """In words."""
        before, self.holder = self.holder, operator
        if before == operator:
            return f"{operator} holds command already"
        return f"{operator} takes command from {before}" if before else f"{operator} holds command"
