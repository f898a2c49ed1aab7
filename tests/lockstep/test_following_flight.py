"""References that the law cannot follow at the spacing compress the formation; the pace that the refusal names does not."""

from __future__ import annotations

import re

import pytest
from msgspec.structs import replace

from common import ROOT
from companion.assembly import flyable_problems
from companion.config.reference import CircleReference, Reference, WaypointsReference
from lockstep_fleet import FlownScenario
from sitl.flight.scenario import Scenario, load_scenario

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
REFUSED_S, ACCEPTED_S = 35.0, 62.0  # one turn of the circle, and there and back, at the two paces
CIRCLE = CircleReference(centre_enu_m=(-8.0, 0.0, 2.0), radius_m=8.0, period_s=28.0, ramp_s=8.0)
BACK_AND_FORTH = WaypointsReference(
    points_enu_m=((0.0, 0.0, 2.0), (20.0, 0.0, 2.0), (0.0, 0.0, 2.0)), max_speed_m_s=3.0, max_acceleration_m_s2=1.2
)


def flown_by(reference: Reference, for_s: float) -> Scenario:
    scenario = load_scenario(PLATOON, ["stand_in.airframe.drag_n_per_m_s=0.25", f"timeline[3].for_s={for_s}"])
    return replace(scenario, reference=reference)


def smallest_m(scenario: Scenario) -> float:
    """The smallest true distance of two vehicles in formation."""
    flight = FlownScenario(scenario)
    assert flight.failures == []
    return flight.smallest_m()


def accepted(reference: Reference, text: str) -> Reference:
    """The reference with the pace that a refusal names."""
    if isinstance(reference, CircleReference):
        period_s, ramp_s = re.search(r"at least ([\d.]+) s with ramp_s ([\d.]+)", text).groups()  # type: ignore[union-attr]
        return replace(reference, period_s=float(period_s), ramp_s=float(ramp_s))
    found = re.search(r"at most ([\d.]+) m/s\^2 with max_speed_m_s ([\d.]+)", text)
    assert found
    return replace(reference, max_acceleration_m_s2=float(found[1]), max_speed_m_s=float(found[2]))


@pytest.mark.parametrize(
    "reference",
    [pytest.param(CIRCLE, id="circle", marks=pytest.mark.long), pytest.param(BACK_AND_FORTH, id="waypoints")],
)
def test_a_refused_reference_compresses_the_formation_and_the_named_pace_does_not(
    reference: Reference, monkeypatch: pytest.MonkeyPatch
) -> None:
    filter_by = "companion.core.filter.filter.filter_acceleration"
    monkeypatch.setattr(filter_by, lambda wanted, *_: wanted)  # the law alone
    scenario = flown_by(reference, REFUSED_S)
    (problem,) = flyable_problems(scenario.fleet, reference)
    separation_m = scenario.fleet.separation_m
    assert smallest_m(scenario) < separation_m
    slower = accepted(reference, problem.text)
    assert not list(flyable_problems(scenario.fleet, slower))
    assert smallest_m(flown_by(slower, ACCEPTED_S)) >= separation_m
