"""Command clearance: the checks of a phase command before the phase machine executes it."""

from __future__ import annotations

from companion.core.command.arbitration import Intake
from companion.core.command.phase import PhaseCommand
from companion.core.consensus.stage import Consensus
from companion.core.estimation.vehicle import Perception
from companion.core.formation.guidance import Guidance
from companion.core.safety.failsafe import flags_notice
from companion.core.safety.fleet_checks import FleetChecks
from companion.core.safety.health import POSITION_IN_DOUBT
from companion.core.safety.return_check import refusal_of_return
from companion.core.safety.safeguard import Safety
from companion.types.commands import Command, CommandName
from companion.types.flight import OF_THE_FLEET, RULES, HealthFlag, Role
from companion.types.notices import Notice

NEEDS_NOTHING = (CommandName.LAND, CommandName.HOLD, CommandName.DISARM)


class CommandDispatcher:
    """Checks of phase commands against this vehicle and the fleet. It holds no state."""

    def __init__(self, checks: FleetChecks) -> None:
        self._checks = checks

    def step(
        self,
        intake: Intake,
        perception: Perception,
        consensus: Consensus,
        guidance: Guidance,
        safety: Safety,
    ) -> tuple[PhaseCommand, ...]:
        """The admitted commands that RULES or ABORT cover, each with what refuses it or goes with it as a warning."""
        if not intake.admitted:
            return ()
        return tuple(
            [
                self._cleared(command, perception, consensus, guidance, safety)
                for command in intake.admitted
                if command.name in RULES or command.name is CommandName.ABORT
            ]
        )

    def _cleared(
        self, command: Command, perception: Perception, consensus: Consensus, guidance: Guidance, safety: Safety
    ) -> PhaseCommand:
        name, number = command.name, command.number
        if name is CommandName.ABORT:
            return PhaseCommand(number, name)
        if unfit := _raised(name, safety.flags):
            return PhaseCommand(number, name, unfit=flags_notice(unfit).about(name))
        refusal, warning = self._judge(name, perception, consensus, guidance)
        return PhaseCommand(number, name, refusal=refusal and refusal.about(name), warning=warning)

    def _judge(
        self, name: CommandName, perception: Perception, consensus: Consensus, guidance: Guidance
    ) -> tuple[Notice | None, Notice | None]:
        """(refusal, warning) of a command that is otherwise possible."""
        checks, vehicle, peers = self._checks, perception.vehicle, consensus.peers
        if name is CommandName.RETURN:
            homes_enu_m = consensus.ground_position_enu_m
            return refusal_of_return(checks.own_id, checks.separation_m, vehicle, peers, homes_enu_m), None
        if name is CommandName.FORM and (refusal := _refusal_to_form(perception, consensus, guidance)):
            return refusal, None
        refusal, warning = checks.judge(name, vehicle, guidance.slot, peers, consensus.role)
        if name is CommandName.FORM and not refusal:
            refusal, warning = guidance.refusal_to_enter, _both(warning, guidance.warning_to_enter)
        return refusal, warning


def _refusal_to_form(perception: Perception, consensus: Consensus, guidance: Guidance) -> Notice | None:
    """The first of: preflight audit, and of a leader a reference that differs from the fleet's."""
    refusal = perception.fitness.refusal
    if not refusal and consensus.role is Role.LEADER:
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
