"""The stand-in vehicles of a scenario in virtual time, and where they truly were."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from pathlib import Path
from random import Random

import numpy as np

from sitl.autopilot import DT_S
from sitl.config import AutopilotFile, Links
from sitl.direct_link import DirectLink
from sitl.dynamics import State
from sitl.manners import MANNERS
from sitl.tracks import Track
from sitl.truth import TRUTH_HEADER, truth_row

TELEMETRY_STEPS = 5  # between two positions, and between two rows of a track
STATE_KEPT = 10  # numbers of a state: position, velocity, attitude


class StandIn:
    """One vehicle: its autopilot, the link to its agent, and its true track at 50 Hz."""

    def __init__(self, file: AutopilotFile, links: Links, phase_s: float) -> None:
        self.vehicle_id = file.id
        manners = MANNERS[file.stand_in.autopilot]
        self.autopilot = manners.vehicle(file, DT_S)
        self.link = DirectLink(self.autopilot, manners.onboard_link(self.autopilot), links, phase_s)
        self._track = array("d")  # time, the state, thrust: flat, because a study keeps many of them
        self._modes: list[tuple[bool, str]] = []

    def step(self, now_s: float) -> None:
        """To this time, one step on."""
        self.link.deliver(now_s)
        self.autopilot.step()
        self.link.tell(now_s)
        self.autopilot.texts.clear()

    def record(self, now_s: float) -> None:
        self._track.append(now_s)
        self._track.extend(self.autopilot.quad.state[:STATE_KEPT])
        self._track.append(self.autopilot.quad.thrust_norm)
        self._modes.append((self.autopilot.armed, self.autopilot.flight_mode.name))

    def track(self) -> Track:
        table = np.array(self._track).reshape(-1, STATE_KEPT + 2)
        return Track(table[:, 0], table[:, 1:4])

    def write_track(self, path: Path) -> None:
        """As the CSV file that `sitl autopilot --truth` writes, on virtual time."""
        width = STATE_KEPT + 2
        with path.open("w", encoding="ascii") as file:
            file.write(TRUTH_HEADER)
            for row, (armed, mode_name) in enumerate(self._modes):
                time_s, *numbers = self._track[row * width : (row + 1) * width]
                state: State = tuple(numbers[:STATE_KEPT])
                file.write(truth_row(time_s, state, numbers[STATE_KEPT], armed, mode_name))


class World:
    """All stand-ins, step by step. Their telemetry comes in turn, as from processes started one after another."""

    def __init__(self, files: Sequence[AutopilotFile], links: Links) -> None:
        self.now_s = 0.0
        self._steps = 0
        self.stand_ins = [StandIn(file, links, _phase_s(file)) for file in files]

    def step(self) -> None:
        """One step of DT_S."""
        self._steps += 1
        self.now_s = self._steps * DT_S
        for stand_in in self.stand_ins:
            stand_in.step(self.now_s)
        if self._steps % TELEMETRY_STEPS == 0:
            for stand_in in self.stand_ins:
                stand_in.record(self.now_s)


def _phase_s(file: AutopilotFile) -> float:
    """When within its period a vehicle's telemetry comes; on one machine, too, no two agents tick together by design."""
    return Random(f"{file.stand_in.seed} {file.id} phase").randrange(TELEMETRY_STEPS) * DT_S
