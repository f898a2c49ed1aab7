"""One MAVLink link of the stand-in: which messages go out on it how often, and whether a ground station listens there."""

from __future__ import annotations

from math import inf

from companion.mavlink.codec import mavlink

M = mavlink
EPSILON_S = 1e-6
MAX_RATE_HZ = 125.0  # 500 Hz is accepted and gives 125

# Default rates in Hz of PX4's onboard link; what is not listed is off until asked for.
ONBOARD_RATES_HZ = {
    M.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    M.MAVLINK_MSG_ID_TIMESYNC: 10.0,
    M.MAVLINK_MSG_ID_HIGHRES_IMU: 50.0,
    M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    M.MAVLINK_MSG_ID_ATTITUDE: 100.0,
    M.MAVLINK_MSG_ID_ALTITUDE: 10.0,
    M.MAVLINK_MSG_ID_ODOMETRY: 30.0,
    M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    M.MAVLINK_MSG_ID_ATTITUDE_TARGET: 10.0,
    M.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    M.MAVLINK_MSG_ID_CURRENT_MODE: 0.5,
    M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
    M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 50.0,
    M.MAVLINK_MSG_ID_GPS_RAW_INT: 8.0,
    M.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    M.MAVLINK_MSG_ID_PING: 1.0,
    M.MAVLINK_MSG_ID_SYS_STATUS: 5.0,
    M.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    M.MAVLINK_MSG_ID_VFR_HUD: 10.0,
}
# And of the link to a ground station, once one was heard there.
GROUND_RATES_HZ = {
    M.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
    M.MAVLINK_MSG_ID_ATTITUDE: 15.0,
    M.MAVLINK_MSG_ID_ALTITUDE: 1.0,
    M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 10.0,
    M.MAVLINK_MSG_ID_ATTITUDE_TARGET: 2.0,
    M.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    M.MAVLINK_MSG_ID_CURRENT_MODE: 0.5,
    M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 0.5,
    M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    M.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
    M.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    M.MAVLINK_MSG_ID_PING: 0.1,
    M.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    M.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    M.MAVLINK_MSG_ID_VFR_HUD: 4.0,
}
HEARTBEAT_ONLY = {M.MAVLINK_MSG_ID_HEARTBEAT: 1.0}
# Streams of PX4 that have nothing to say here: their intervals may be set, as those of a sensor that is not fitted.
SILENT = frozenset(
    {
        M.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,  # told once and on every change, whatever the interval
        M.MAVLINK_MSG_ID_RC_CHANNELS,
        M.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,
        M.MAVLINK_MSG_ID_DISTANCE_SENSOR,
        M.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD,
        M.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
        M.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
        M.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT,
        M.MAVLINK_MSG_ID_SCALED_IMU,
        M.MAVLINK_MSG_ID_SCALED_PRESSURE,
        M.MAVLINK_MSG_ID_VIBRATION,
        M.MAVLINK_MSG_ID_WIND_COV,
        M.MAVLINK_MSG_ID_UTM_GLOBAL_POSITION,
    }
)
SETTABLE = (frozenset(ONBOARD_RATES_HZ) | SILENT) - {M.MAVLINK_MSG_ID_HEARTBEAT}


class Schedule:
    """Rates of one link, on the autopilot's own clock. They outlive a reconnection of the peer."""

    def __init__(self, rates_hz: dict[int, float]) -> None:
        self._setpoint_told: object = None
        self.reset(rates_hz, 0.0)

    def reset(self, rates_hz: dict[int, float], now_s: float) -> None:
        """Other defaults: a ground link says more once somebody was heard there."""
        self._defaults = rates_hz
        self._period_s = {message_id: 1.0 / rate_hz for message_id, rate_hz in rates_hz.items() if rate_hz > 0.0}
        self._due_s = dict.fromkeys(self._period_s, now_s)
        self._next_s = now_s

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> bool:
        """MAV_CMD_SET_MESSAGE_INTERVAL: 0 is the default, -1 off. False where it cannot be changed."""
        if message_id not in SETTABLE:
            return False
        if message_id in SILENT:
            return True
        rate_hz = self._defaults.get(message_id, 0.0) if interval_us == 0.0 else 1e6 / interval_us
        self._due_s.pop(message_id, None)
        self._period_s.pop(message_id, None)
        if rate_hz > 0.0:
            self._period_s[message_id] = 1.0 / min(rate_hz, MAX_RATE_HZ)
            self._due_s[message_id] = now_s + self._period_s[message_id]
        self._next_s = min(self._due_s.values(), default=inf)
        return True

    def interval_us(self, message_id: int) -> int:
        """As MESSAGE_INTERVAL tells it: -1 off."""
        return round(self._period_s[message_id] * 1e6) if message_id in self._period_s else -1

    def due(self, now_s: float, setpoint: object = None) -> list[int]:
        """What is to be sent now. Evenly spaced: a late step does not shift what follows.

        ATTITUDE_TARGET is an echo: it waits for another setpoint than it told last, and then goes out at once. None is
        always another.
        """
        if now_s < self._next_s - EPSILON_S:
            return []
        ready = [message_id for message_id, due_s in self._due_s.items() if now_s >= due_s - EPSILON_S]
        if M.MAVLINK_MSG_ID_ATTITUDE_TARGET in ready:
            if setpoint is not None and setpoint is self._setpoint_told:
                ready.remove(M.MAVLINK_MSG_ID_ATTITUDE_TARGET)
            self._setpoint_told = setpoint
        for message_id in ready:
            period_s = self._period_s[message_id]
            next_s = self._due_s[message_id] + period_s
            self._due_s[message_id] = next_s if next_s > now_s else now_s + period_s
        self._next_s = min(self._due_s.values(), default=inf)
        return ready
