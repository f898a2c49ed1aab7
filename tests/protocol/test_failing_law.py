"""A real agent process whose law fails or takes long in formation flight. tests/lockstep/test_failing_law.py has the others."""

from __future__ import annotations

import pytest

from common import until
from companion.types.errors import EXIT_DEFECT
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from processes import FLEET, agent, companion
from tests.helpers.bad_laws import BAD_LAWS, fails_later, write_law
from wire_autopilots import TappedFlight


def use_law(vehicle: TappedFlight, name: str, source: str) -> None:
    """The fleet file of this vehicle names a law file beside it."""
    folder = vehicle.files.file.parent
    write_law(folder, name, source)
    (folder / "fleet.yaml").write_text(f"{FLEET}law: {{name: {name}, file: {name}.py}}\n", encoding="utf-8")


def test_a_law_that_fails_ends_in_hold(vehicle: TappedFlight) -> None:
    use_law(vehicle, "fails", fails_later("raise ValueError('no idea')"))
    with agent(vehicle.files) as process:
        process.wait_for_log("heartbeat of autopilot 1")
        vehicle.forget_reports()  # those of the agent before
        vehicle.form()
        assert process.process.wait(20.0) == EXIT_DEFECT
        assert "the law raises ValueError: no idea" in process.log
    vehicle.stand_in.wait_for_mode(vehicle.make.hold_mode_name)
    assert vehicle.tap.setpoints[-1].is_level
    event = vehicle.newest_event()
    assert event is not None
    assert event.code is Code.AGENT_FAILED


def test_a_law_that_takes_long_leaves_the_formation(vehicle: TappedFlight) -> None:
    use_law(vehicle, "slow", fails_later("sum(range(700000))"))
    with agent(vehicle.files) as process:
        process.wait_for_log("heartbeat of autopilot 1")
        vehicle.forget_reports()  # those of the agent before
        vehicle.form()
        until(lambda: vehicle.phase is FlightPhase.HOLD, 20.0)
        assert Code.LAW_SLOW in process.log
        vehicle.stand_in.wait_for_mode(vehicle.make.hold_mode_name)
        assert process.process.poll() is None


@pytest.mark.parametrize("name", ["huge", "imports_sockets", "hidden_state"])
def test_a_law_with_a_defect_that_shows_at_once_never_flies(vehicle: TappedFlight, name: str) -> None:
    use_law(vehicle, name, BAD_LAWS[name])
    ended = companion("agent", "--config", str(vehicle.files.file))
    assert ended.returncode == 2
    assert f"{name}.py" in ended.stderr
    assert ended.stderr.count("\n") == 1
