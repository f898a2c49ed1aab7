"""The least that a bad flight needs: faults, delays and commands are left out one by one while the flight remains as bad."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator

from msgspec.structs import replace

from sitl.flight.scenario import Scenario, TimelineStep
from sitl.gauntlet.drawing import draw_flight
from sitl.gauntlet.flight import FlightOutcome, Job, fly_drawn
from sitl.gauntlet.search import score_of
from sitl.vehicle.config import Links, Wind
from sitl.workers import report_progress

TAKE_OFF_STEPS = 4  # prepare, arm, takeoff and form: they stay
AS_BAD = 0.02  # a flight without a violation may become better by this share of what is allowed


def minimal(job: Job) -> tuple[Scenario, FlightOutcome]:
    """The flight of this job without all that it does not need, and what comes of it then."""
    flight = draw_flight(job.seed, job.number, job.sensors, job.own, job.choices)
    outcome = fly_drawn(job, flight, time.process_time())
    score = score_of(outcome)
    limit = 1.0 if score < 1.0 else score + AS_BAD
    tries, needed = len(list(simpler(flight.scenario))), 0
    for tried in range(tries):
        without = dataclasses.replace(flight, scenario=list(simpler(flight.scenario))[needed])
        found = fly_drawn(job, without, time.process_time())
        if not found.failure and score_of(found) < limit:
            flight, outcome = without, found
        else:
            needed += 1
        report_progress((tried + 1) / tries)
    return flight.scenario, outcome


def simpler(scenario: Scenario) -> Iterator[Scenario]:
    """The scenario without one thing, for each that can be left out; in an order that leaving one out does not change."""
    stand_in, links, fleet = scenario.stand_in, scenario.links, scenario.fleet
    for name in ("peer_loss", "peer_jitter_s", "peer_delay_s"):
        if getattr(links, name) != (usual := getattr(Links(), name)):
            yield replace(scenario, links=replace(links, **{name: usual}))
    for name in ("partitions", "late_telemetry", "lies"):
        for index in range(len(items := getattr(links, name))):
            yield replace(scenario, links=replace(links, **{name: items[:index] + items[index + 1 :]}))
    for name in ("pilots", "batteries", "position_losses", "homes", "rally_points"):
        for index in range(len(items := getattr(stand_in, name))):
            yield replace(scenario, stand_in=replace(stand_in, **{name: items[:index] + items[index + 1 :]}))
    if stand_in.wind != Wind():
        yield replace(scenario, stand_in=replace(stand_in, wind=Wind()))
    if fleet.obstacles:
        yield replace(scenario, fleet=replace(fleet, obstacles=()))
    for index in range(len(ends := scenario.agent_ends)):
        yield replace(scenario, agent_ends=ends[:index] + ends[index + 1 :])
    for index in range(TAKE_OFF_STEPS, len(steps := scenario.timeline)):
        yield replace(scenario, timeline=_without(steps, index))


def _without(steps: tuple[TimelineStep, ...], index: int) -> tuple[TimelineStep, ...]:
    """The timeline without a step, as long as before."""
    left = list(steps[:index] + steps[index + 1 :])
    if index == len(steps) - 1:
        ends_s = (steps[index].at_s or 0.0) + steps[index].for_s
        left[-1] = replace(left[-1], for_s=max(0.0, round(ends_s - (left[-1].at_s or 0.0), 3)))
    return tuple(left)
