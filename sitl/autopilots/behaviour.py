"""The stand-in autopilots by make, behind one interface for flights in virtual and in real time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from companion.types.autopilot import AutopilotKind
from sitl.autopilots.ardupilot import link_end as ardupilot_link_end
from sitl.autopilots.ardupilot import parameters as ardupilot_parameters
from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.autopilot import Autopilot
from sitl.autopilots.px4 import link_end as px4_link_end
from sitl.autopilots.px4 import parameters as px4_parameters
from sitl.autopilots.px4.autopilot import Px4
from sitl.links.link_end import LinkEnd
from sitl.vehicle.config import AutopilotFile


@dataclass(frozen=True, slots=True)
class AutopilotType:
    """What differs between the makes: the autopilot, its link ends, its parameters with their defaults.

    `tcp_link` is None for an autopilot that does not listen on TCP.
    """

    vehicle: Callable[[AutopilotFile, float], Autopilot]
    onboard_link: Callable[[Autopilot], LinkEnd]
    ground_link: Callable[[Autopilot], LinkEnd]
    tcp_link: Callable[[Autopilot], LinkEnd] | None
    parameters: Mapping[str, float]


AUTOPILOT_TYPES: dict[AutopilotKind, AutopilotType] = {
    AutopilotKind.PX4: AutopilotType(
        Px4, px4_link_end.onboard_link, px4_link_end.ground_link, None, px4_parameters.DEFAULTS
    ),
    AutopilotKind.ARDUPILOT: AutopilotType(
        ArduCopter,
        ardupilot_link_end.onboard_link,
        ardupilot_link_end.ground_link,
        ardupilot_link_end.tcp_link,
        ardupilot_parameters.DEFAULTS,
    ),
}
