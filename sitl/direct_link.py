"""One stand-in and its agent's end of the MAVLink link, without sockets: what each says reaches the other after a delay.

What goes 50 times a second is handed over as typed values, as the translator would make them of the bytes; what is asked
now and then, and its answers, goes through real MAVLink.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable

from companion.frames import quaternion_from_euler
from companion.mavlink import telemetry
from companion.mavlink.codec import MavlinkCodec, mavlink
from companion.mavlink.manners import MANNERS
from companion.mavlink.translator import Translator
from companion.types import (
    AttitudeSample,
    AttitudeTarget,
    AutopilotKind,
    AutopilotRequest,
    LandedSample,
    LandedState,
    ModeSample,
    PositionSample,
    Telemetry,
)
from sitl.attitude_control import Setpoint
from sitl.config import Links
from sitl.px4 import Px4
from sitl.px4_commands import Receiver
from sitl.px4_link import Schedule
from sitl.px4_messages import heartbeat
from sitl.px4_modes import Mode

M = mavlink
KIND = AutopilotKind.PX4
# What the agent hears of, at the rates that it asks for.
RATES_HZ = {M.MAVLINK_MSG_ID_HEARTBEAT: 1.0} | {
    message_id: 1e6 / period_us for message_id, period_us in MANNERS[KIND].STREAMS_US.items() if period_us > 0
}
_MODES = {mode: MANNERS[KIND].mode_of(mode.custom_mode) for mode in Mode}
_FLOATS = struct.Struct("<6f")  # MAVLink's floats have 32 bits: micrometres, where a vehicle is 10 m away


def _heartbeat(px4: Px4, received_s: float) -> tuple[Telemetry, ...]:
    return (telemetry.heartbeat(heartbeat(px4), KIND, received_s), *_mode(px4, received_s))


def _mode(px4: Px4, received_s: float) -> tuple[Telemetry, ...]:
    return (ModeSample(received_s, *_MODES[px4.mode]),)


def _position(px4: Px4, received_s: float) -> tuple[Telemetry, ...]:
    x, y, z, vx, vy, vz = _FLOATS.unpack(
        _FLOATS.pack(*px4.quad.estimated_position_local_enu_m(), *px4.quad.estimated_velocity_enu_m_s())
    )
    return (PositionSample(received_s, px4.boot_ms / 1000.0, (x, y, z), (vx, vy, vz)),)


def _attitude(px4: Px4, received_s: float) -> tuple[Telemetry, ...]:
    """Not by way of a 32 bit quaternion, which would change it by less than a microradian."""
    return (AttitudeSample(received_s, *px4.quad.estimated_euler_rad()),)


def _landed(px4: Px4, received_s: float) -> tuple[Telemetry, ...]:
    return (LandedSample(received_s, LandedState(px4.landed_state)),)


SAMPLES: dict[int, Callable[[Px4, float], tuple[Telemetry, ...]]] = {
    M.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    M.MAVLINK_MSG_ID_CURRENT_MODE: _mode,
    M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _position,
    M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude,
    M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _landed,
}


def setpoint_of(target: AttitudeTarget) -> Setpoint:
    """What the stand-in follows when this SET_ATTITUDE_TARGET has reached it; the 32 bits are left out here, too."""
    return Setpoint(quaternion_from_euler(target.roll_rad, target.pitch_rad, target.yaw_rad), target.thrust_norm)


class DirectLink:
    """Times are of the world's clock. Telemetry begins at `phase_s`."""

    def __init__(self, px4: Px4, links: Links, phase_s: float) -> None:
        self.px4 = px4
        self._telemetry_delay_s = links.telemetry_delay_s
        self._setpoint_delay_s = links.setpoint_delay_s
        self._schedule = Schedule(RATES_HZ)
        self._schedule.reset(RATES_HZ, phase_s)
        self._receiver = Receiver(px4, self._schedule)
        self._translator = Translator(px4.system_id, KIND)
        self._autopilot_codec = MavlinkCodec(px4.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._to_agent: deque[Telemetry] = deque()  # in the order of `received_s`
        self._positions_s: deque[float] = deque()  # when those among them arrive
        self._to_autopilot: deque[tuple[float, Setpoint | bytes]] = deque()

    # ------------------------------------------------------------ the autopilot's end

    def deliver(self, now_s: float) -> None:
        """Let the autopilot have what has reached it by now."""
        while self._to_autopilot and self._to_autopilot[0][0] <= now_s:
            _, what = self._to_autopilot.popleft()
            if isinstance(what, Setpoint):
                self.px4.offboard_setpoint(what)
            else:
                self._answer(what, now_s)

    def tell(self, now_s: float) -> None:
        """Send the telemetry that is due."""
        due = self._schedule.due(now_s)
        if not due:
            return
        received_s = now_s + self._telemetry_delay_s
        for message_id in due:
            self._to_agent.extend(SAMPLES[message_id](self.px4, received_s))
            if message_id == M.MAVLINK_MSG_ID_LOCAL_POSITION_NED:
                self._positions_s.append(received_s)

    def _answer(self, data: bytes, now_s: float) -> None:
        for message in self._autopilot_codec.decode(data):
            for answer in self._receiver.receive(message):
                told = self._autopilot_codec.encode(answer)
                self._to_agent.extend(self._translator.telemetry(told, now_s + self._telemetry_delay_s))

    # ------------------------------------------------------------ the agent's end

    def tick_s(self, before_s: float) -> float | None:
        """When a position arrives, which sets off a tick; None where none does before `before_s`."""
        if not self._positions_s or self._positions_s[0] >= before_s:
            return None
        return self._positions_s.popleft()

    def drain(self, now_s: float) -> tuple[Telemetry, ...]:
        """All that has come by now since the last call."""
        arrived = []
        while self._to_agent and self._to_agent[0].received_s <= now_s:
            arrived.append(self._to_agent.popleft())
        return tuple(arrived)

    def command(self, target: AttitudeTarget, now_s: float) -> None:
        self._to_autopilot.append((now_s + self._setpoint_delay_s, setpoint_of(target)))

    def request(self, request: AutopilotRequest, now_s: float) -> None:
        self._to_autopilot.append((now_s + self._setpoint_delay_s, self._translator.request(request)))
