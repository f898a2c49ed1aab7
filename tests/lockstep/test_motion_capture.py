"""The laboratory's platoon in virtual time, and what its vehicles do when the cameras lose a body, or show it wrongly."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

import numpy as np
import pytest

from common import ROOT
from companion.types.autopilot import AutopilotKind
from companion.types.flight import FlightPhase, HealthFlag
from lockstep_fleet import READY_SOON, CommandedFlight, FlownScenario
from sitl.flight.scenario import load_scenario

SCENARIOS = ROOT / "config" / "scenarios"
LAB = SCENARIOS / "lab_platoon.yaml"
P, F = FlightPhase, HealthFlag
KINDS = list(AutopilotKind)
PLACE = "{latitude_deg: 47.397742, longitude_deg: 8.545594, altitude_amsl_m: 488.0}"
INDOORS = (
    "fleet.origin=indoor",
    f"fleet.external_vision={{place: {PLACE}}}",
    "stand_in.positioning=external_vision",
)
WEIGHTED = "fleet.law.name=weighted"
ALL_LAND_S = 26.6


def faults(kind_and_vehicles: str, at_s: float, for_s: float) -> str:
    return f"stand_in.capture_faults=[{{{kind_and_vehicles}, at_s: {at_s}, for_s: {for_s}}}]"


LOST, FROZEN, LATE = (f"kind: {kind}, vehicle: 2" for kind in ("lost", "frozen", "late"))
SWAPPED, FLIPPED = "kind: swapped, vehicle: 2, other: 3", "kind: flipped, vehicle: 4, turn_deg: 90"
WRONG_AND_WORD = {
    LOST: ({2}, "no good motion-capture pose"),
    FROZEN: ({2}, "frozen: "),
    LATE: ({2}, "0.2 s late"),
    SWAPPED: ({2, 3}, "swapped: vehicle "),
    FLIPPED: ({4}, "turned by 90 deg"),
}


def until(flight: CommandedFlight, at_s: float) -> None:
    flight.go_on(at_s - flight.lockstep.now_s())


def record_poses(flight: CommandedFlight) -> dict[int, list[float]]:
    """When each vehicle's poses go to its autopilot, from now on."""
    passed_s: dict[int, list[float]] = {i: [] for i in flight.newest}
    for i, vehicle in flight.lockstep.vehicles.items():

        def pose(now_s, *rest, times_s=passed_s[i], follow=vehicle.link.pose):  # type: ignore[no-untyped-def]
            times_s.append(now_s)
            follow(now_s, *rest)

        vehicle.link.pose = pose  # type: ignore[method-assign]
    return passed_s


def leaves_and_lands(flight: CommandedFlight, ids: Iterable[int], since_s: float) -> None:
    """As the failsafe matrix says: flag after 0.2 s, out of formation after 0.5 s, landing after 2 s; nothing hits."""
    until(flight, since_s + 0.4)
    for i in ids:
        assert F.POSE_LOST in flight.newest[i].safety.flags
        assert flight.newest[i].phase is P.FORMATION
    until(flight, since_s + 0.8)
    assert {flight.newest[i].phase for i in ids} <= {P.RELEASE, P.HOLD}
    until(flight, since_s + 2.4)
    assert {flight.newest[i].phase for i in ids} == {P.LAND}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "shown",
    [
        pytest.param(SWAPPED, id="swapped"),
        *[pytest.param(one, id=one, marks=pytest.mark.long) for one in (LOST, FLIPPED, FROZEN, LATE)],
    ],
)
def test_a_body_that_is_shown_wrongly_leaves_and_lands(shown: str, kind: AutopilotKind) -> None:
    """None of its poses reaches the autopilot, and none comes near another by it. The paper's law flies."""
    parts = [faults(shown, at_s=22.0, for_s=7.0), f"stand_in.autopilot={kind}", WEIGHTED, "timeline[3].for_s=1"]
    flight = CommandedFlight(LAB, *parts)
    assert flight.lockstep.now_s() < 21.0
    until(flight, 22.0)
    passed_s = record_poses(flight)
    wrong, word = WRONG_AND_WORD[shown]
    after_s = 0.12 if shown is FROZEN else 0.02  # a frozen body shows itself after ten frames
    leaves_and_lands(flight, wrong, 22.0 + after_s)
    until(flight, 26.0)  # on the ground, where a vehicle may be carried, any place is accepted
    for i in wrong:
        assert any(word in event for event in flight.events_of(i)), flight.events_of(i)
        assert max(passed_s[i], default=0.0) <= 22.0 + after_s
    assert all(max(passed_s[i]) > 25.9 for i in set(passed_s) - wrong)
    assert flight.smallest_m(21.0) > flight.scenario.fleet.separation_m


@pytest.mark.parametrize("kind", [AutopilotKind.PX4, pytest.param(AutopilotKind.ARDUPILOT, marks=pytest.mark.long)])
def test_a_body_lost_for_0_4_s_stays_in_formation(kind: AutopilotKind) -> None:
    lost = faults("kind: lost, vehicle: 3", at_s=22.0, for_s=0.4)
    flight = CommandedFlight(LAB, lost, f"stand_in.autopilot={kind}", "timeline[3].for_s=1")
    until(flight, 22.35)
    error = flight.newest[3].motion.position_error
    assert F.POSE_LOST in flight.newest[3].safety.flags
    assert error and error.horizontal_m > 0.02  # the others keep a larger distance by it
    until(flight, 25.0)
    assert {status.phase for status in flight.newest.values()} == {P.FORMATION}
    assert not flight.newest[3].safety.flags


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shown", [SWAPPED, LOST, FLIPPED, FROZEN, LATE])
def test_a_body_shown_wrongly_in_an_exchange(shown: str, kind: AutopilotKind) -> None:
    """The vehicles cross each other when it begins."""
    parts = [*READY_SOON, *INDOORS, f"stand_in.autopilot={kind}", "timeline[3].for_s=1"]
    flown = FlownScenario(load_scenario(SCENARIOS / "exchange.yaml", [*parts, faults(shown, at_s=24.0, for_s=6.0)]))
    wrong, _ = WRONG_AND_WORD[shown]
    reports = [(at_s, status) for at_s, status in flown.watch.reports if status.agent.vehicle_id in wrong]
    assert {status.phase for at_s, status in reports if 23.5 < at_s < 24.0} == {P.FORMATION}
    assert {status.phase for at_s, status in reports if 26.6 < at_s < 27.0} == {P.LAND}
    times_s = np.arange(12.0, 34.0, 0.02)
    at = {i: track.at(times_s) for i, track in flown.tracks.items()}
    apart_m = np.min([np.linalg.norm(at[i] - at[j], axis=1) for i, j in combinations(at, 2)], axis=0)
    separation_m = flown.scenario.fleet.separation_m
    assert apart_m[times_s < ALL_LAND_S].min() > separation_m
    assert apart_m.min() > 0.9 * separation_m  # then autopilots land them all, the blind ones with a drift


def test_the_platoon_flies_by_poses_as_by_ideal_positions() -> None:
    """Within 5 %: the smallest distance and the time to settle of the paper's law."""
    figures = []
    for scenario, changes in (
        (LAB, ("timeline[3].for_s=15",)),
        (SCENARIOS / "platoon.yaml", ("timeline[3].for_s=15",)),
    ):
        flown = FlownScenario(load_scenario(scenario, [*changes, WEIGHTED, *READY_SOON]))
        assert not flown.failures
        figures.append(flown.smallest_m())
    assert figures[0] == pytest.approx(figures[1], rel=0.05)
