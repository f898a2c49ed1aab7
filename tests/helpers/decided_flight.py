"""What the agents of a flight in virtual time decide, and how far it jumps from one tick to the next.

The output limits would hide a jump: they admit 2.4 degrees of tilt in a tick, whatever is decided.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import dist, inf

from companion.core.agent import Decision
from companion.core.consensus.law import FormationLaw, FormationState, target
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot
from companion.types.tick import Inbox
from sitl.flight.lockstep import Lockstep

JUMP_M = 0.0005  # of a slot or a reference, beyond its velocity: a tick at 2.5 m/s^2, more than any blend has

FORMATION = FlightPhase.FORMATION


class Decisions:
    """All decisions of the agents from now on."""

    def __init__(self, lockstep: Lockstep) -> None:
        self._of = {vehicle_id: _record(vehicle._agent) for vehicle_id, vehicle in lockstep._vehicles.items()}

    def jump_m(self, from_s: float = -inf) -> float:
        """The largest jump of a slot, or of the reference of a vehicle that goes on leading, from one tick to the next."""
        jumps = []
        for a, b in self._in_formation(from_s):
            after_s, before, after = b.now_s - a.now_s, a.guidance, b.guidance
            jumps.append(_jump_m(before.slot, after.slot, after_s))
            if before.reference and after.reference:
                jumps.append(_jump_m(before.reference, after.reference, after_s))
        return max(jumps)

    def steered_jump_m(self, law: FormationLaw, from_s: float, until_s: float) -> float:
        """The largest jump of what a vehicle in formation steers to: its own reference, or the mean of its neighbours."""
        jumps = []
        for a, b in self._in_formation(from_s, until_s):
            before, after = (target(law, d.consensus.neighbours, d.guidance.reference) for d in (a, b))
            if before and after:
                jumps.append(_jump_m(before, after, b.now_s - a.now_s))
        return max(jumps)

    def _in_formation(self, from_s: float, until_s: float = inf) -> Iterator[tuple[Decision, Decision]]:
        """The decisions of two ticks, one after the other, of each vehicle."""
        for decisions in self._of.values():
            for a, b in pairwise(decisions):
                if a.flight.phase is b.flight.phase is FORMATION and a.now_s >= from_s and b.now_s <= until_s:
                    yield a, b


def _record(agent) -> list[Decision]:  # type: ignore[no-untyped-def]
    decisions: list[Decision] = []
    decide = agent.decide

    def decided(now_s: float, inbox: Inbox) -> Decision:
        decision: Decision = decide(now_s, inbox)
        decisions.append(decision)
        return decision

    agent.decide = decided
    return decisions


def _jump_m(before: FlownSlot | FormationState, after: FlownSlot | FormationState, after_s: float) -> float:
    """Distance from where it would be by its velocity."""
    moved = zip(before.position_enu_m, before.velocity_enu_m_s, strict=True)
    return dist([p + v * after_s for p, v in moved], after.position_enu_m)
