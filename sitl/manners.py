"""The small interface by which flights in virtual and in real time take a stand-in of any autopilot's manners."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from companion.types import AutopilotKind
from sitl import ardupilot_link_end, ardupilot_parameters, px4_link_end, px4_parameters
from sitl.ardupilot import ArduCopter
from sitl.autopilot import Autopilot
from sitl.config import AutopilotFile
from sitl.link_end import LinkEnd
from sitl.px4 import Px4


@dataclass(frozen=True, slots=True)
class Manners:
    """One autopilot's: the vehicle with its step, its links' ends, its parameters with their defaults.

    `tcp_link` is None where it does not listen on TCP.
    """

    vehicle: Callable[[AutopilotFile, float], Autopilot]
    onboard_link: Callable[[Autopilot], LinkEnd]
    ground_link: Callable[[Autopilot], LinkEnd]
    tcp_link: Callable[[Autopilot], LinkEnd] | None
    parameters: Mapping[str, float]


MANNERS: dict[AutopilotKind, Manners] = {
    AutopilotKind.PX4: Manners(Px4, px4_link_end.onboard_link, px4_link_end.ground_link, None, px4_parameters.DEFAULTS),
    AutopilotKind.ARDUPILOT: Manners(
        ArduCopter,
        ardupilot_link_end.onboard_link,
        ardupilot_link_end.ground_link,
        ardupilot_link_end.tcp_link,
        ardupilot_parameters.DEFAULTS,
    ),
}
