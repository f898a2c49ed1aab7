"""A stand-in with external vision in place of GPS, at the bytes of one link, with the motion-capture system that feeds it."""

from __future__ import annotations

from math import hypot, nan
from random import Random
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

from companion.geometry.frames import euler_from_quaternion, euler_ned_from_enu, ned_from_enu, quaternion_from_euler
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage
from companion.mavlink.codec import mavlink as M  # noqa: N812 -- short, used in most lines
from companion.types.autopilot import AutopilotKind
from companion.types.values import ZERO3, Vector3
from sitl.autopilots.types import AUTOPILOT_TYPES
from sitl.vehicle.config import AutopilotFile, StandIn

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
DT_S = 0.004
CHUNK = 50  # characters of a STATUSTEXT
STREAMS = (
    M.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    M.MAVLINK_MSG_ID_ATTITUDE,
    M.MAVLINK_MSG_ID_GPS_RAW_INT,
)
LONGEST_TEXT_WAIT_S = 0.1


class Laboratory:
    """One vehicle. The poses are its true ones in NED with 2 mm and 3 mrad of noise, and with the errors that are set here."""

    def __init__(self, kind: AutopilotKind, message: str = "VISION_POSITION_ESTIMATE", **stand_in: Any) -> None:
        section = StandIn(autopilot=kind, **({"positioning": "external_vision", "sensors": "ideal"} | stand_in))
        self.vehicle: Any = AUTOPILOT_TYPES[kind].vehicle(AutopilotFile(stand_in=section), DT_S)
        self.end = AUTOPILOT_TYPES[kind].onboard_link(self.vehicle)
        self.message = message
        self.shift_ned_m, self.turn_rad, self.reset_counter = ZERO3, 0.0, 0
        self.frozen = False
        self.goal_ned_m: Vector3 | None = None  # of a stream of positions
        self.received: list[MavlinkMessage] = []
        self.texts: dict[str, float] = {}  # when each came first
        self._random = Random(1)
        self._client = MavlinkCodec(255, 190)
        self._reader = ardupilotmega.MAVLink(None)
        self._reader.robust_parsing = True
        self._steps = 0
        self._begun = ""  # a text whose other chunks follow
        self._pose: MavlinkMessage | None = None
        status = M.MAVLINK_MSG_ID_ESTIMATOR_STATUS if kind is PX4 else 193
        for message_id in (*STREAMS, status):
            self.command(M.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 20_000.0)

    # ------------------------------------------------------------ time

    def fly(self, seconds: float, pose_hz: float = 50.0) -> None:
        """Advance the time, with poses at this rate or without any."""
        every = round(1.0 / pose_hz / DT_S) if pose_hz else 0
        for _ in range(round(seconds / DT_S)):
            if self._steps % 250 == 0:
                self.send(M.MAVLink_heartbeat_message(M.MAV_TYPE_GCS, M.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))
            if every and self._steps % every == 0:
                self.send(self.pose())
            if self.goal_ned_m and self._steps % 5 == 0:
                self.send(
                    M.MAVLink_set_position_target_local_ned_message(
                        0, 1, 1, M.MAV_FRAME_LOCAL_NED, 0xDF8, *self.goal_ned_m, *[0.0] * 8
                    )
                )
            self._steps += 1
            self.vehicle.step()
            self._decode(b"".join(self.end.due()))
            self.vehicle.texts.clear()

    def until(self, reached: Any, within_s: float, pose_hz: float = 50.0) -> float:
        """Seconds until `reached()` is true."""
        for step in range(round(within_s / DT_S) + 1):
            if reached():
                return step * DT_S
            self.fly(DT_S, pose_hz)
        raise AssertionError(f"not within {within_s} s")

    def pose(self) -> MavlinkMessage:
        """What the capture system says now."""
        if self.frozen and self._pose is not None:
            return self._pose
        noise_m = [self._random.gauss(0.0, 0.002) for _ in range(3)]
        quad = self.vehicle.quad
        north, east, down = (
            a + b + c for a, b, c in zip(ned_from_enu(quad.position_enu_m), self.shift_ned_m, noise_m, strict=True)
        )
        roll, pitch, yaw = euler_ned_from_enu(*euler_from_quaternion(quad.quaternion))
        yaw += self.turn_rad + self._random.gauss(0.0, 0.003)
        covariance, now_us = [nan] + [0.0] * 20, self.vehicle.boot_ms * 1000
        if self.message == "ODOMETRY":
            q = quaternion_from_euler(roll, pitch, yaw)
            self._pose = M.MAVLink_odometry_message(
                now_us,
                M.MAV_FRAME_LOCAL_FRD,
                M.MAV_FRAME_BODY_FRD,
                north,
                east,
                down,
                q,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                covariance,
                covariance,
                self.reset_counter,
            )
        else:
            self._pose = M.MAVLink_vision_position_estimate_message(
                now_us, north, east, down, roll, pitch, yaw, covariance, self.reset_counter
            )
        return self._pose

    # ------------------------------------------------------------ the link

    def send(self, message: MavlinkMessage, sender: tuple[int, int] | None = None) -> list[MavlinkMessage]:
        """The answers to one message."""
        before = len(self.received)
        codec = MavlinkCodec(*sender) if sender else self._client
        self._decode(b"".join(self.end.receive(codec.encode(message))))
        return self.received[before:]

    def command(self, number: int, *parameters: float) -> list[int]:
        """The MAV_RESULTs, in order."""
        padded = [*parameters, *[0.0] * (7 - len(parameters))]
        answers = self.send(M.MAVLink_command_long_message(1, 1, number, 0, *padded))
        return [answer.result for answer in answers if answer.get_type() == "COMMAND_ACK"]

    def arm(self) -> list[int]:
        results = self.command(M.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        self.fly(LONGEST_TEXT_WAIT_S)
        return results

    def set_mode(self, *parameters: float) -> list[int]:
        return self.command(M.MAV_CMD_DO_SET_MODE, 1.0, *parameters)

    def set_origin(self, altitude_m: float) -> None:
        self.send(M.MAVLink_set_gps_global_origin_message(1, 473977420, 85455940, round(altitude_m * 1e3)))

    def _decode(self, data: bytes) -> None:
        for message in (self._reader.parse_buffer(data) or []) if data else []:
            self.received.append(message)
            if message.get_type() == "STATUSTEXT":
                self._begun = self._begun * bool(message.chunk_seq) + message.text
                if len(message.text) < CHUNK:
                    self.texts.setdefault(self._begun.rstrip("\t"), self.vehicle.time_s)

    def last(self, kind: str) -> MavlinkMessage:
        return self.messages(kind)[-1]

    def messages(self, kind: str) -> list[MavlinkMessage]:
        return [message for message in self.received if message.get_type() == kind]

    # ------------------------------------------------------------ what is measured

    @property
    def flags(self) -> int:
        """Of the newest ESTIMATOR_STATUS or EKF_STATUS_REPORT."""
        kinds = ("ESTIMATOR_STATUS", "EKF_STATUS_REPORT")
        return next(int(message.flags) for message in reversed(self.received) if message.get_type() in kinds)

    @property
    def local_ned_m(self) -> Vector3:
        """Of the newest LOCAL_POSITION_NED."""
        message = self.last("LOCAL_POSITION_NED")
        return (message.x, message.y, message.z)

    @property
    def true_ned_m(self) -> Vector3:
        return ned_from_enu(self.vehicle.quad.position_enu_m)

    @property
    def error_m(self) -> float:
        """Distance of the estimate from the truth in the plane."""
        x, y, _ = self.vehicle.quad.estimated_position_local_enu_m()
        east, north, _ = self.vehicle.quad.position_enu_m
        return hypot(x - east, y - north)

    @property
    def height_m(self) -> float:
        return float(self.vehicle.quad.position_enu_m[2])
