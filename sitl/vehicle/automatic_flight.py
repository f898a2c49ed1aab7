"""Automatic flight of a stand-in: hold, take-off, landing, return, and a manual mode without a pilot.

All control uses the estimate. Each autopilot type sets the tasks of its flight modes and their speeds. Beside it stands the
detection of landings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto
from math import hypot, isfinite, radians

from companion.geometry.frames import Quaternion, enu_from_geodetic, quaternion_from_euler, wrap_pi
from companion.types.values import GRAVITY_M_S2, Vector3
from sitl.vehicle.control import MAX_LIFT_RATIO, MIN_LIFT_RATIO, AttitudeSetpoint, PositionControl
from sitl.vehicle.quadrotor import Quadrotor

SINK_GAIN_1_S = 6.0
DRIFT_TILT_RAD = radians(0.6)  # error of the level attitude, which makes it drift
TAKEN_OFF_WITHIN_M, RETURN_HEIGHT_WITHIN_M = 0.1, 0.5
FAR_DOWN_M = 100.0
LEAST_COS_TILT = 0.1
LANDED_AFTER_S = 0.5  # on the ground with little thrust


class Task(Enum):
    """The task of a flight mode."""

    HOLD = auto()
    TAKE_OFF = auto()
    LAND = auto()
    RETURN = auto()
    SINK = auto()  # a manual mode without a pilot


class Stage(Enum):
    """Stages of a return before the landing."""

    CLIMB = auto()
    WAY_HOME = auto()
    WAIT = auto()  # above home


@dataclass(frozen=True, slots=True)
class Course:
    """Position or velocity per axis in the local ENU frame, NaN if not given; the position has priority."""

    position_m: Vector3
    velocity_m_s: Vector3
    yaw_rad: float
    yaw_rate_rad_s: float


@dataclass(frozen=True, slots=True)
class Speeds:
    """Speeds and heights of automatic flight, from an autopilot's parameters. Heights are above home.

    A landing descends at `land_m_s` below the lower of `landing_slows_m` and at `descend_m_s` above the higher. A return first
    climbs to `return_height_m(horizontal distance from home)`, unless the vehicle is higher. Home is reached within
    `return_accepts_m`; there it descends to `return_wait_height_m`, waits for `return_wait_s`, and lands. Both may be infinite.
    """

    level_m_s: float
    climb_m_s: float
    take_off_m_s: float
    land_m_s: float
    descend_m_s: float
    landing_slows_m: tuple[float, float]
    sink_m_s: float
    take_off_height_m: float
    return_height_m: Callable[[float], float]
    return_accepts_m: float
    return_wait_height_m: float
    return_wait_s: float


class AutomaticFlight:
    """Automatic flight of one vehicle. `enter` begins a task; `setpoint` is called every `dt_s` while it lasts.

    `speeds` is called at every use, because parameters may change in flight.
    """

    def __init__(
        self, quad: Quadrotor, speeds: Callable[[], Speeds], hover_thrust_norm: float, braking_m_s2: float
    ) -> None:
        self._quad = quad
        self._speeds = speeds
        self.hover_thrust_norm = hover_thrust_norm
        self._control = PositionControl(hover_thrust_norm, braking_m_s2)
        self._task = Task.HOLD
        self._home: Vector3 = quad.origin
        self._stage = Stage.CLIMB
        self._waited_s = 0.0
        self.landing = False  # it descends to the ground, in a landing or at the end of a return

    def enter(self, task: Task, home_deg_deg_m: Vector3, takeoff_altitude_amsl_m: float | None) -> None:
        """Begin this task here. Without a take-off altitude the height is that of `speeds`."""
        self._task = task
        self._home = home_deg_deg_m
        self._stage, self._waited_s, self.landing = Stage.CLIMB, 0.0, False
        position_m, velocity_m_s, euler_rad = self._quad.estimate()
        self._control.stop(position_m, velocity_m_s, euler_rad[2])
        speeds = self._speeds()
        self._set_speeds(speeds.level_m_s, speeds.climb_m_s)
        if task is Task.TAKE_OFF:
            self._climb_to(takeoff_altitude_amsl_m, speeds)
        elif task is Task.LAND:
            self.landing = True
        elif task is Task.RETURN:
            self._return(speeds)

    def reset_integrals(self) -> None:
        """Before a new flight: the wind may have changed."""
        self._control.reset_integrals()

    def taken_off(self) -> bool:
        up = self._control.axes[2]
        z = self._quad.estimated_position_local_enu_m()[2]
        return up.target_m == up.goal_m and abs(z - up.goal_m) < TAKEN_OFF_WITHIN_M

    def go_to(self, goal_enu_m: Vector3, yaw_rad: float | None) -> None:
        """Hold this position of the local frame."""
        for axis, goal in zip(self._control.axes, goal_enu_m, strict=True):
            axis.goal_m = goal
        if yaw_rad is not None:
            self._control.yaw_rad = yaw_rad

    def follow(self, course: Course, dt_s: float) -> AttitudeSetpoint:
        """Follow external positions or velocities. An axis without either holds its position."""
        for axis, position, velocity in zip(self._control.axes, course.position_m, course.velocity_m_s, strict=True):
            if isfinite(position):
                axis.goal_m, axis.goal_m_s = position, None
            else:
                axis.goal_m_s = velocity if isfinite(velocity) else 0.0
        if isfinite(course.yaw_rad):
            self._control.yaw_rad = course.yaw_rad
        self._control.yaw_rad = wrap_pi(self._control.yaw_rad + course.yaw_rate_rad_s * dt_s)
        return self._control_setpoint(dt_s)

    def climb(self, attitude: Quaternion, climb_m_s: float, dt_s: float) -> AttitudeSetpoint:
        """This attitude, with the thrust of the vertical loop at this climb rate."""
        up = self._control.axes[2]
        up.goal_m_s = climb_m_s
        acceleration = up.acceleration_m_s2(
            self._quad.estimated_position_local_enu_m()[2], self._quad.estimated_velocity_enu_m_s()[2], dt_s
        )
        lift = min(max(1.0 + acceleration / GRAVITY_M_S2, MIN_LIFT_RATIO), MAX_LIFT_RATIO)
        thrust = self.hover_thrust_norm * lift / max(cos_tilt(attitude), LEAST_COS_TILT)
        return AttitudeSetpoint(attitude, min(thrust, 1.0))

    def origin_moved(self, offset_m: Vector3) -> None:
        """The local frame has moved; goals keep their place in the world."""
        self._control.shift(offset_m)

    def setpoint(self, dt_s: float) -> AttitudeSetpoint:
        """Attitude and thrust for this step of the task."""
        position = self._quad.estimated_position_local_enu_m()
        if self._task is Task.SINK:
            return self._sink(self._quad.estimated_velocity_enu_m_s()[2], self._quad.estimated_euler_rad()[2])
        if self._task is Task.RETURN and not self.landing:
            self._follow_return(position, dt_s)
        if self.landing:
            self._descend(position[2])
        return self._control_setpoint(dt_s)

    def _control_setpoint(self, dt_s: float) -> AttitudeSetpoint:
        return self._control.setpoint(*self._quad.estimate(), dt_s)

    def _sink(self, climb_m_s: float, yaw_rad: float) -> AttitudeSetpoint:
        lift = 1.0 + SINK_GAIN_1_S * (-self._speeds().sink_m_s - climb_m_s) / GRAVITY_M_S2
        level = quaternion_from_euler(0.0, DRIFT_TILT_RAD, yaw_rad)
        return AttitudeSetpoint(level, self.hover_thrust_norm * min(max(lift, 0.3), 1.7))

    def _set_speeds(self, level_m_s: float, climb_m_s: float) -> None:
        """Clamped: clients may set parameters to any value."""
        for axis, speed in zip(self._control.axes, (level_m_s, level_m_s, climb_m_s), strict=True):
            axis.max_speed_m_s = min(max(speed, 0.1), 20.0)

    def _climb_to(self, altitude_amsl_m: float | None, speeds: Speeds) -> None:
        up = self._control.axes[2]
        height = speeds.take_off_height_m
        top = up.goal_m + height if altitude_amsl_m is None else altitude_amsl_m - self._quad.origin[2]
        self._set_speeds(speeds.level_m_s, speeds.take_off_m_s)
        up.goal_m = max(top, up.goal_m)

    def _home_local(self) -> Vector3:
        return enu_from_geodetic(*self._home, self._quad.origin)

    def _return(self, speeds: Speeds) -> None:
        """Climb first, near home to a lower height."""
        x, y, z = self._quad.estimated_position_local_enu_m()
        home_x, home_y, home_z = self._home_local()
        self._control.axes[2].goal_m = max(z, home_z + speeds.return_height_m(hypot(x - home_x, y - home_y)))

    def _follow_return(self, position_m: Vector3, dt_s: float) -> None:
        x, y, z = position_m
        home_x, home_y, home_z = self._home_local()
        east, north, up = self._control.axes
        speeds, at_height = self._speeds(), abs(z - up.goal_m) < RETURN_HEIGHT_WITHIN_M
        if self._stage is Stage.CLIMB and at_height:
            self._stage = Stage.WAY_HOME
            east.goal_m, north.goal_m = home_x, home_y
        elif self._stage is Stage.WAY_HOME and hypot(x - home_x, y - home_y) < speeds.return_accepts_m:
            self._stage = Stage.WAIT
            up.goal_m = min(up.goal_m, home_z + speeds.return_wait_height_m)
        elif self._stage is Stage.WAIT and at_height:
            self._waited_s += dt_s
            self.landing = self._waited_s > speeds.return_wait_s

    def _descend(self, z_m: float) -> None:
        """Descend, more slowly near the ground."""
        speeds = self._speeds()
        slow, fast = speeds.land_m_s, speeds.descend_m_s
        low, high = speeds.landing_slows_m
        share = min(max((z_m - self._home_local()[2] - low) / (high - low), 0.0), 1.0)
        up = self._control.axes[2]
        up.max_speed_m_s = min(max(slow + share * (fast - slow), 0.1), 10.0)
        up.goal_m = up.target_m - FAR_DOWN_M


def cos_tilt(attitude: Quaternion) -> float:
    """Cosine of the angle between the body's z axis and the vertical."""
    _, x, y, _ = attitude
    return 1.0 - 2.0 * (x * x + y * y)


class GroundContact:
    """Contact of one armed vehicle with the ground. Times are of the autopilot's clock."""

    def __init__(self) -> None:
        self.landed = True
        self.flies = False  # off the ground in the last step
        self.flown = False  # since it was armed
        self._armed_s = 0.0
        self._landed_s = 0.0
        self._still_since_s: float | None = None

    def arm(self, now_s: float) -> None:
        self._armed_s = now_s
        self.flown = False

    def update(self, on_ground: bool, low_thrust: bool, now_s: float) -> None:
        """To be called once per step while armed."""
        if not on_ground:
            self.flies, self.flown, self.landed, self._still_since_s = True, True, False, None
        elif self.landed:
            return
        elif not low_thrust:
            self.flies, self._still_since_s = True, None
        elif self._still_since_s is None:
            self.flies, self._still_since_s = False, now_s
        elif now_s - self._still_since_s >= LANDED_AFTER_S:
            self.landed, self._landed_s = True, now_s

    def idle_s(self, now_s: float) -> float:
        """Time on the ground since it landed, or since it was armed; 0 in the air."""
        if not self.landed:
            return 0.0
        return now_s - (self._landed_s if self.flown else self._armed_s)
