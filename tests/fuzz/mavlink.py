"""Hostile MAVLink: packets with edges of every message, and telemetry that decodes but is wrong."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable
from math import isfinite
from random import Random
from typing import Any

from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.mavlink.translator import Translator
from companion.types.autopilot import AutopilotKind, AutopilotMode, GroundSample, PoseSample, Telemetry
from sitl.autopilots.messages import MissionCurrent
from tests.fuzz.mutation import other_float, other_int
from tests.fuzz.plant import HOVER_THRUST_NORM, ORIGIN, PARAMETERS, Plant

M = mavlink
MAVLINK_2_OVERHEAD = 12  # bytes of header and checksum
WRONG_ID_SHARE = 0.2
BESIDE_SHARE = 0.1  # of samples that do not come over MAVLink
INTEGERS = {
    "uint8_t": (0, 2**8 - 1),
    "int8_t": (-(2**7), 2**7 - 1),
    "uint16_t": (0, 2**16 - 1),
    "int16_t": (-(2**15), 2**15 - 1),
    "uint32_t": (0, 2**32 - 1),
    "int32_t": (-(2**31), 2**31 - 1),
    "uint64_t": (0, 2**64 - 1),
    "int64_t": (-(2**63), 2**63 - 1),
}
MODES = {  # custom_mode of PX4
    AutopilotMode.OFFBOARD: 6 << 16,
    AutopilotMode.TAKEOFF: 4 << 16 | 2 << 24,
    AutopilotMode.HOLD: 4 << 16 | 3 << 24,
    AutopilotMode.RETURN: 4 << 16 | 5 << 24,
    AutopilotMode.LAND: 4 << 16 | 6 << 24,
}
MANUAL = 1 << 16


def mavlink_packets() -> list[bytes]:
    """Each message with edges of its numbers, and what a true autopilot of either make sends."""
    link, rng = mavlink.MAVLink(None, srcSystem=1, srcComponent=1), Random(2)
    plant, now_s = Plant((1.0, 2.0, 3.0)), 100.0
    true = [message(plant, now_s) for message in MESSAGES]
    copter = _heartbeat(plant, now_s)
    copter.autopilot = M.MAV_AUTOPILOT_ARDUPILOTMEGA
    packets = [bytes(message.pack(link)) for message in (*true, copter)]
    for number, kind in sorted(mavlink.mavlink_map.items()):
        for edge in (0, 1, float("nan"), float("inf"), -1e30, 255):
            try:
                packets.append(_packed(link, kind, edge, rng))
            except Exception:  # noqa: BLE001 -- this message has no such value
                continue
        assert number == kind.id
    return packets


def _packed(link: Any, kind: Any, edge: float, rng: Random) -> bytes:
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    values: dict[str, Any] = {}
    for name, type_name in types.items():
        length = lengths[name]
        if type_name == "char":
            values[name] = rng.randbytes(max(1, length))
            continue
        value = float(edge) if type_name in ("float", "double") else _whole(edge, type_name)
        values[name] = [value] * length if length else value
    return bytes(kind(**values).pack(link))


def _whole(edge: float, type_name: str) -> int:
    if not isfinite(edge):
        return INTEGERS[type_name][edge > 0.0]
    least, most = INTEGERS.get(type_name, (0, 255))
    return max(least, min(most, int(edge)))


def resealed(data: bytes) -> bytes:
    """These bytes as one packet with the length and the checksum of what it carries, where they still name a message."""
    if not MAVLINK_2_OVERHEAD <= len(data) <= MAVLINK_2_OVERHEAD + 255:
        return data
    packet = bytearray(data)
    kind = mavlink.mavlink_map.get(int.from_bytes(packet[7:10], "little"))
    if kind is None:
        return data
    packet[:3] = (mavlink.PROTOCOL_MARKER_V2, len(packet) - MAVLINK_2_OVERHEAD, 0)
    packet[5:7] = (1, 1)  # from the autopilot
    packet[-2:] = mavlink.x25crc(packet[1:-2] + bytes((kind.crc_extra,))).crc.to_bytes(2, "little")
    return bytes(packet)


class HostileTelemetry:
    """Telemetry of one vehicle as its agent decodes it: the true messages with wrong numbers or from wrong ids.

    Beside these come poses and kept take-offs, anything that their readers pass on. `refused` counts packets that gave no
    sample, `passed` the others.
    """

    def __init__(self, rng: Random, vehicle_id: int) -> None:
        self._rng = rng
        self._vehicle_id = vehicle_id
        self._translator = Translator(vehicle_id, AutopilotKind.PX4)
        self.refused: Counter[str] = Counter()
        self.passed: Counter[str] = Counter()

    def next(self, plant: Plant, now_s: float) -> list[Telemetry]:
        """The samples of one packet, or one from beside it. Raises AssertionError where one of a wrong id is used."""
        rng = self._rng
        if rng.random() < BESIDE_SHARE:
            self.passed["telemetry"] += 1
            return [rng.choice((_pose, _kept_takeoff))(rng, now_s)]
        message = rng.choice(MESSAGES)(plant, now_s)
        for _ in range(rng.choice((1, 1, 2, 3))):
            _change(rng, message)
        system, component = self._vehicle_id, int(M.MAV_COMP_ID_AUTOPILOT1)
        is_wrong = rng.random() < WRONG_ID_SHARE
        if is_wrong and rng.random() < 0.5:
            system = (system + rng.randint(1, 255)) % 256
        elif is_wrong:
            component = (component + rng.randint(1, 255)) % 256
        try:
            data = bytes(message.pack(mavlink.MAVLink(None, srcSystem=system, srcComponent=component)))
        except (struct.error, OverflowError):  # no sender can pack such a value
            return []
        samples = self._translator.telemetry(data, now_s)
        assert not (is_wrong and samples), f"a packet of ids {system}, {component} was used"
        (self.passed if samples else self.refused)["telemetry"] += 1
        return samples


def _pose(rng: Random, now_s: float) -> PoseSample:
    """The verdict of `PoseJudge`."""
    return PoseSample(now_s, now_s - rng.choice((0.0, 0.3, 1e9)), rng.choice(("", "frozen")))


def _kept_takeoff(rng: Random, now_s: float) -> GroundSample:
    """What `TakeoffFile` reads: of this start of the autopilot, or of another."""
    booted_s = rng.choice((0.0, now_s, rng.uniform(-1e10, 1e10)))
    return GroundSample(now_s, rng.uniform(-1e5, 1e5), booted_s, rng.choice((0.0, 2.0, 1e10)))


def _change(rng: Random, message: MavlinkMessage) -> None:
    """Another number in one field; MISSION_CURRENT has none that pymavlink knows."""
    if not message.fieldnames:
        return
    name, type_name = rng.choice(list(zip(message.fieldnames, message.fieldtypes, strict=True)))
    value = getattr(message, name)
    if isinstance(value, float):
        setattr(message, name, other_float(rng, value))
    elif isinstance(value, int) and type_name in INTEGERS:
        least, most = INTEGERS[type_name]
        setattr(message, name, max(least, min(most, other_int(rng, value))))
    elif isinstance(value, list):
        at = rng.randrange(len(value))
        setattr(message, name, [*value[:at], other_float(rng, value[at]), *value[at + 1 :]])


def _heartbeat(plant: Plant, _now_s: float) -> MavlinkMessage:
    flags = M.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (M.MAV_MODE_FLAG_SAFETY_ARMED if plant.armed else 0)
    mode = MODES.get(plant.mode, MANUAL)
    return M.MAVLink_heartbeat_message(M.MAV_TYPE_QUADROTOR, M.MAV_AUTOPILOT_PX4, flags, mode, M.MAV_STATE_ACTIVE, 3)


def _current_mode(plant: Plant, _now_s: float) -> MavlinkMessage:
    return M.MAVLink_current_mode_message(0, MODES.get(plant.mode, MANUAL), 0)


def _position(plant: Plant, now_s: float) -> MavlinkMessage:
    (x, y, z), (vx, vy, vz) = plant.position_enu_m, plant.velocity_enu_m_s
    return M.MAVLink_local_position_ned_message(_boot_ms(now_s), y, x, -z, vy, vx, -vz)


def _global_position(plant: Plant, now_s: float) -> MavlinkMessage:
    latitude_deg, longitude_deg, altitude_m = ORIGIN
    x, y, z = plant.position_enu_m
    degrees = int(1e7 * latitude_deg + 90.0 * y), int(1e7 * longitude_deg + 134.0 * x)
    altitude_mm = int(1000.0 * (altitude_m + z))
    return M.MAVLink_global_position_int_message(_boot_ms(now_s), *degrees, altitude_mm, 0, 0, 0, 0, 0)


def _attitude(_plant: Plant, now_s: float) -> MavlinkMessage:
    return M.MAVLink_attitude_quaternion_message(_boot_ms(now_s), 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def _attitude_target(_plant: Plant, now_s: float) -> MavlinkMessage:
    level = [1.0, 0.0, 0.0, 0.0]
    return M.MAVLink_attitude_target_message(_boot_ms(now_s), 0, level, 0.0, 0.0, 0.0, HOVER_THRUST_NORM)


def _landed(plant: Plant, _now_s: float) -> MavlinkMessage:
    return M.MAVLink_extended_sys_state_message(0, 2 if plant.armed else 1)


def _origin(_plant: Plant, _now_s: float) -> MavlinkMessage:
    latitude_deg, longitude_deg, altitude_m = ORIGIN
    return M.MAVLink_gps_global_origin_message(
        int(1e7 * latitude_deg), int(1e7 * longitude_deg), int(1000.0 * altitude_m)
    )


def _home(_plant: Plant, _now_s: float) -> MavlinkMessage:
    (latitude_deg, longitude_deg, altitude_m), no = ORIGIN, (0.0, 0.0, 0.0)
    degrees = int(1e7 * latitude_deg), int(1e7 * longitude_deg)
    return M.MAVLink_home_position_message(*degrees, int(1000.0 * altitude_m), *no, [1.0, *no], *no)


def _rally_points(_plant: Plant, now_s: float) -> MavlinkMessage:
    return MissionCurrent(int(50.0 * now_s) % 2)


def _system(_plant: Plant, _now_s: float) -> MavlinkMessage:
    healthy = M.MAV_SYS_STATUS_PREARM_CHECK | M.MAV_SYS_STATUS_AHRS
    return M.MAVLink_sys_status_message(healthy, healthy, healthy, 0, 0, 0, 90, 0, 0, 0, 0, 0, 0)


def _estimator(_plant: Plant, _now_s: float) -> MavlinkMessage:
    return M.MAVLink_estimator_status_message(0, 831, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.3, 0.3)


def _gps(_plant: Plant, _now_s: float) -> MavlinkMessage:
    return M.MAVLink_gps_raw_int_message(0, 3, 0, 0, 0, 100, 100, 0, 0, 12)


def _parameter(_plant: Plant, now_s: float) -> MavlinkMessage:
    names = list(PARAMETERS)
    name = names[int(50.0 * now_s) % len(names)]
    return M.MAVLink_param_value_message(name.encode(), float(PARAMETERS[name]), M.MAV_PARAM_TYPE_REAL32, 8, 0)


def _ack(_plant: Plant, _now_s: float) -> MavlinkMessage:
    return M.MAVLink_command_ack_message(M.MAV_CMD_DO_SET_MODE, M.MAV_RESULT_ACCEPTED)


def _text(_plant: Plant, _now_s: float) -> MavlinkMessage:
    return M.MAVLink_statustext_message(4, b"a" * 50, 1, 0)


def _boot_ms(now_s: float) -> int:
    return int(1000.0 * now_s)


MESSAGES: tuple[Callable[[Plant, float], MavlinkMessage], ...] = (
    _heartbeat,
    _current_mode,
    _position,
    _position,
    _global_position,
    _attitude,
    _attitude_target,
    _landed,
    _origin,
    _home,
    _rally_points,
    _system,
    _estimator,
    _gps,
    _parameter,
    _ack,
    _text,
)
