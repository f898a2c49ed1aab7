"""A status as the MAVLink messages that a ground station shows. Pure.

A status has no attitude, so ATTITUDE is not sent; the course over ground is the heading of GLOBAL_POSITION_INT while the
vehicle moves. The autopilot's make is not known on the ground: MAV_AUTOPILOT_GENERIC.
"""

from __future__ import annotations

from math import atan2, degrees, hypot

from companion.geometry.frames import geodetic_from_enu, ned_from_enu
from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.types.autopilot import LandedState
from companion.types.flight import FLAG_TEXTS, FLYING, STREAMING, WITHOUT_LEADER, HealthFlag
from companion.types.status import Status
from companion.types.values import MAX_COORDINATE_M, Vector3

OLDEST_POSITION_S = 1.0  # an older one is not sent: it would look live
SLOWEST_COURSE_M_S = 0.5  # slower, the course is noise
HEADING_UNKNOWN, VOLTAGE_UNKNOWN, CURRENT_UNKNOWN, PERCENT_UNKNOWN = 65535, 65535, -1, -1
FASTEST_M_S = 300.0  # of what fits into GLOBAL_POSITION_INT
TEXT_BYTES = 50  # of STATUSTEXT
_FLYING = (LandedState.IN_AIR, LandedState.TAKEOFF, LandedState.LANDING)


def state_messages(status: Status) -> list[MavlinkMessage]:
    """What changes rarely: HEARTBEAT, SYS_STATUS, BATTERY_STATUS, EXTENDED_SYS_STATE."""
    percent = _percent(status.battery_percent)
    return [
        _heartbeat(status),
        mavlink.MAVLink_sys_status_message(
            0, 0, 0, 0, VOLTAGE_UNKNOWN, CURRENT_UNKNOWN, percent, 0, 0, 0, 0, 0, 0
        ),
        mavlink.MAVLink_battery_status_message(
            0, mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_UNKNOWN, 32_767, [VOLTAGE_UNKNOWN] * 10,
            CURRENT_UNKNOWN, -1, -1, percent,
        ),
        mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, int(status.landed)),
    ]  # fmt: skip


def position_messages(
    status: Status, age_s: float, origin_deg_deg_m: Vector3 | None, time_ms: int
) -> list[MavlinkMessage]:
    """LOCAL_POSITION_NED, and GLOBAL_POSITION_INT where the fleet frame has a geodetic origin.

    None of them for a position that is old, with `age_s` since the report, or for values that no vehicle has.
    """
    if status.state_age_s + age_s > OLDEST_POSITION_S or not _is_possible(status):
        return []
    position_ned_m, velocity_ned_m_s = ned_from_enu(status.position_enu_m), ned_from_enu(status.velocity_enu_m_s)
    messages: list[MavlinkMessage] = [
        mavlink.MAVLink_local_position_ned_message(time_ms, *position_ned_m, *velocity_ned_m_s)
    ]
    if origin_deg_deg_m is not None:
        north_cm_s, east_cm_s, down_cm_s = (round(speed_m_s * 100.0) for speed_m_s in velocity_ned_m_s)
        latitude_deg, longitude_deg, altitude_m = geodetic_from_enu(status.position_enu_m, origin_deg_deg_m)
        messages.append(
            mavlink.MAVLink_global_position_int_message(
                time_ms,
                round(latitude_deg * 1e7),
                round(longitude_deg * 1e7),
                round(altitude_m * 1e3),
                round(status.position_enu_m[2] * 1e3),
                north_cm_s,
                east_cm_s,
                down_cm_s,
                _heading(velocity_ned_m_s),
            )
        )
    return messages


def shown_flags(status: Status) -> frozenset[HealthFlag]:
    """The raised flags; on the ground no vehicle misses a leader."""
    return frozenset(status.flags) - (frozenset() if status.phase in FLYING else WITHOUT_LEADER)


def flag_message(flag: HealthFlag, armed: bool) -> MavlinkMessage:
    """STATUSTEXT for a flag that is new."""
    severity = mavlink.MAV_SEVERITY_CRITICAL if armed else mavlink.MAV_SEVERITY_WARNING
    return mavlink.MAVLink_statustext_message(severity, f"{flag}: {FLAG_TEXTS[flag]}"[:TEXT_BYTES].encode())


def denial(command: int, to_system: int, to_component: int) -> MavlinkMessage:
    """COMMAND_ACK for a command: this is a view of the fleet, and takes none."""
    return mavlink.MAVLink_command_ack_message(command, mavlink.MAV_RESULT_DENIED, 0, 0, to_system, to_component)


def _heartbeat(status: Status) -> MavlinkMessage:
    """GUIDED while the agent's setpoints stream; the autopilot's own mode has no number here."""
    mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if status.armed else 0
    mode |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED if status.phase in STREAMING else 0
    flies = status.landed in _FLYING
    critical = flies and bool(status.flags)
    state = mavlink.MAV_STATE_ACTIVE if flies else mavlink.MAV_STATE_STANDBY
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_AUTOPILOT_GENERIC,
        mode,
        0,
        mavlink.MAV_STATE_CRITICAL if critical else state,
        3,
    )


def _is_possible(status: Status) -> bool:
    furthest_m, fastest_m_s = max(map(abs, status.position_enu_m)), max(map(abs, status.velocity_enu_m_s))
    return furthest_m <= MAX_COORDINATE_M and fastest_m_s <= FASTEST_M_S


def _percent(battery_percent: float | None) -> int:
    return PERCENT_UNKNOWN if battery_percent is None else round(max(0.0, min(100.0, battery_percent)))


def _heading(velocity_ned_m_s: Vector3) -> int:
    """Course over ground in centidegrees from north, clockwise."""
    north, east, _ = velocity_ned_m_s
    if hypot(north, east) < SLOWEST_COURSE_M_S:
        return HEADING_UNKNOWN
    return round(degrees(atan2(east, north)) * 100.0) % 36_000
