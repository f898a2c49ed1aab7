"""What is obeyed of the commands that the desk lets through, and why a vehicle refuses one that is otherwise possible.

Changes of what the fleet flies are judged in `core/changes.py`.
"""

from __future__ import annotations

from collections.abc import Iterable

from companion.core.command_desk import CommandDesk, Order
from companion.core.cooperation import Cooperation
from companion.core.fleet_checks import FleetChecks
from companion.core.flown_formation import FlownFormation
from companion.core.health import PLACE_IN_DOUBT
from companion.core.homeward import refusal_of_return
from companion.core.phase import RULES, PhaseMachine
from companion.core.preflight import Preflight
from companion.core.safeguard import Safeguard
from companion.types import (
    WITHOUT_LEADER,
    Command,
    CommandName,
    CommandReply,
    HealthFlag,
    Lead,
    Role,
    VehicleState,
)


class Obedience:
    """One vehicle's. `events` tells what is to be said of commands that were obeyed, until somebody takes it."""

    def __init__(
        self,
        desk: CommandDesk,
        machine: PhaseMachine,
        cooperation: Cooperation,
        formation: FlownFormation,
        preflight: Preflight,
        safeguard: Safeguard,
        checks: FleetChecks,
    ) -> None:
        self._desk = desk
        self._machine = machine
        self._cooperation = cooperation
        self._formation = formation
        self._preflight = preflight
        self._safeguard = safeguard
        self._checks = checks
        self._own_id = checks.own_id
        self.events: list[str] = []

    def take_in(self, commands: Iterable[Command]) -> list[Order]:
        """This tick's, in the order in which they came."""
        return [self._desk.take_in(command) for command in commands]

    def change_lead(self, now_s: float, orders: Iterable[Order], vehicle: VehicleState) -> None:
        """Obey or refuse those of them that say who leads."""
        for order in orders:
            if order.answer is None and isinstance(order.command.content, Lead):
                order.answer = self._change_lead(now_s, order.command.content, vehicle)

    def obey(self, now_s: float, orders: Iterable[Order], vehicle: VehicleState, flags: frozenset[HealthFlag]) -> None:
        """Obey or refuse all that have no answer yet."""
        for order in orders:
            if order.answer is None:
                order.answer = self._obey(order.command.name, now_s, vehicle, flags)

    def replies(self, orders: Iterable[Order]) -> tuple[CommandReply, ...]:
        """When all of this tick were obeyed or refused."""
        return tuple([self._reply(order) for order in orders])

    def _reply(self, order: Order) -> CommandReply:
        assert order.answer is not None  # whatever the desk lets through was obeyed or refused in this tick
        return CommandReply(self._own_id, order.command.number, *order.answer)

    def _change_lead(self, now_s: float, lead: Lead, vehicle: VehicleState) -> tuple[bool, str]:
        refusal = self._machine.refusal_of_lead(vehicle)
        if not refusal and self._own_id in lead.leaders:
            missing = self._formation.refusal_to_lead(now_s)
            refusal = f"lead: {missing}" if missing else ""
        return (False, refusal) if refusal else self._cooperation.leadership.obey(lead)

    def _obey(
        self, name: CommandName, now_s: float, vehicle: VehicleState, flags: frozenset[HealthFlag]
    ) -> tuple[bool, str]:
        if name is CommandName.ABORT:
            self._safeguard.end_landings()
            return self._machine.abort(now_s, vehicle)
        if missing := _missing_for(name, flags):
            return False, f"{name}: {', '.join(missing)}"
        refusal, warning = self._judge(name, now_s, vehicle)
        if refusal:
            return False, f"{name}: {refusal}"
        accepted, reason = self._machine.command(name, now_s, vehicle)
        if accepted:
            self._safeguard.end_landings()
        if accepted and warning:
            self.events.append(warning)
            reason += f"; {warning}"
        return accepted, reason

    def _judge(self, name: CommandName, now_s: float, vehicle: VehicleState) -> tuple[str, str]:
        """Why a command is refused that is otherwise possible, and what is to be said of it where it is not."""
        if self._machine.phase not in RULES[name].allowed:
            return "", ""
        if name is CommandName.FORM and (refusal := self._refusal_to_form(now_s)):
            return refusal, ""
        peers = self._cooperation.peers
        if name is CommandName.RETURN:
            separation_m = self._checks.separation_m
            return refusal_of_return(self._own_id, separation_m, vehicle, peers.heard(now_s), peers.stood_enu_m), ""
        role = self._cooperation.leadership.role
        refusal, warning = self._checks.judge(name, vehicle, self._formation.slot, peers.heard(now_s), role)
        if name is CommandName.FORM and not refusal:
            refusal = self._formation.refusal_to_join(now_s, vehicle)
            if not self._formation.joins:
                slot = self._formation.slot
                refusal = self._checks.refusal_to_form_together(vehicle, slot, peers.heard(now_s))
        return refusal, warning

    def _refusal_to_form(self, now_s: float) -> str:
        """For what this vehicle is or has itself; one that leads beside others must lead where they do."""
        refusal = self._preflight.refusal() or self._safeguard.battery.too_low
        if not refusal and self._cooperation.leadership.role is Role.LEADER:
            refusal = self._formation.refusal_to_lead(now_s)
        return refusal


def _missing_for(name: CommandName, flags: frozenset[HealthFlag]) -> list[str]:
    """Landing, holding and disarming need nothing; the rest needs a vehicle that knows where and how it is.

    Of a return the agent need only know where it begins.
    """
    if name in (CommandName.LAND, CommandName.HOLD, CommandName.DISARM):
        return []
    if name is CommandName.RETURN:
        return sorted(flags & PLACE_IN_DOUBT)
    unneeded = set() if name is CommandName.FORM else WITHOUT_LEADER
    return sorted(flags - unneeded)
