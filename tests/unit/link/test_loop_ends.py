"""What fails beside a tick ends the running loop by a hand-over too."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable
from typing import Any

import pytest

from agent_on_bytes import FailingFlight
from companion.link.control_loop import AgentFailedError
from companion.types.autopilot import AutopilotKind
from companion.types.notices import Code

STAGES: dict[str, Callable[[FailingFlight], tuple[Any, str]]] = {
    "peers received early": lambda flight: (flight.peers, "receive_early"),
    "peers received": lambda flight: (flight.peers, "receive"),
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
