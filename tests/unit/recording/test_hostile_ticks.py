"""Ticks under hostile input are recorded like all others: no message ends a recording, and a replay gets what the agent got."""

from __future__ import annotations

from random import Random

import pytest

from companion.recording.codec import decode_inbox, decode_outbox, encode_inbox, encode_outbox
from companion.types.commands import CommandName
from companion.types.tick import Inbox, Outbox
from companion.wire.rounding import round_outbox
from tests.fuzz.fleet import HostileFleet
from tests.fuzz.stream import HostileStream


@pytest.mark.parametrize("seed", range(4))
def test_what_comes_of_a_hostile_stream_is_recorded_exactly(seed: int) -> None:
    rng = Random(seed)
    fleet = HostileFleet(rng, is_chain=seed % 2 == 1)
    stream = HostileStream(rng, fleet, gives_commands=True, sends_telemetry=True)
    taken: list[tuple[float, Inbox, Outbox]] = []
    for agent in fleet.agents.values():
        step = agent.step

        def recorded(now_s: float, inbox: Inbox, step: object = step) -> Outbox:
            outbox: Outbox = step(now_s, inbox)  # type: ignore[operator]
            taken.append((now_s, inbox, round_outbox(outbox)))
            return outbox

        agent.step = recorded  # type: ignore[method-assign]
    for _ in range(10):
        fleet.tick()
    for name in (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF, CommandName.FORM):
        fleet.command(name)
        for _ in range(80):
            fleet.tick()
    del taken[:]
    for _ in range(60):
        fleet.tick(stream.next())
    assert sum(len(inbox.peers) for _, inbox, _ in taken) > len(taken) * 2.5  # two or more are true ones
    for now_s, inbox, outbox in taken:
        # By their texts, because NaN is like no other NaN
        assert repr(decode_inbox(encode_inbox(now_s, inbox))) == repr((now_s, inbox))
        assert decode_outbox(encode_outbox(now_s, outbox)) == (now_s, outbox)
