"""MAVLink dialects: what differs between autopilots. The modules `px4` and `ardupilot` each are one dialect.

HEARTBEAT selects the dialect; no other code asks for the make of the autopilot.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from companion.geometry.frames import Quaternion
from companion.mavlink import ardupilot, px4
from companion.mavlink.codec import MavlinkMessage
from companion.types.autopilot import AttitudeTarget, AutopilotKind, AutopilotMode, AutopilotRequest, Telemetry


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


DIALECTS: dict[AutopilotKind, Dialect] = {AutopilotKind.PX4: px4, AutopilotKind.ARDUPILOT: ardupilot}

# Messages of any dialect whose rate only the agent may set.
AGENT_STREAMS = frozenset(
    message_id for dialect in DIALECTS.values() for message_id, period_us in dialect.STREAMS_US.items() if period_us > 0
)


def autopilot_kind(heartbeat: MavlinkMessage) -> AutopilotKind | None:
    """Make of the autopilot that sent this HEARTBEAT; None where it has no dialect."""
    return next((kind for kind, dialect in DIALECTS.items() if dialect.matches(heartbeat)), None)


def describe_heartbeat(heartbeat: MavlinkMessage) -> str:
    """The autopilot that a HEARTBEAT reports, for messages."""
    text, kind = f"MAV_AUTOPILOT {heartbeat.autopilot}", autopilot_kind(heartbeat)
    if kind:
        return f"{text} ({DIALECTS[kind].NAME})"
    known = any(heartbeat.autopilot == dialect.MAV_AUTOPILOT for dialect in DIALECTS.values())
    return f"{text} of MAV_TYPE {heartbeat.type}" if known else text
