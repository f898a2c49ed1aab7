"""A hovering autopilot: enough of PX4, on a real UDP socket, for an agent process. No physics.

Unlike the stand-in it sends exactly what a test sets, and keeps all messages that it receives.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from background import Background
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, SigningKey, mavlink
from tests.fuzz.plant import PARAMETERS

PERIOD_S = 0.02
LOITER, OFFBOARD = (4, 3), (6, 0)
HOVER_THRUST_NORM = 0.49
IN_ORDER = {name: float(value) for name, value in PARAMETERS.items()} | {"MPC_THR_HOVER": HOVER_THRUST_NORM}


@dataclass
class HoveringAutopilot(Background):
    """Sends to `port` of this machine. Attributes may be changed while it runs."""

    vehicle_id: int
    port: int
    autopilot: int = mavlink.MAV_AUTOPILOT_PX4
    positions: bool = True  # LOCAL_POSITION_NED at 50 Hz
    accepts_modes: bool = True
    mode: tuple[int, int] = LOITER
    key: SigningKey | None = None
    parameters: dict[str, float] = field(
        default_factory=IN_ORDER.copy
    )  # reported as floats; requests of others get no answer
    target_times_s: list[float] = field(default_factory=list)
    thrusts: list[float] = field(default_factory=list)  # of the setpoints at those times
    received: list[MavlinkMessage] = field(default_factory=list)  # all but SET_ATTITUDE_TARGET

    def __post_init__(self) -> None:
        super().__init__()
        self._socket = self.udp_socket()
        self._socket.setblocking(False)
        self._codec = MavlinkCodec(self.vehicle_id, mavlink.MAV_COMP_ID_AUTOPILOT1, self.key)

    def inject(self, data: bytes) -> None:
        """Send bytes from the address of this autopilot."""
        self._socket.sendto(data, ("127.0.0.1", self.port))

    def commands(self, number: int) -> list[MavlinkMessage]:
        """The received COMMAND_LONGs of this number."""
        return [m for m in self.received if m.get_type() == "COMMAND_LONG" and m.command == number]

    def run(self) -> None:
        start_s, count = time.monotonic(), 0
        while not self.ended.wait(max(0.0, start_s + count * PERIOD_S - time.monotonic())):
            for message in self._outgoing(int((time.monotonic() - start_s) * 1000), count):
                self._socket.sendto(self._codec.encode(message), ("127.0.0.1", self.port))
            self._listen()
            count += 1

    def _outgoing(self, boot_ms: int, count: int) -> list[MavlinkMessage]:
        main, sub = self.mode
        custom_mode = main << 16 | sub << 24
        messages = [
            mavlink.MAVLink_attitude_quaternion_message(boot_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            mavlink.MAVLink_current_mode_message(0, custom_mode, custom_mode),
            mavlink.MAVLink_attitude_target_message(boot_ms, 7, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, HOVER_THRUST_NORM),
        ]
        if count % 10 == 0:
            armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            messages += [
                mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, self.autopilot, armed, custom_mode, 4, 3),
                mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_IN_AIR),
                mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, 0, 90, 0, 0, 0, 0, 0, 0),
                mavlink.MAVLink_gps_global_origin_message(473977420, 85455940, 488000),
            ]
        if self.positions:
            messages.append(mavlink.MAVLink_local_position_ned_message(boot_ms, 0.0, 0.0, -2.0, 0.0, 0.0, 0.0))
        return messages

    def _listen(self) -> None:
        while True:
            try:
                data = self._socket.recv(4096)
            except BlockingIOError:
                return
            except ConnectionError:
                continue  # no receiver yet
            for message in self._codec.decode(data):
                self._take(message)

    def _take(self, message: MavlinkMessage) -> None:
        if message.get_type() == "SET_ATTITUDE_TARGET":
            self.target_times_s.append(time.monotonic())
            self.thrusts.append(message.thrust)
            return
        self.received.append(message)
        if message.get_type() == "PARAM_REQUEST_READ" and message.param_id in self.parameters:
            self._report_parameter(message.param_id)
        is_mode = message.get_type() == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_DO_SET_MODE
        if is_mode and self.accepts_modes:
            self.mode = (int(message.param2), int(message.param3))

    def _report_parameter(self, name: str) -> None:
        value = mavlink.MAVLink_param_value_message(
            name.encode(), self.parameters[name], mavlink.MAV_PARAM_TYPE_REAL32, len(self.parameters), 0
        )
        self._socket.sendto(self._codec.encode(value), ("127.0.0.1", self.port))
