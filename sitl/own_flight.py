"""How the stand-in flies its own modes: hold, take-off, landing, return, and a manual mode that nobody flies.

Everything here goes by the estimate.
"""

from __future__ import annotations

from math import hypot, isfinite, radians, tan

from companion.frames import enu_from_geodetic, quaternion_from_euler, wrap_pi
from companion.types import GRAVITY_M_S2, Vector3
from sitl.attitude_control import Setpoint
from sitl.position_control import PositionControl
from sitl.px4_modes import NEED_A_PILOT, Mode
from sitl.px4_parameters import Parameters
from sitl.px4_setpoints import Course
from sitl.quadrotor import Quadrotor

SINK_M_S = 0.85  # of a manual mode without a pilot; 0.7 to 1.0 was measured
SINK_GAIN_1_S = 6.0
DRIFT_TILT_RAD = radians(0.6)  # level is never quite level, so it drifts
TAKEN_OFF_WITHIN_M, HOME_WITHIN_M, RETURN_HEIGHT_WITHIN_M = 0.1, 0.5, 0.5
LANDING_SLOWS_M = (10.0, 5.0)  # MPC_LAND_ALT1 and MPC_LAND_ALT2 above home
FAR_DOWN_M = 100.0


class OwnFlight:
    """One vehicle's own modes. `enter` begins one, `setpoint` is due every `dt_s` while it flies it."""

    def __init__(self, quad: Quadrotor, parameters: Parameters, hover_thrust_norm: float) -> None:
        self._quad = quad
        self._parameters = parameters
        self._hover_thrust_norm = hover_thrust_norm
        self._control = PositionControl(hover_thrust_norm)
        self._home: Vector3 = quad.origin
        self._return_height_m = 0.0
        self._going_home = self._landing = False

    def enter(self, mode: Mode, home_deg_deg_m: Vector3, takeoff_altitude_amsl_m: float | None) -> None:
        """Begin to fly this mode from here; where there is no take-off altitude, MIS_TAKEOFF_ALT says how high."""
        self._home = home_deg_deg_m
        self._going_home = self._landing = False
        self._control.stop(
            self._quad.estimated_position_local_enu_m(),
            self._quad.estimated_velocity_enu_m_s(),
            self._quad.estimated_euler_rad()[2],
        )
        self._set_speeds(self._parameters["MPC_XY_CRUISE"], self._parameters["MPC_Z_V_AUTO_UP"])
        if mode is Mode.TAKEOFF:
            self._climb_to(takeoff_altitude_amsl_m)
        elif mode is Mode.LAND:
            self._landing = True
        elif mode is Mode.RTL:
            self._return()

    def forget_wind(self) -> None:
        """A new flight: what the last one leant against is over."""
        self._control.forget_wind()

    def taken_off(self) -> bool:
        up = self._control.axes[2]
        z = self._quad.estimated_position_local_enu_m()[2]
        return up.target_m == up.goal_m and abs(z - up.goal_m) < TAKEN_OFF_WITHIN_M

    def go_to(self, goal_enu_m: Vector3, yaw_rad: float | None) -> None:
        """A new place to hold, in the local frame."""
        for axis, goal in zip(self._control.axes, goal_enu_m, strict=True):
            axis.goal_m = goal
        if yaw_rad is not None:
            self._control.yaw_rad = yaw_rad

    def follow(self, course: Course, dt_s: float) -> Setpoint:
        """OFFBOARD with places or velocities. An axis for which neither is given stays where it is."""
        for axis, position, velocity in zip(self._control.axes, course.position_m, course.velocity_m_s, strict=True):
            if isfinite(position):
                axis.goal_m, axis.goal_m_s = position, None
            else:
                axis.goal_m_s = velocity if isfinite(velocity) else 0.0
        if isfinite(course.yaw_rad):
            self._control.yaw_rad = course.yaw_rad
        self._control.yaw_rad = wrap_pi(self._control.yaw_rad + course.yaw_rate_rad_s * dt_s)
        return self._control_setpoint(dt_s)

    def origin_moved(self, offset_m: Vector3) -> None:
        """The local frame was re-based; goals stay where they are in the world."""
        self._control.shift(offset_m)

    def setpoint(self, mode: Mode, dt_s: float) -> Setpoint:
        """Attitude and thrust for this step."""
        position = self._quad.estimated_position_local_enu_m()
        if mode in NEED_A_PILOT:
            return self._sink(self._quad.estimated_velocity_enu_m_s()[2], self._quad.estimated_euler_rad()[2])
        if mode is Mode.RTL and not self._landing:
            self._follow_return(position)
        if self._landing:
            self._descend(position[2])
        return self._control_setpoint(dt_s)

    def _control_setpoint(self, dt_s: float) -> Setpoint:
        return self._control.setpoint(
            self._quad.estimated_position_local_enu_m(),
            self._quad.estimated_velocity_enu_m_s(),
            self._quad.estimated_euler_rad(),
            dt_s,
        )

    def _sink(self, climb_m_s: float, yaw_rad: float) -> Setpoint:
        lift = 1.0 + SINK_GAIN_1_S * (-SINK_M_S - climb_m_s) / GRAVITY_M_S2
        level = quaternion_from_euler(0.0, DRIFT_TILT_RAD, yaw_rad)
        return Setpoint(level, self._hover_thrust_norm * min(max(lift, 0.3), 1.7))

    def _set_speeds(self, level_m_s: float, climb_m_s: float) -> None:
        """Out of parameters that anybody may set to anything."""
        for axis, speed in zip(self._control.axes, (level_m_s, level_m_s, climb_m_s), strict=True):
            axis.max_speed_m_s = min(max(speed, 0.1), 20.0)

    def _climb_to(self, altitude_amsl_m: float | None) -> None:
        up = self._control.axes[2]
        height = self._parameters["MIS_TAKEOFF_ALT"]
        top = up.goal_m + height if altitude_amsl_m is None else altitude_amsl_m - self._quad.origin[2]
        self._set_speeds(self._parameters["MPC_XY_CRUISE"], self._parameters["MPC_TKO_SPEED"])
        up.goal_m = max(top, up.goal_m)

    def _home_local(self) -> Vector3:
        return enu_from_geodetic(*self._home, self._quad.origin)

    def _return(self) -> None:
        """Climb first, to RTL_RETURN_ALT above home; near home only as high as a cone of RTL_CONE_ANG above it."""
        x, y, z = self._quad.estimated_position_local_enu_m()
        home_x, home_y, home_z = self._home_local()
        distance = hypot(x - home_x, y - home_y)
        height = self._parameters["RTL_RETURN_ALT"]
        if distance < self._parameters["RTL_MIN_DIST"]:
            half_angle = radians(min(max(self._parameters["RTL_CONE_ANG"], 1.0), 89.0))
            height = min(height, distance / tan(half_angle))
        self._return_height_m = self._control.axes[2].goal_m = max(z, home_z + height)

    def _follow_return(self, position_m: Vector3) -> None:
        x, y, z = position_m
        home_x, home_y, _ = self._home_local()
        if not self._going_home and abs(z - self._return_height_m) < RETURN_HEIGHT_WITHIN_M:
            self._going_home = True
            self._control.axes[0].goal_m, self._control.axes[1].goal_m = home_x, home_y
        self._landing = self._going_home and hypot(x - home_x, y - home_y) < HOME_WITHIN_M

    def _descend(self, z_m: float) -> None:
        """MPC_LAND_SPEED near the ground, MPC_Z_V_AUTO_DN high above it."""
        slow, fast = self._parameters["MPC_LAND_SPEED"], self._parameters["MPC_Z_V_AUTO_DN"]
        high, low = LANDING_SLOWS_M
        share = min(max((z_m - self._home_local()[2] - low) / (high - low), 0.0), 1.0)
        up = self._control.axes[2]
        up.max_speed_m_s = min(max(slow + share * (fast - slow), 0.1), 10.0)
        up.goal_m = up.target_m - FAR_DOWN_M
