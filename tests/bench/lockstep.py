"""Vehicle-seconds per second of lockstep at 4, 16 and 100 vehicles."""

from __future__ import annotations

import time

from sitl.flight.director import Director
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import load_scenario
from sitl.flight.virtual_flight import collecting_seldom, fly_in_virtual_time
from sitl.flight.watch import watch_of
from sitl.report.progress import FlightProgress
from tests.bench.figures import REPEATS, Row, Section, Target
from tests.bench.scenarios import SCENARIOS, grid

WINDOWS_S = {4: 10.0, 16: 3.0, 100: 0.4}  # virtual time of one repeat
PLATOON = SCENARIOS / "platoon.yaml"
FIRST_1_S = 136.0  # four vehicles before any work on speed: 34 times real time
HOW = """\
Everything flies in virtual time in one process. The figure is vehicles times virtual seconds divided by seconds of \
computing: four vehicles fly a quarter of it times faster than real time. The platoon flies its whole flight, with \
ideal sensors; each of five flights is a repeat. Its target is 2.5 times the {first:g} vehicle-seconds per second (34 times \
real time) that it reached before the work on speed, measured on another day: the machine of today may be slower or \
faster, and the aim is 400 (100 times real time). The grids have default sensor noise, and each vehicle has those beside \
it as neighbours and receives all. After three seconds in formation the computing time of five windows is taken: \
{windows} s of virtual time for {vehicles} vehicles."""


def measure() -> Section:
    platoon = Row(
        what="lockstep, the platoon's whole flight, 4 vehicles",
        unit="vehicle-s/s",
        values=_of_whole_flights_1_s(),
        target=Target("value", least=2.5 * FIRST_1_S),
    )
    grids = [
        Row(what=f"lockstep, grid of {count} vehicles", unit="vehicle-s/s", values=_rates_1_s(count, window_s))
        for count, window_s in WINDOWS_S.items()
    ]
    how = HOW.format(
        first=FIRST_1_S,
        windows=", ".join(f"{window_s:g}" for window_s in WINDOWS_S.values()),
        vehicles=", ".join(map(str, WINDOWS_S)),
    )
    return Section(title="Lockstep", how=how, rows=(platoon, *grids))


def _of_whole_flights_1_s() -> tuple[float, ...]:
    scenario = load_scenario(PLATOON)
    flights = [fly_in_virtual_time(scenario, FlightProgress("", True, 0.0)) for _ in range(REPEATS)]
    return tuple(len(scenario.fleet.vehicles) * flown.flight_s / flown.wall_s for flown in flights)


def _rates_1_s(count: int, window_s: float) -> tuple[float, ...]:
    scenario = grid(count, form_s=3.0)
    to_formation = scenario.timeline[:-1]
    lockstep = Lockstep(scenario)
    watch = watch_of(scenario, lockstep.now_s())
    with collecting_seldom():
        Director(lockstep, watch, FlightProgress("", True, 0.0), lambda: None, tuple, lockstep).fly(to_formation)
        rates = []
        for _ in range(REPEATS):
            virtual_s, began_s = lockstep.now_s(), time.perf_counter()
            lockstep.sleep(window_s)
            took_s = time.perf_counter() - began_s
            lockstep.drain()
            rates.append(count * (lockstep.now_s() - virtual_s) / took_s)
    lockstep.close()
    return tuple(rates)
