"""What differs between the autopilot types in MAVLink (`Dialect`), and the commands that are the same for all of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from companion.geometry.frames import Quaternion
from companion.mavlink.codec import MavlinkMessage
from companion.types.autopilot import AttitudeTarget, AutopilotMode, AutopilotRequest, Telemetry


class Dialect(Protocol):
    """Interface of a dialect: a module with these names."""

    @property
    def NAME(self) -> str: ...  # noqa: N802  for display

    @property
    def MAV_AUTOPILOT(self) -> int: ...  # noqa: N802

    @property
    def STREAMS_US(self) -> Mapping[int, int]:  # noqa: N802
        """Requested message intervals: message id -> microseconds; -1 is off."""

    @property
    def MIN_RATE_HZ(self) -> Mapping[type[Telemetry], tuple[str, float]]:  # noqa: N802
        """Telemetry that the agent needs: name and lowest rate. Below it all streams are requested again."""

    @property
    def ATTITUDE_TYPE_MASK(self) -> int:  # noqa: N802
        """type_mask of SET_ATTITUDE_TARGET with attitude and thrust."""

    def matches(self, heartbeat: MavlinkMessage) -> bool:
        """Whether this HEARTBEAT is of an autopilot of this dialect."""

    def mode_of(self, custom_mode: int) -> tuple[AutopilotMode, str]:
        """Meaning of a custom_mode, and its name in the autopilot's documentation."""

    def thrust_of(self, target: AttitudeTarget) -> float:
        """The thrust field of SET_ATTITUDE_TARGET for this target."""

    def commanded_thrust(self, thrust: float, quaternion: Quaternion) -> float:
        """Thrust along the body z axis, 0 to 1, from these fields of ATTITUDE_TARGET. It may be NaN."""

    def command_for(self, request: AutopilotRequest, system_id: int) -> MavlinkMessage:
        """The MAVLink message of this request."""

    def parameter_value(self, message: MavlinkMessage) -> float:
        """The value in PARAM_VALUE, with integers decoded."""
