"""Flight of real agents inside a concave fence and past obstacles."""

from __future__ import annotations

import numpy as np

from recorded_flight import Recorder
from repository import ROOT
from sitl.flight.director import Director
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import load_scenario
from sitl.report.metrics import SAMPLE_S
from sitl.report.progress import Progress

SCENARIO = ROOT / "config" / "scenarios" / "fence_and_obstacles.yaml"


def test_the_scenario_is_flown_clear_of_all() -> None:
    scenario = load_scenario(SCENARIO)
    lockstep, watch = Lockstep(scenario), Recorder(scenario)
    director = Director(lockstep, watch, Progress("test", True, 0.0), lambda: None, tuple, lockstep)
    assert director.fly_and_land(scenario.timeline) == []
    tracks = [s.track() for s in lockstep.stand_ins]
    assert watch.formation is not None
    times_s = np.arange(watch.formation.start_s, watch.formation.end_s, SAMPLE_S)
    rooms_m = [
        scenario.fleet.airspace.room_m((float(x), float(y), float(z))) for t in tracks for x, y, z in t.at(times_s)
    ]
    assert min(rooms_m) > 0.0
