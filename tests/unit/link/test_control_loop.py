"""The running control loop: what fails beside a tick ends it by a hand-over, and its memory stays constant."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable
from typing import Any

import pytest

from agent_on_bytes import FailingFlight
from companion.link import control_loop
from companion.link.control_loop import AgentFailedError
from companion.types.autopilot import AutopilotKind
from companion.types.notices import Code

STAGES: dict[str, Callable[[FailingFlight], tuple[Any, str]]] = {
    "peers received before the tick": lambda flight: (flight.peers, "receive"),
    "peers received in the tick": lambda flight: (flight.peers, "receive_late"),
    "the first part of a tick": lambda flight: (flight.agent.consensus, "receive"),
    "a stage": lambda flight: (flight.agent.guidance, "step"),
}


@pytest.mark.parametrize("stage", STAGES)
def test_a_failure_ends_the_running_loop(stage: str) -> None:
    flight = FailingFlight(AutopilotKind.PX4)
    flight.ticks(0.5)
    reports = len(flight.peers.reports)
    assert reports
    owner, method = STAGES[stage](flight)
    flight.inject(owner, method)
    try:
        with pytest.raises(AgentFailedError, match=f"Fault: {method}"):
            asyncio.run(flight.loop.run(20.0, []))
    finally:
        gc.unfreeze()
    event = flight.peers.reports[-1].status.last_event
    assert event is not None
    assert event.code is Code.AGENT_FAILED


# ---------------------------------------------------------------- memory


def test_full_collections_run_beside_the_ticks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control_loop, "COLLECT_PERIOD_S", 0.05)
    flight = FailingFlight(AutopilotKind.PX4)
    flight.link.is_connected = False
    before = gc.get_stats()[2]["collections"]
    try:
        assert not asyncio.run(flight.loop.run(0.4, []))  # until no autopilot has answered
    finally:
        gc.unfreeze()
    assert gc.get_stats()[2]["collections"] >= before + 4  # one of them before the first tick
