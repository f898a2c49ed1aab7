"""Rejected input: counted by code, with one text for each code."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from companion.types.notices import Code

TEXTS: Mapping[Code, str] = {
    # Telemetry
    Code.POSITION_OUT_OF_ORDER: "autopilot position older than the one before",
    Code.POSITION_IMPLAUSIBLE: "autopilot position or velocity not finite or out of range",
    Code.ATTITUDE_INVALID: "autopilot attitude not finite or not a rotation",
    Code.THRUST_IMPLAUSIBLE: "autopilot thrust outside 0 to 1",
    Code.ORIGIN_IMPLAUSIBLE: "GPS_GLOBAL_ORIGIN out of range",
    Code.GLOBAL_POSITION_IMPLAUSIBLE: "GLOBAL_POSITION_INT far from the fleet origin; no fix, or origin of another field",
    Code.PARAMETER_NOT_FINITE: "autopilot parameter not finite",
    Code.AUTOPILOT_OTHER_MAKE: "HEARTBEAT of another make of autopilot; check `autopilot` in the vehicle file",
    Code.TELEMETRY_OVERLOAD: "more telemetry between two ticks than the agent keeps",
    Code.MAVLINK_UNREADABLE: "unreadable MAVLink packet",
    Code.MAVLINK_UNSIGNED: "MAVLink packet without a signature",
    Code.MAVLINK_WRONG_KEY: "MAVLink packet signed with another key",
    Code.MAVLINK_OLD_SIGNATURE: "MAVLink packet with an old signature",
    Code.SETPOINT_IMPOSSIBLE: "own setpoint not finite, or no attitude gives its acceleration",
    # Peers
    Code.PEER_OWN_ID: "packet with this vehicle's own id; two vehicles have one id",
    Code.PEER_NOT_IN_FLEET: "packet of a vehicle that is not in the fleet file",
    Code.PEER_OTHER_FLEET_FILE: "formation hash differs; give both vehicles the same fleet file",
    Code.PEER_NOT_A_LEADER: "claims to be leader, not permitted by the fleet file",
    Code.PEER_EPOCH_TOO_HIGH: "leader epoch too far above the own one; the position is used",
    Code.PEER_NOT_FINITE: "packet with a number that is not finite",
    Code.PEER_POSITION_IMPLAUSIBLE: "position out of range",
    Code.PEER_POSITION_JUMPED: "position further from the last one than its speed permits",
    Code.PEER_SPEED_IMPLAUSIBLE: "speed out of range",
    Code.PEER_ACCELERATION_IMPLAUSIBLE: "acceleration out of range",
    Code.PEER_ACCELERATION_LIMITED: "acceleration beyond this fleet's limits; the packet is used with a smaller one",
    Code.PEER_TIME_IMPLAUSIBLE: "state age or time of sending out of range, or sent before its time",
    Code.PEER_SLOT_IMPLAUSIBLE: "slot out of range",
    Code.PEER_POSITION_ERROR_IMPLAUSIBLE: "position error out of range",
    Code.PEER_PRC_IMPLAUSIBLE: "PrC out of range, or inconsistent with the role",
    Code.PEER_REFERENCE_IMPLAUSIBLE: "reference trajectory number or start time out of range",
    Code.PEER_CHANGE_IMPLAUSIBLE: "formation change out of range",
    Code.PEER_BEACON_MISSING: "leader without a leader beacon of its own",
    Code.PEER_BEACON_IMPLAUSIBLE: "leader beacon out of range",
    Code.PEER_ID_TWICE: "two vehicles with one id",
    Code.PEER_OUT_OF_ORDER: "packet out of order or replayed",
    Code.PEER_LATE: "packet delayed longer than the permitted age",
    Code.PEER_NOT_AUTHENTICATED: "datagram without the sender's tag for this vehicle",
    Code.PEER_KEY_MISMATCH: "packet of another vehicle than its Zenoh key names",
    # Targets
    Code.TARGET_NOT_FINITE: "target sample with a number that is not finite",
    Code.TARGET_POSITION_IMPLAUSIBLE: "target position out of range",
    Code.TARGET_SPEED_IMPLAUSIBLE: "target speed out of range",
    Code.TARGET_TIME_IMPLAUSIBLE: "target time of sending out of range",
    Code.TARGET_NAME_TWICE: "two targets with one name",
    Code.TARGET_OUT_OF_ORDER: "target sample out of order or replayed",
    Code.TARGET_LATE: "target sample delayed too long",
    # Messages over Zenoh
    Code.MESSAGE_EMPTY: "empty message",
    Code.WIRE_VERSION_DIFFERS: "message of another wire version; run the same release everywhere",
    Code.PEER_MALFORMED: "malformed peer packet",
    Code.TARGET_MALFORMED: "malformed target sample",
    Code.TRAFFIC_MALFORMED: "malformed traffic sample, or a number out of range",
    Code.COMMAND_MALFORMED: "malformed command",
    Code.NOT_ADMITTED: "from a participant that the fleet no longer admits",
    Code.COMMAND_KEY_MISMATCH: "command of another operator than its Zenoh key names",
    Code.REPORT_MALFORMED: "malformed status report or command reply",
    # Ground station
    Code.GROUND_STATION_OWN_ID: "ground station packet with this vehicle's own system id",
    Code.GROUND_STATION_SETPOINT: "setpoint from the ground station; change the mode first",
    Code.GROUND_STATION_IN_FLIGHT: "not permitted while the agent flies; change the mode first",
    Code.GROUND_STATION_RATE: "ground station asks for another rate of telemetry that the agent needs",
    Code.GROUND_STATION_UNREADABLE: "unreadable MAVLink packet from the ground station",
    Code.GROUND_STATION_ADDRESS: "packet to the ground station's port from another address",
    Code.GROUND_STATION_OVERLOAD: "more ground station packets than the autopilot's link has room for",
}


MAX_DETAILED = 100  # keys of a counter from which on details are left out: a stranger could cause a new one each time


def rejection_key(code: Code, detail: int | None = None) -> str:
    """Key of a counter: the code, followed by a peer id or a foreign wire version where there is one."""
    return code.value if detail is None else f"{code.value} {detail}"


def rejection_text(key: str) -> str:
    """The text for a counter's key; "" for a code of another release."""
    code = key.partition(" ")[0]
    return TEXTS[Code(code)] if code in TEXTS else ""


def summed(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    """The sums of several counts by key."""
    total: dict[str, int] = {}
    for count in counts:
        for key, number in count.items():
            total[key] = total.get(key, 0) + number
    return total


def counted(rejected: Counter[str], key: str) -> Counter[str]:
    """A new count with one more of `key`. The old one may be part of a result already, so it is not modified."""
    if key not in rejected and len(rejected) >= MAX_DETAILED:
        key = key.partition(" ")[0]  # without the detail
    return rejected + Counter([key])
