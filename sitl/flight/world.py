"""The stand-in vehicles of a scenario in virtual time, with their true tracks."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from pathlib import Path
from random import Random

import numpy as np
from numpy.typing import NDArray

from companion.mavlink.autopilot_types import DIALECTS
from companion.types.autopilot import AutopilotMode
from sitl.autopilots.autopilot import DT_S
from sitl.autopilots.behaviour import AUTOPILOT_TYPES
from sitl.links.direct_link import DirectLink
from sitl.report.tracks import Track
from sitl.vehicle.config import AutopilotFile, Links
from sitl.vehicle.dynamics import State
from sitl.vehicle.truth import TRUTH_HEADER, truth_row

BoolArray = NDArray[np.bool_]
TELEMETRY_STEPS = 5  # between two positions, and between two rows of a track
STREAM_ENDED_AFTER_S = 0.1  # without a newer attitude target
OFF_GROUND_M = 0.1  # higher than this above its start
STATE_KEPT = 10  # numbers of a state: position, velocity, attitude


class VirtualStandIn:
    """One vehicle: autopilot, link to its agent, and true track at 50 Hz."""

    def __init__(self, file: AutopilotFile, links: Links, phase_s: float) -> None:
        self.vehicle_id = file.id
        behaviour = AUTOPILOT_TYPES[file.stand_in.autopilot]
        self.autopilot = behaviour.vehicle(file, DT_S)
        self.ground_m = file.start_enu_m[2]
        self.link = DirectLink(self.autopilot, behaviour.onboard_link(self.autopilot), links, phase_s)
        self._track = array("d")  # time, state, thrust: flat, because a study keeps many of them
        self._modes: list[tuple[bool, str]] = []
        self._commanded = bytearray()  # with each row: whether an agent commands the attitude

    def step(self, now_s: float) -> None:
        """Advance by one step to this time."""
        self.link.deliver(now_s)
        self.autopilot.step()
        self.link.send_telemetry(now_s)
        self.autopilot.texts.clear()

    def record(self, now_s: float) -> None:
        autopilot, quad = self.autopilot, self.autopilot.quad
        self._track.extend((now_s, *quad.state[:STATE_KEPT], quad.thrust_norm))
        self._modes.append((autopilot.armed, autopilot.flight_mode.name))
        self._commanded.append(self._is_commanded(now_s))

    def _is_commanded(self, now_s: float) -> bool:
        """Whether the autopilot flies attitudes that its agent sends."""
        if not self.autopilot.armed or now_s - self.link.setpoint_s >= STREAM_ENDED_AFTER_S:
            return False
        mode, _ = DIALECTS[self.autopilot.kind].mode_of(self.autopilot.flight_mode.custom_mode)
        return mode is AutopilotMode.OFFBOARD

    def commanded(self) -> BoolArray:
        """Whether an agent commanded the attitude (k,), at the times of the track."""
        return np.array(self._commanded, dtype=np.bool_)

    def flies(self) -> BoolArray:
        """Whether it was armed and off the ground (k,), at the times of the track."""
        armed = np.array([armed for armed, _ in self._modes], dtype=np.bool_)
        return armed & (self.track().position_enu_m[:, 2] - self.ground_m > OFF_GROUND_M)

    def track(self) -> Track:
        table = np.array(self._track).reshape(-1, STATE_KEPT + 2)
        return Track(table[:, 0], table[:, 1:4])

    def write_track(self, path: Path) -> None:
        """Write a CSV file like `sitl autopilot --truth`, in virtual time."""
        width = STATE_KEPT + 2
        with path.open("w", encoding="ascii") as file:
            file.write(TRUTH_HEADER)
            for row, (armed, mode_name) in enumerate(self._modes):
                time_s, *numbers = self._track[row * width : (row + 1) * width]
                state: State = tuple(numbers[:STATE_KEPT])
                file.write(truth_row(time_s, state, numbers[STATE_KEPT], armed, mode_name))


class World:
    """All stand-ins, advanced together. Their telemetry is out of phase, as from processes started one after another."""

    def __init__(self, files: Sequence[AutopilotFile], links: Links) -> None:
        self.now_s = 0.0
        self._steps = 0
        self.stand_ins = [VirtualStandIn(file, links, _phase_s(file)) for file in files]

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
    """Phase of a vehicle's telemetry within its period; agents do not tick together by design."""
    return Random(f"{file.stand_in.seed} {file.id} phase").randrange(TELEMETRY_STEPS) * DT_S
