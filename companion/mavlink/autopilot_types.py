"""The autopilot types that the product knows: one folder each, and one line here.

HEARTBEAT selects the type; no other code asks for it.
"""

from __future__ import annotations

from dataclasses import replace

from companion.core.autopilot import Profiles
from companion.mavlink import ardupilot, px4
from companion.mavlink.codec import MavlinkMessage
from companion.mavlink.dialect import Dialect
from companion.types.autopilot import AutopilotKind

DIALECTS: dict[AutopilotKind, Dialect] = {AutopilotKind.PX4: px4, AutopilotKind.ARDUPILOT: ardupilot}
PROFILES: Profiles = {kind: dialect.PROFILE for kind, dialect in DIALECTS.items()}
# Of fleets whose autopilots get poses in place of GPS
VISION_PROFILES: Profiles = {
    kind: replace(profile, parameters=profile.parameters + profile.vision_parameters)
    for kind, profile in PROFILES.items()
}

# Messages of any dialect whose rate only the agent may set.
AGENT_STREAMS = frozenset(
    message_id for dialect in DIALECTS.values() for message_id, period_us in dialect.STREAMS_US.items() if period_us > 0
)


def autopilot_kind(heartbeat: MavlinkMessage) -> AutopilotKind | None:
    """Type of the autopilot that sent this HEARTBEAT; None where the product does not know it."""
    for kind, dialect in DIALECTS.items():
        if heartbeat.autopilot == dialect.MAV_AUTOPILOT and (
            not dialect.MAV_TYPES or heartbeat.type in dialect.MAV_TYPES
        ):
            return kind
    return None


def describe_heartbeat(heartbeat: MavlinkMessage) -> str:
    """The autopilot that a HEARTBEAT reports, for messages."""
    text, kind = f"MAV_AUTOPILOT {heartbeat.autopilot}", autopilot_kind(heartbeat)
    if kind:
        return f"{text} ({DIALECTS[kind].NAME})"
    known = any(heartbeat.autopilot == dialect.MAV_AUTOPILOT for dialect in DIALECTS.values())
    return f"{text} of MAV_TYPE {heartbeat.type}" if known else text
