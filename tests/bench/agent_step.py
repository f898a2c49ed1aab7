"""Time of Agent.step with 3, 10 and 50 neighbours: a flight in virtual time is recorded, and its inputs are fed again."""

from __future__ import annotations

import gc
import time
from pathlib import Path

from companion.assembly import build_agent
from companion.recording.codec import recorded_config
from companion.recording.reader import RecordedTick, Recording, recordings
from companion.types.flight import FlightPhase
from sitl.flight.scenario import Scenario
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.report.progress import FlightProgress
from tests.bench.figures import REPEATS, Row, Section, percentile
from tests.bench.scenarios import star

FEW = 3
NEIGHBOURS = (FEW, 10, 50)
AGENT = 2  # a follower, and the middle of the star
FORM_S = 4.0
PERIOD_US = 20_000.0
HOW = """\
A fleet flies in virtual time and records its inputs. The recorded inputs of the follower that has all others as \
neighbours (with N neighbours it also receives N peers) are fed to a new agent in the same process, without sockets or \
waiting; each of five passes is a repeat. The time is that of one tick in formation, from the inbox to setpoint, peer \
packet and status. The ratio is the share of the period of 20 ms. In flight a tick begins after 20 ms of other work or \
none, when code and data have left the caches of the processor: the passes of the last two rows wait so long before each \
tick, and are compared with the same ticks without waiting."""


def measure(folder: Path) -> Section:
    """Files of the flights are written below `folder`."""
    flights = {count: recorded(star(count, FORM_S), folder / f"step_{count}") for count in NEIGHBOURS}
    passes = {count: [step_times_us(*flights[count]) for _ in range(REPEATS)] for count in NEIGHBOURS}
    waiting = [step_times_us(*flights[FEW], PERIOD_US / 1e6) for _ in range(REPEATS)]
    rows = [
        Row(
            what=f"Agent.step, {count} neighbours, p{share * 100:.0f}",
            unit="us",
            values=tuple(percentile(one, share) for one in passes[count]),
            beside="period",
            beside_values=(PERIOD_US,),
        )
        for count in NEIGHBOURS
        for share in (0.5, 0.99)
    ]
    rows += [
        Row(
            what=f"Agent.step, {FEW} neighbours, after 20 ms, p{share * 100:.0f}",
            unit="us",
            values=tuple(percentile(one, share) for one in waiting),
            beside="without waiting",
            beside_values=tuple(percentile(one, share) for one in passes[FEW]),
        )
        for share in (0.5, 0.99)
    ]
    return Section(title="Agent.step", how=HOW, rows=tuple(rows))


def recorded(scenario: Scenario, folder: Path) -> tuple[Recording, list[RecordedTick]]:
    """What vehicle 2, a follower, records in a flight."""
    folder.mkdir()
    flown = fly_in_virtual_time(scenario, FlightProgress("", True, 0.0), recordings=folder)
    if flown.failure:
        raise RuntimeError(f"{len(scenario.fleet.vehicles)} vehicles: {flown.failure}")
    recording = next(one for one in recordings(folder, print) if one.vehicle_id == AGENT)
    return recording, list(recording.ticks(print))


def step_times_us(recording: Recording, ticks: list[RecordedTick], pause_s: float = 0.0) -> list[float]:
    """Of every tick that begins and ends in formation, each after a pause."""
    header = recording.header
    agent = build_agent(recorded_config(recording.parts[0].path, header), header.session)
    gc.collect()
    gc.freeze()  # as the agent's process does
    times_us = []
    for tick in ticks:
        in_formation = agent.phase is FlightPhase.FORMATION
        if in_formation:
            time.sleep(pause_s)
        began_ns = time.perf_counter_ns()
        agent.step(tick.now_s, tick.inbox)
        took_ns = time.perf_counter_ns() - began_ns
        if in_formation and agent.phase is FlightPhase.FORMATION:
            times_us.append(took_ns / 1e3)
    gc.unfreeze()
    return times_us
