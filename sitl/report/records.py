"""What vehicles reported in a flight, and the commands that they were given, as rows of its summary and its figures."""

from __future__ import annotations

from msgspec import Struct

from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, Role
from companion.types.notices import Code
from companion.types.status import Status


class ReportedEvent(Struct, frozen=True, kw_only=True):
    """An event that a vehicle reported, `time_s` after the flight's beginning."""

    time_s: float
    vehicle: int
    code: Code
    event: str


class CommandGiven(Struct, frozen=True, kw_only=True):
    """A command to several vehicles at once, `time_s` after the flight's beginning.

    `answered_in_s` is the time until the last of them had answered; None if one did not.
    """

    time_s: float
    command: CommandName
    in_words: str  # with its arguments
    vehicles: list[int]
    answered_in_s: float | None


class TopologyChange(Struct, frozen=True, kw_only=True):
    """A vehicle's role and neighbours from `time_s` after the flight's beginning until its next change."""

    time_s: float
    vehicle: int
    role: Role
    epoch: int
    prc: int
    neighbours: tuple[int, ...]
    in_formation: bool

    def same_as(self, status: Status) -> bool:
        own = (self.role, self.epoch, self.prc, self.neighbours, self.in_formation)
        reported = (status.role, status.epoch, status.prc, status.neighbours, status.phase is FlightPhase.FORMATION)
        return own == reported
