"""Port offsets of fleets that fly side by side."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from common import ROOT
from companion.types.autopilot import AutopilotKind
from sitl.flight.files import ids_of
from sitl.flight.scenario import load_scenario
from sitl.links.free_ports import PortInUseError, reserved_ports

SCENARIOS = sorted((ROOT / "config" / "scenarios").glob("*.yaml"))
OFFSET = 9300  # used by no other test
OTHER_FLEET = f"""
from companion.types.autopilot import AutopilotKind
from sitl.links.free_ports import reserved_ports
with reserved_ports(dict.fromkeys([1, 2], AutopilotKind.PX4), {OFFSET}):
    print("reserved", flush=True)
    input()
"""


@contextmanager
def other_fleet() -> Iterator[None]:
    """Another process that has reserved its ports and not bound them yet."""
    command = [sys.executable, "-c", OTHER_FLEET]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "reserved\n"
        try:
            yield
        finally:
            process.kill()


def test_a_reserved_port_is_refused() -> None:
    with (
        other_fleet(),
        pytest.raises(PortInUseError, match=r"^UDP port 23881, .*\(reserved by another fleet\)"),
        reserved_ports(dict.fromkeys([2], AutopilotKind.PX4), OFFSET),
    ):
        pass


def test_reserved_ports_are_free_again_when_the_process_is_killed() -> None:
    with other_fleet():
        pass
    with reserved_ports(dict.fromkeys([1, 2], AutopilotKind.PX4), OFFSET) as offset:
        assert offset == OFFSET


def test_the_next_offset_is_taken_when_ports_are_reserved(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.links.free_ports.OFFSETS", range(OFFSET, OFFSET + 500, 100))
    with other_fleet(), reserved_ports(dict.fromkeys([1, 2], AutopilotKind.PX4), None) as offset:
        assert offset == OFFSET + 100


@pytest.mark.parametrize("kind", AutopilotKind)
@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_every_shipped_scenario_has_an_offset(kind: AutopilotKind, path: object) -> None:
    scenario = load_scenario(path)  # type: ignore[arg-type]
    with reserved_ports(dict.fromkeys(ids_of(scenario), kind), None) as offset:
        assert offset % 100 == 0


def test_a_fleet_with_ids_too_far_apart_is_refused() -> None:
    with (
        pytest.raises(PortInUseError, match="ids that lie less than 40 apart"),
        reserved_ports(dict.fromkeys([1, 41], AutopilotKind.PX4), None),
    ):
        pass
