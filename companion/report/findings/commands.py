"""Refused: commands that a vehicle refused or that have no answer."""

from __future__ import annotations

from collections.abc import Iterator

from companion.report.finding import Finding, FindingKind, Severity, finding
from companion.report.flight import GivenCommand, VehicleLog
from companion.types.notices import Code

GIVEN_AGAIN_S = 5.0


def refused_commands(vehicle: VehicleLog) -> Iterator[Finding]:
    """One finding for each command; its code is that of the answer. One that was accepted soon after is information."""
    for command in vehicle.commands:
        label = f"command {command.name} (number {command.number}, {command.operator})"
        if command.answered_s is None:
            text = f"{label} has no recorded answer"
            yield finding(
                FindingKind.REFUSED, Severity.WARNING, Code.NO_REPLY, vehicle.vehicle_id, command.time_s, text
            )
        elif not command.accepted and command.code is not None:
            again_s = _accepted_after_s(vehicle, command)
            text = f"{label} refused: {command.text}" + ("" if again_s is None else f"; accepted {again_s:.1f} s later")
            severity = Severity.WARNING if again_s is None else Severity.INFO
            yield finding(FindingKind.REFUSED, severity, command.code, vehicle.vehicle_id, command.time_s, text)


def _accepted_after_s(vehicle: VehicleLog, refused: GivenCommand) -> float | None:
    """After what time the same operator gave the same command with success; None if not soon."""
    after_s = [
        one.time_s - refused.time_s
        for one in vehicle.commands
        if one.accepted and (one.name, one.operator) == (refused.name, refused.operator)
    ]
    return min((time_s for time_s in after_s if 0.0 <= time_s <= GIVEN_AGAIN_S), default=None)
