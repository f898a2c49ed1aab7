"""What differs from one autopilot to the next, in one description that `px4.py` and `ardupilot.py` fill.

It is chosen by the HEARTBEAT; nothing else asks which autopilot it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from companion.mavlink import ardupilot, px4
from companion.mavlink.codec import MavlinkMessage
from companion.types import AttitudeTarget, AutopilotKind, AutopilotMode, AutopilotRequest, Telemetry


class Manners(Protocol):
    """One autopilot's manners: a module with these names."""

    @property
    def NAME(self) -> str: ...  # noqa: N802  for people

    @property
    def MAV_AUTOPILOT(self) -> int: ...  # noqa: N802

    @property
    def STREAMS_US(self) -> Mapping[int, int]:  # noqa: N802
        """Message id -> microseconds between messages, to be asked for; -1 is off."""

    @property
    def LEAST_HZ(self) -> Mapping[type[Telemetry], tuple[str, float]]:  # noqa: N802
        """What the agent lives on: its name and how often it must come, or the streams are asked for again."""

    @property
    def ATTITUDE_TYPE_MASK(self) -> int:  # noqa: N802
        """Of SET_ATTITUDE_TARGET with attitude and thrust."""

    def is_its(self, heartbeat: MavlinkMessage) -> bool:
        """Is this HEARTBEAT that of such an autopilot?"""

    def mode_of(self, custom_mode: int) -> tuple[AutopilotMode, str]:
        """Meaning and the autopilot's own name of a custom_mode."""

    def thrust_of(self, target: AttitudeTarget) -> float:
        """The thrust of SET_ATTITUDE_TARGET that means this target's."""

    def commanded_thrust(self, message: MavlinkMessage) -> float:
        """The thrust along the body's axis, 0 to 1, that ATTITUDE_TARGET tells of. Its numbers may still be NaN."""

    def command_for(self, request: AutopilotRequest, system_id: int) -> MavlinkMessage:
        """The message that asks for it."""

    def parameter_value(self, message: MavlinkMessage) -> float:
        """Of PARAM_VALUE, whichever way integers travel in it."""


MANNERS: dict[AutopilotKind, Manners] = {AutopilotKind.PX4: px4, AutopilotKind.ARDUPILOT: ardupilot}

# The messages whose rate is the agent's to choose, whatever autopilot it is.
AGENTS_STREAMS = frozenset(
    message_id for manners in MANNERS.values() for message_id, period_us in manners.STREAMS_US.items() if period_us > 0
)


def kind_of(heartbeat: MavlinkMessage) -> AutopilotKind | None:
    """Whose HEARTBEAT this is; None where no manners are known for it."""
    return next((kind for kind, manners in MANNERS.items() if manners.is_its(heartbeat)), None)


def words_for(heartbeat: MavlinkMessage) -> str:
    """What make of autopilot a HEARTBEAT says it is."""
    words, kind = f"MAV_AUTOPILOT {heartbeat.autopilot}", kind_of(heartbeat)
    if kind:
        return f"{words} ({MANNERS[kind].NAME})"
    known = any(heartbeat.autopilot == manners.MAV_AUTOPILOT for manners in MANNERS.values())
    return f"{words} of MAV_TYPE {heartbeat.type}" if known else words
