"""Honest vehicles with noise, loss, jitter and late telemetry: none of them is in doubt, whatever they do."""

import pytest

from common import ROOT
from companion.types.flight import HealthFlag
from companion.types.notices import Code
from lockstep_fleet import FlownScenario
from sitl.flight.scenario import load_scenario

FIGURE_8 = ROOT / "config" / "scenarios" / "ring_figure_8.yaml"
EXCHANGE = ROOT / "config" / "scenarios" / "exchange.yaml"
LOSSES = ("links.peer_loss=0.1", "links.peer_delay_s=0.05", "links.peer_jitter_s=0.03")
LATE = ("links.peer_loss=0.2", "links.peer_jitter_s=0.15", "links.telemetry_delay_s=0.05")
FAST = ("reference.period_s=16", "fleet.law={name: cooperative}")


@pytest.mark.parametrize("sensors", [pytest.param("default", marks=pytest.mark.long), "px4_sih"])
@pytest.mark.parametrize(
    ("links", "scenario", "overrides"),
    [
        (LATE, FIGURE_8, FAST),
        pytest.param(LOSSES, FIGURE_8, FAST, marks=pytest.mark.long),
        pytest.param(LOSSES, EXCHANGE, (), marks=pytest.mark.long),
        pytest.param(LATE, EXCHANGE, (), marks=pytest.mark.long),
    ],
)
def test_no_honest_vehicle_is_in_doubt(scenario, overrides, links, sensors) -> None:  # type: ignore[no-untyped-def]
    flight = FlownScenario(load_scenario(scenario, (f"stand_in.sensors={sensors}", *links, *overrides)))
    reports = [status for _, status in flight.watch.reports]
    assert len(reports) > 100
    for status in reports:
        assert HealthFlag.PEER_IN_DOUBT not in status.safety.flags
        assert not any(key.startswith(Code.PEER_IN_DOUBT) for key in status.rejected)
