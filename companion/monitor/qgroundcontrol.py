"""Sends a fleet to one ground station by UDP. Nothing that it sends back is executed or passed on.

Each vehicle is a system with its vehicle id. A silent vehicle is not sent any more: the ground station shows its link as lost.
A status has no attitude, so ATTITUDE is not sent; the course over ground is the heading of GLOBAL_POSITION_INT while the
vehicle moves. The autopilot type is not known on the ground: MAV_AUTOPILOT_GENERIC.
"""

from __future__ import annotations

import contextlib
import re
import socket
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import atan2, degrees, hypot, inf
from typing import Self

from companion.config.fleet import FleetConfig, GeodeticOrigin
from companion.geometry.frames import geodetic_from_enu, ned_from_enu
from companion.ground.fleet_state import IN_FLIGHT, ReportedVehicle
from companion.link.byte_links import LinkError, encoded_host
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.types.flight import FLAG_TEXTS, FLYING, STREAMING, WITHOUT_LEADER, HealthFlag
from companion.types.status import Status
from companion.types.values import MAX_COORDINATE_M, Vector3

POSITIONS_EVERY_S, STATES_EVERY_S = 0.2, 1.0
DATAGRAMS_PER_STEP, READ_BYTES = 64, 4096
DENIALS_PER_STEP = 10
TEXTS_PER_STEP = 3  # of one vehicle; each flag at most once in TEXT_AGAIN_S
TEXT_AGAIN_S = 10.0
COMMANDS = (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT)


@dataclass(slots=True)
class _System:
    """One vehicle as the ground station sees it."""

    codec: MavlinkCodec
    positions_due_s: float = -inf
    states_due_s: float = -inf
    texts_s: dict[HealthFlag, float] = field(default_factory=dict)  # when each flag was last sent
    raised: frozenset[HealthFlag] = frozenset()  # flags that were sent and are still raised


class FleetFeed:
    """Call `forward` some ten times a second. It never blocks.

    Counters: `ignored` messages from the ground station, `denied` commands among them.
    """

    def __init__(self, endpoint: str, fleet: FleetConfig) -> None:
        """`endpoint` is like udpout:127.0.0.1:14550. The fleet file has the origin of the positions. Raises LinkError."""
        self._fleet = fleet.name
        self._origin = fleet.origin.as_tuple() if isinstance(fleet.origin, GeodeticOrigin) else None
        self._socket = _socket_towards(endpoint)
        self._systems: dict[int, _System] = {}
        self._reader = MavlinkCodec(255, 0)
        self._began_s, self._stepped_s = inf, -inf
        self.ignored = self.denied = 0

    def forward(self, vehicles: Iterable[ReportedVehicle], now_s: float) -> None:
        """Send what is due of the vehicles at this time, and drain what the ground station sent."""
        if now_s < self._stepped_s:  # a recording goes back: what was sent is of its future
            self._systems.clear()
        self._stepped_s, self._began_s = now_s, min(self._began_s, now_s)
        time_ms = int((now_s - self._began_s) * 1e3) % 2**32
        for vehicle in vehicles:
            if vehicle.fleet == self._fleet and not vehicle.silent:
                system = self._systems.get(vehicle.vehicle_id)
                if system is None:
                    codec = MavlinkCodec(vehicle.vehicle_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
                    system = self._systems[vehicle.vehicle_id] = _System(codec)
                self._send(system, _due(system, vehicle, self._origin, now_s, time_ms))
        self._drain()

    def close(self) -> None:
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send(self, system: _System, messages: Iterable[MavlinkMessage]) -> None:
        """In one datagram. A ground station that does not listen yet, or a full buffer: packets are lost, as on any link."""
        datagram = b"".join(system.codec.encode(message) for message in messages)
        if datagram:
            with contextlib.suppress(OSError):
                self._socket.send(datagram)

    def _drain(self) -> None:
        denials = 0
        for _ in range(DATAGRAMS_PER_STEP):
            try:
                data = self._socket.recv(READ_BYTES)
            except BlockingIOError:
                return
            except OSError:
                continue  # ICMP error for a datagram sent earlier
            for message in self._reader.decode(data):
                self.ignored += 1
                system = self._systems.get(getattr(message, "target_system", 0))
                if system and message.get_msgId() in COMMANDS:
                    self.denied += 1
                    denials += 1
                    if denials <= DENIALS_PER_STEP:
                        answer = denial(message.command, message.get_srcSystem(), message.get_srcComponent())
                        self._send(system, [answer])


def _due(
    system: _System, vehicle: ReportedVehicle, origin_deg_deg_m: Vector3 | None, now_s: float, time_ms: int
) -> list[MavlinkMessage]:
    """The messages of a vehicle that are due now; notes in `system` that they are sent."""
    messages: list[MavlinkMessage] = []
    if now_s >= system.states_due_s:
        system.states_due_s = _next_s(system.states_due_s, now_s, STATES_EVERY_S)
        messages += state_messages(vehicle.status)
    if now_s >= system.positions_due_s:
        system.positions_due_s = _next_s(system.positions_due_s, now_s, POSITIONS_EVERY_S)
        messages += position_messages(vehicle, origin_deg_deg_m, time_ms)
    return messages + _texts(system, vehicle.status, now_s)


def _next_s(due_s: float, now_s: float, period_s: float) -> float:
    """A step that comes late delays no later message: the rate stays."""
    return due_s + period_s if now_s < due_s + period_s else now_s + period_s


def _texts(system: _System, status: Status, now_s: float) -> list[MavlinkMessage]:
    """STATUSTEXT of flags that are new. A flag that comes and goes is not repeated at once."""
    raised = shown_flags(status)
    system.raised &= raised
    new = [
        flag
        for flag in HealthFlag
        if flag in raised - system.raised and now_s - system.texts_s.get(flag, -inf) >= TEXT_AGAIN_S
    ][:TEXTS_PER_STEP]
    system.raised |= frozenset(new)
    system.texts_s.update(dict.fromkeys(new, now_s))
    return [flag_message(flag, status.autopilot.armed) for flag in new]


def _socket_towards(endpoint: str) -> socket.socket:
    """Connected: the kernel drops datagrams from any other address."""
    parts = re.fullmatch("udpout:(?P<host>.+):(?P<port>[0-9]{1,5})", endpoint)
    if not parts or not 0 < int(parts["port"]) <= 65_535:
        raise LinkError("expected udpout:HOST:PORT, like udpout:127.0.0.1:14550")
    host = encoded_host(parts["host"].strip("[]"))
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, int(parts["port"]), type=socket.SOCK_DGRAM)[0]
    except socket.gaierror as error:
        raise LinkError(f'no address found for "{parts["host"]}"; give an IP address') from error
    udp = socket.socket(family, kind, protocol)
    udp.setblocking(False)
    try:
        udp.connect(address)
    except OSError as error:
        udp.close()
        raise LinkError(f"{error.strerror or error}; check the network") from error
    return udp


OLDEST_POSITION_S = 1.0  # an older one is not sent: it would look live
SLOWEST_COURSE_M_S = 0.5  # slower, the course is noise
HEADING_UNKNOWN, VOLTAGE_UNKNOWN, CURRENT_UNKNOWN, PERCENT_UNKNOWN = 65535, 65535, -1, -1
FASTEST_M_S = 300.0  # of what fits into GLOBAL_POSITION_INT
TEXT_BYTES = 50  # of STATUSTEXT


def state_messages(status: Status) -> list[MavlinkMessage]:
    """What changes rarely: HEARTBEAT, SYS_STATUS, BATTERY_STATUS, EXTENDED_SYS_STATE."""
    percent = _percent(status.autopilot.battery_percent)
    return [
        _heartbeat(status),
        mavlink.MAVLink_sys_status_message(
            0, 0, 0, 0, VOLTAGE_UNKNOWN, CURRENT_UNKNOWN, percent, 0, 0, 0, 0, 0, 0
        ),
        mavlink.MAVLink_battery_status_message(
            0, mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_UNKNOWN, 32_767, [VOLTAGE_UNKNOWN] * 10,
            CURRENT_UNKNOWN, -1, -1, percent
        ),
        mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, int(status.autopilot.landed))
    ]  # fmt: skip


def position_messages(vehicle: ReportedVehicle, origin_deg_deg_m: Vector3 | None, time_ms: int) -> list[MavlinkMessage]:
    """LOCAL_POSITION_NED, and GLOBAL_POSITION_INT where the fleet frame has a geodetic origin.

    None of them for a position that is old, or for values that no vehicle has.
    """
    position_enu_m, velocity_enu_m_s = vehicle.status.motion.position_enu_m, vehicle.status.motion.velocity_enu_m_s
    is_possible = max(map(abs, position_enu_m)) <= MAX_COORDINATE_M and max(map(abs, velocity_enu_m_s)) <= FASTEST_M_S
    if vehicle.data_age_s > OLDEST_POSITION_S or not is_possible:
        return []
    position_ned_m, velocity_ned_m_s = ned_from_enu(position_enu_m), ned_from_enu(velocity_enu_m_s)
    messages: list[MavlinkMessage] = [
        mavlink.MAVLink_local_position_ned_message(time_ms, *position_ned_m, *velocity_ned_m_s)
    ]
    if origin_deg_deg_m is not None:
        north_cm_s, east_cm_s, down_cm_s = (round(speed_m_s * 100.0) for speed_m_s in velocity_ned_m_s)
        latitude_deg, longitude_deg, altitude_m = geodetic_from_enu(position_enu_m, origin_deg_deg_m)
        messages.append(
            mavlink.MAVLink_global_position_int_message(
                time_ms,
                round(latitude_deg * 1e7),
                round(longitude_deg * 1e7),
                round(altitude_m * 1e3),
                round(position_enu_m[2] * 1e3),
                north_cm_s,
                east_cm_s,
                down_cm_s,
                _heading(velocity_ned_m_s),
            )
        )
    return messages


def shown_flags(status: Status) -> frozenset[HealthFlag]:
    """The raised flags; on the ground no vehicle misses a leader."""
    return frozenset(status.safety.flags) - (frozenset() if status.phase in FLYING else WITHOUT_LEADER)


def flag_message(flag: HealthFlag, armed: bool) -> MavlinkMessage:
    """STATUSTEXT for a flag that is new."""
    severity = mavlink.MAV_SEVERITY_CRITICAL if armed else mavlink.MAV_SEVERITY_WARNING
    return mavlink.MAVLink_statustext_message(severity, f"{flag}: {FLAG_TEXTS[flag]}"[:TEXT_BYTES].encode())


def denial(command: int, to_system: int, to_component: int) -> MavlinkMessage:
    """COMMAND_ACK for a command: this is a view of the fleet, and takes none."""
    return mavlink.MAVLink_command_ack_message(command, mavlink.MAV_RESULT_DENIED, 0, 0, to_system, to_component)


def _heartbeat(status: Status) -> MavlinkMessage:
    """GUIDED while the agent's setpoints stream; the autopilot's own mode has no number here."""
    mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if status.autopilot.armed else 0
    mode |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED if status.phase in STREAMING else 0
    flies = status.autopilot.landed in IN_FLIGHT
    critical = flies and bool(status.safety.flags)
    state = mavlink.MAV_STATE_ACTIVE if flies else mavlink.MAV_STATE_STANDBY
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_AUTOPILOT_GENERIC,
        mode,
        0,
        mavlink.MAV_STATE_CRITICAL if critical else state,
        3,
    )


def _percent(battery_percent: float | None) -> int:
    return PERCENT_UNKNOWN if battery_percent is None else round(max(0.0, min(100.0, battery_percent)))


def _heading(velocity_ned_m_s: Vector3) -> int:
    """Course over ground in centidegrees from north, clockwise."""
    north, east, _ = velocity_ned_m_s
    if hypot(north, east) < SLOWEST_COURSE_M_S:
        return HEADING_UNKNOWN
    return round(degrees(atan2(east, north)) * 100.0) % 36_000
