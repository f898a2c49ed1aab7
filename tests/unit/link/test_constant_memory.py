"""The control loop gives back what CPython keeps of freed objects."""

import asyncio
import gc

import pytest

from agent_on_bytes import FailingFlight
from companion.link import control_loop
from companion.types.autopilot import AutopilotKind


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
