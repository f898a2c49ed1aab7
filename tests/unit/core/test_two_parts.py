"""A tick in two parts: what is prepared early decides the same, and what comes between the parts counts in the same tick."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import cycle

import pytest
from msgspec.structs import replace

from common import with_fields
from companion.config.fleet import EdgeNeighbours, RangeNeighbours
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, HealthFlag
from companion.types.peers import ReceivedPeerPacket
from companion.types.tick import Inbox, Outbox
from one_agent import FLEET, AgentFlight

TICK_S, PREPARED_S = 0.02, 0.002
Split = Callable[[float, Inbox], Inbox]


def as_one(_now_s: float, inbox: Inbox) -> Inbox:
    return inbox


def all_early(now_s: float, inbox: Inbox) -> Inbox:
    return replace(inbox, early=len(inbox.peers), prepared_s=now_s - PREPARED_S)


def by_turns() -> Split:
    """Early, late, and as one."""
    kinds: Iterator[Split] = cycle((all_early, lambda now_s, inbox: replace(all_early(now_s, inbox), early=0), as_one))
    return lambda now_s, inbox: next(kinds)(now_s, inbox)


def outboxes(split: Split, neighbours: EdgeNeighbours | RangeNeighbours) -> list[Outbox]:
    """Of a flight with commands, a peer that moves and falls silent for a while, and a hold by the pilot."""
    flight = AgentFlight(fleet=replace(FLEET, neighbours=neighbours))
    step, found = flight.agent.step, []

    def split_step(now_s: float, inbox: Inbox) -> Outbox:
        found.append(step(now_s, split(now_s, inbox)))
        return found[-1]

    flight.agent.step = split_step  # type: ignore[method-assign]
    flight.fly_to(FlightPhase.FORMATION)
    for number in range(200):
        flight.peer_position = None if 60 <= number < 90 else (0.01 * number, 0.0, 1.0)
        flight.tick()
    flight.tick(CommandName.HOLD)
    for _ in range(50):
        flight.tick()
    return found


@pytest.mark.parametrize(
    "neighbours", [EdgeNeighbours(edges=((1, 2),)), RangeNeighbours(range_m=2.5)], ids=["edges", "range"]
)
def test_a_decision_does_not_depend_on_when_its_parts_ran(neighbours: EdgeNeighbours | RangeNeighbours) -> None:
    assert outboxes(all_early, neighbours) == outboxes(by_turns(), neighbours) == outboxes(as_one, neighbours)


def prepared(early: bool) -> tuple[AgentFlight, Inbox]:
    """A flight in formation whose next tick is prepared, with the peer's packet or without, and its input."""
    flight = AgentFlight().fly_to(FlightPhase.FORMATION)
    flight.now_s += TICK_S
    packets = tuple(flight.peer())
    flight.agent.prepare(flight.now_s - PREPARED_S, packets if early else (), ())
    return flight, Inbox(tuple(flight.telemetry()), packets, early=len(packets) if early else 0)


def test_a_packet_between_the_parts_reaches_law_and_filter_in_the_same_tick() -> None:
    flight, inbox = prepared(early=False)
    near = with_fields(inbox.peers[0].packet, position_enu_m=(-0.9, 0.0, 1.0))
    decided = flight.agent.decide(flight.now_s, replace(inbox, peers=(ReceivedPeerPacket(flight.now_s, near),)))
    assert decided.consensus.peers.fresh[1].packet == near
    assert decided.setpoint.separation.nearest is not None
    assert decided.setpoint.separation.nearest.distance_m == pytest.approx(0.6, abs=0.01)


def test_a_tick_that_begins_long_after_its_preparation_judges_the_peers_anew() -> None:
    flight, inbox = prepared(early=True)
    decided = flight.agent.decide(flight.now_s + 1.0, replace(inbox, telemetry=()))
    assert decided.consensus.peers.fresh == {}
    assert HealthFlag.LEADER_LOST in decided.safety.flags


def test_each_tick_is_prepared_once() -> None:
    flight, inbox = prepared(early=True)
    with pytest.raises(AssertionError, match="prepared once"):
        flight.agent.prepare(flight.now_s, (), ())
    flight.agent.decide(flight.now_s, inbox)
    with pytest.raises(AssertionError, match="prepared before"):
        flight.agent.decide(flight.now_s, inbox)
