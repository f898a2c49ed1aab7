"""PX4's links: default message rates and the intervals that can be set."""

from __future__ import annotations

from math import inf

from companion.mavlink.codec import mavlink
from sitl.autopilots.px4.autopilot import Px4
from sitl.links.schedule import Schedule

MAX_RATE_HZ = 125.0  # 500 Hz is accepted and gives 125
STATUS_PERIOD_S = 0.51  # of CURRENT_MODE while nothing changes, whatever the interval

# Default rates in Hz of PX4's onboard link; other messages are off until requested.
ONBOARD_RATES_HZ = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_TIMESYNC: 10.0,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: 50.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 100.0,
    mavlink.MAVLINK_MSG_ID_ALTITUDE: 10.0,
    mavlink.MAVLINK_MSG_ID_ODOMETRY: 30.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: 10.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_CURRENT_MODE: 0.5,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 50.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 8.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    mavlink.MAVLINK_MSG_ID_PING: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 5.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 10.0,
}
# Of the ground link, after its peer has connected.
GROUND_RATES_HZ = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 15.0,
    mavlink.MAVLINK_MSG_ID_ALTITUDE: 1.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 10.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: 2.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_CURRENT_MODE: 0.5,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    mavlink.MAVLINK_MSG_ID_PING: 0.1,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 4.0,
}
HEARTBEAT_ONLY = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0}
# Streams of PX4 without data here: their intervals can be set, as for a sensor that is not fitted.
SILENT = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,  # sent once and on every change, whatever the interval
        mavlink.MAVLINK_MSG_ID_RC_CHANNELS,
        mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,
        mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR,
        mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
        mavlink.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT,
        mavlink.MAVLINK_MSG_ID_SCALED_IMU,
        mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE,
        mavlink.MAVLINK_MSG_ID_VIBRATION,
        mavlink.MAVLINK_MSG_ID_WIND_COV,
        mavlink.MAVLINK_MSG_ID_UTM_GLOBAL_POSITION,
    }
)
SETTABLE = (frozenset(ONBOARD_RATES_HZ) | SILENT) - {mavlink.MAVLINK_MSG_ID_HEARTBEAT}


class Px4Schedule(Schedule):
    """PX4's rates: which intervals can be set, and which messages are sent only on change."""

    def __init__(self, px4: Px4, rates_hz: dict[int, float]) -> None:
        super().__init__(rates_hz)
        self._px4 = px4
        self._setpoint_sent: object = None
        self._status_sent: object = None
        self._status_sent_s = -inf

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> bool:
        """MAV_CMD_SET_MESSAGE_INTERVAL: 0 is the default, -1 off. False if it cannot be changed."""
        if message_id not in SETTABLE:
            return False
        if message_id not in SILENT:
            rate_hz = self.default_hz(message_id) if interval_us == 0.0 else 1e6 / interval_us
            self.set_rate(message_id, min(rate_hz, MAX_RATE_HZ), now_s)
        return True

    def _without_old_news(self, ready: list[int]) -> list[int]:
        if mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET in ready and not self._setpoint_is_new():
            ready.remove(mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET)
        if mavlink.MAVLINK_MSG_ID_CURRENT_MODE in ready and not self._mode_is_due():
            ready.remove(mavlink.MAVLINK_MSG_ID_CURRENT_MODE)
            self.postpone(mavlink.MAVLINK_MSG_ID_CURRENT_MODE)
        return ready

    def _setpoint_is_new(self) -> bool:
        """The echo waits for a new setpoint, then is sent at once. Disarmed it is sent at its rate."""
        before, self._setpoint_sent = self._setpoint_sent, self._px4.setpoint if self._px4.armed else None
        return self._setpoint_sent is None or self._setpoint_sent is not before

    def _mode_is_due(self) -> bool:
        """Only when the vehicle's status has changed, or after 0.51 to 0.53 s, as measured."""
        px4 = self._px4
        status = (px4.mode, px4.intended_mode, px4.armed, px4.failsafe)
        if status == self._status_sent and px4.time_s - self._status_sent_s < STATUS_PERIOD_S:
            return False
        self._status_sent, self._status_sent_s = status, px4.time_s
        return True
