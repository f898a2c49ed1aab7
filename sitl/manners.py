"""The small interface by which flights in virtual and in real time take a stand-in of any autopilot's manners."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from sitl import px4_link_end, px4_parameters
from sitl.autopilot import Autopilot
from sitl.config import AutopilotFile
from sitl.link_end import LinkEnd
from sitl.px4 import Px4


@dataclass(frozen=True, slots=True)
class Manners:
    """One autopilot's: the vehicle with its step, its links' ends towards companion and ground, its parameters."""

    vehicle: Callable[[AutopilotFile, float], Autopilot]
    onboard_link: Callable[[Autopilot], LinkEnd]
    ground_link: Callable[[Autopilot], LinkEnd]
    parameters: Mapping[str, float]


PX4 = Manners(Px4, px4_link_end.onboard_link, px4_link_end.ground_link, px4_parameters.DEFAULTS)
