"""Which flights of the gauntlet real autopilots fly, and what becomes of the times of their commands."""

from __future__ import annotations

from argparse import Namespace
from itertools import islice
from pathlib import Path

import pytest
from msgspec import structs

from companion.types.autopilot import AutopilotKind
from companion.types.errors import UnusableError
from sitl.flight.flights import FlightEnd, FlightResult, result_of
from sitl.flight.watch import watch_of
from sitl.gauntlet.command import parse_families, run_gauntlet
from sitl.gauntlet.drawing import draw_flight
from sitl.gauntlet.families import FORM_S
from sitl.gauntlet.faults import ALL_FAMILIES
from sitl.gauntlet.real import MOST_VEHICLES, REAL_FAMILIES, draw_real, from_takeoff, outcome_of
from sitl.vehicle.config import Links

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT


@pytest.mark.parametrize("kind", AutopilotKind)
def test_no_flight_has_what_only_stand_ins_can_do(kind: AutopilotKind) -> None:
    flights = list(islice(draw_real(kind, 1, REAL_FAMILIES), 50))
    for flight in flights:
        scenario, stand_in = flight.scenario, flight.scenario.stand_in
        assert flight.family in REAL_FAMILIES and flight.runaway is None
        assert len(scenario.fleet.vehicles) <= MOST_VEHICLES
        assert (stand_in.autopilot, scenario.links, scenario.agent_ends) == (kind, Links(), ())
        assert not (stand_in.pilots or stand_in.batteries or stand_in.position_losses)
        assert all(step.at_s is None for step in scenario.timeline)
    assert {flight.family for flight in flights} == set(REAL_FAMILIES)


def test_commands_follow_each_other_as_in_virtual_time() -> None:
    timeline = draw_flight(1, 0, "ideal").scenario.timeline  # a change of the formation, twice
    form, first, second = timeline[3:]
    assert (form.at_s, first.at_s, second.at_s) == pytest.approx((FORM_S, first.at_s, second.at_s))
    prepare, arm, takeoff, *rest = from_takeoff(timeline)
    assert [step.for_s for step in (prepare, arm, takeoff)] == [0.0, 0.0, 0.0]
    assert [step.for_s for step in rest] == pytest.approx(
        [first.at_s - form.at_s, second.at_s - first.at_s, second.for_s]
    )


def test_the_distance_counts_by_the_errors_of_the_autopilots_simulation() -> None:
    flight = next(iter(draw_real(PX4, 1, ("exchange",))))
    scenario = flight.scenario
    end = FlightEnd(failure=None, flight_s=60.0, real_autopilots=dict.fromkeys(scenario.starts_enu_m, PX4))
    for ratio, violation in ((0.61, False), (0.59, True)):
        summary = result_of(scenario, "flight", watch_of(scenario, 0.0), None, end).summary
        near = structs.replace(summary, smallest_distance_m=ratio * scenario.fleet.separation_m)
        outcome = outcome_of(1, flight, FlightResult(near, None))
        assert (outcome.ratio, outcome.violation, outcome.sensors) == (
            pytest.approx(ratio, abs=1e-3),
            violation,
            "px4_sih",
        )


def test_a_family_of_stand_ins_is_refused_by_name() -> None:
    assert parse_families(None, REAL_FAMILIES) == REAL_FAMILIES
    with pytest.raises(UnusableError, match=r"^--families: 'leader_dies', expected some of form_near, form_far"):
        parse_families("exchange,leader_dies", REAL_FAMILIES)
    assert set(REAL_FAMILIES) < set(ALL_FAMILIES)


def test_a_missing_program_ends_it_before_the_first_flight(tmp_path: Path) -> None:
    options = Namespace(fleet=None, external="px4", families="exchange", seed=1, flights=2, quiet=True, out=tmp_path)
    options.rare, options.adversarial, options.resume = None, False, None
    options.binary, options.sensors = [tmp_path / "px4_gone"], "ideal"
    with pytest.raises(UnusableError, match=r"^--sensors: are those of the autopilots"):
        run_gauntlet(options)
    options.sensors = None
    with pytest.raises(UnusableError, match=r"px4_gone is no file"):
        run_gauntlet(options)
    options.external = None
    with pytest.raises(UnusableError, match=r"^--binary: goes with --external"):
        run_gauntlet(options)
