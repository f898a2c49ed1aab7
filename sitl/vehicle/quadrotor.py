"""One stand-in vehicle: attitude loop, motors, rigid body, ground contact, and the autopilot's estimate."""

from __future__ import annotations

from math import cos, hypot, radians, sin
from random import Random

from companion.geometry.frames import (
    Quaternion,
    enu_from_geodetic,
    euler_from_quaternion,
    geodetic_from_enu,
    quaternion_from_euler,
)
from companion.geometry.vectors import minus, plus
from companion.types.values import GRAVITY_M_S2, ZERO3, Vector3
from sitl.vehicle.config import AutopilotFile
from sitl.vehicle.control import AttitudeControl, AttitudeSetpoint, Loops
from sitl.vehicle.disturbances import EstimatorError, Gusts
from sitl.vehicle.dynamics import THRUST, Body, State, at_rest, back, small_turn, turned

MOTORS_OFF = AttitudeSetpoint((1.0, 0.0, 0.0, 0.0), 0.0)
ESTIMATE_PERIOD_STEPS = 5  # the estimator's error changes at 50 Hz, the rate of an agent's ticks


def about_vertical(quaternion: Quaternion, angle_rad: float) -> Quaternion:
    """An attitude after a rotation about the vertical."""
    w, x, y, z = quaternion
    c, s = cos(0.5 * angle_rad), sin(0.5 * angle_rad)
    return (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)


class Quadrotor:
    """Truth and estimate, advanced in steps of `dt_s`. Random numbers depend on (seed, vehicle id) alone."""

    def __init__(self, file: AutopilotFile, loops: Loops, dt_s: float, hover_thrust_norm: float) -> None:
        airframe = file.stand_in.airframe
        # One random stream per subject: enabling gusts does not change the sensor noise.
        sensor_noise, gust_noise, origin_noise = (
            Random(f"{file.stand_in.seed} {file.id} {subject}") for subject in ("sensors", "gusts", "origin")
        )
        self._dt_s = dt_s
        self._ideal_attitude = airframe.attitude == "instant"
        self._body = Body(airframe.mass_kg, airframe.inertia_kg_m2, airframe.drag_n_per_m_s, airframe.motor_lag_s, dt_s)
        self._newton_per_thrust = airframe.mass_kg * GRAVITY_M_S2 / hover_thrust_norm
        yaw = quaternion_from_euler(0.0, 0.0, radians(file.start_yaw_deg))
        self.state = at_rest(file.start_enu_m, yaw)
        self._ground_z_m = file.start_enu_m[2]
        self.on_ground = True  # on the ground and not climbing
        self._tilted = self._level = (0.0, 0.0, 0.0, 0.0)  # what the ground levelled last, and made of it
        self._control = AttitudeControl(loops, airframe.inertia_kg_m2, MOTORS_OFF, dt_s)
        self._gusts = Gusts(file.stand_in.wind, gust_noise, dt_s)
        sensors = file.stand_in.sensor_model()
        self._error = EstimatorError(sensors, sensor_noise, dt_s * ESTIMATE_PERIOD_STEPS)
        self._steps = 0
        sd_x, sd_y, sd_z = sensors.position_sd_m
        self.reported_error_m = (hypot(sd_x, sd_y), sd_z)  # one sigma, in the plane and in height
        self.world_origin = file.world_origin.as_tuple()
        self._shift_m = ZERO3
        self.drift_m = self.drift_m_s = ZERO3  # of the estimate, by dead reckoning
        self.yaw_error_rad = 0.0  # of the estimate, by a wrong reference; the loops do not know it
        about = file.start_enu_m if file.origin_enu_m is None else file.origin_enu_m
        x, y, z = (a + origin_noise.gauss(0.0, sd) for a, sd in zip(about, sensors.origin_sd_m, strict=True))
        self.set_origin(geodetic_from_enu((x, y, z), self.world_origin))

    def reseed(self, seed: str) -> None:
        """Sensor errors and gusts go on from what they are, with the random numbers of this seed."""
        self._error.reseed(f"{seed} sensors")
        self._gusts.reseed(f"{seed} gusts")

    def set_origin(self, origin_deg_deg_m: Vector3) -> None:
        """Move the origin of the local frame (SET_GPS_GLOBAL_ORIGIN), rounded to the resolution of GPS_GLOBAL_ORIGIN."""
        latitude, longitude, altitude = origin_deg_deg_m
        self.origin = (round(latitude, 7), round(longitude, 7), round(altitude, 3))
        x, y, z = enu_from_geodetic(*self.origin, self.world_origin)
        sx, sy, sz = self._shift_m
        self._local_zero_enu_m = (x - sx, y - sy, z - sz)  # according to the estimate

    def name_origin(self, origin_deg_deg_m: Vector3) -> None:
        """The zero of the local frame is at this place from now on: local positions stay."""
        zero_enu_m, self._shift_m = self._local_zero_enu_m, ZERO3
        self.set_origin(origin_deg_deg_m)
        self._shift_m, self._local_zero_enu_m = minus(self._local_zero_enu_m, zero_enu_m), zero_enu_m

    def shift_estimate(self, shift_enu_m: Vector3) -> None:
        """An estimator reset: its position error grows by this vector."""
        (x, y, z), (a, b, c) = self._shift_m, shift_enu_m
        self._shift_m = (x + a, y + b, z + c)
        self.set_origin(self.origin)

    @property
    def thrust_norm(self) -> float:
        return self.state[THRUST] / self._newton_per_thrust

    @property
    def position_enu_m(self) -> Vector3:
        """True position in the world frame."""
        state = self.state
        return (state[0], state[1], state[2])

    @property
    def height_m(self) -> float:
        """True height above the ground."""
        return self.state[2] - self._ground_z_m

    @property
    def velocity_enu_m_s(self) -> Vector3:
        state = self.state
        return (state[3], state[4], state[5])

    @property
    def quaternion(self) -> Quaternion:
        """True attitude, FLU to ENU."""
        state = self.state
        return (state[6], state[7], state[8], state[9])

    @property
    def rates_rad_s(self) -> Vector3:
        state = self.state
        return (state[10], state[11], state[12])

    @property
    def specific_force_m_s2(self) -> Vector3:
        """Specific force as accelerometers measure it, FLU, without drag."""
        return (0.0, 0.0, GRAVITY_M_S2 if self.on_ground else self.state[THRUST] / self._body.mass_kg)

    def estimated_position_local_enu_m(self) -> Vector3:
        x, y, z = self.position_enu_m
        ex, ey, ez = self._error.position_m
        ox, oy, oz = self._local_zero_enu_m
        dx, dy, dz = self.drift_m
        return (x + ex - ox + dx, y + ey - oy + dy, z + ez - oz + dz)

    def aided_position_local_enu_m(self) -> Vector3:
        """The same without the noise of the sensors."""
        return plus(minus(self.position_enu_m, self._local_zero_enu_m), self.drift_m)

    def estimated_velocity_enu_m_s(self) -> Vector3:
        x, y, z = self.velocity_enu_m_s
        ex, ey, ez = self._error.velocity_m_s
        dx, dy, dz = self.drift_m_s
        return (x + ex + dx, y + ey + dy, z + ez + dz)

    def estimated_quaternion(self) -> Quaternion:
        """Estimated attitude, FLU to ENU; every loop of the autopilot uses it."""
        estimate = self.quaternion if self._error.quiet else turned(self.quaternion, self._error.turn)
        return about_vertical(estimate, self.yaw_error_rad) if self.yaw_error_rad else estimate

    def estimated_euler_rad(self) -> Vector3:
        """Roll, pitch, yaw of FLU in ENU."""
        return euler_from_quaternion(self.estimated_quaternion())

    def estimate(self) -> tuple[Vector3, Vector3, Vector3]:
        """Estimated position [m] and velocity [m/s] in the local ENU frame, and roll, pitch, yaw [rad]."""
        return self.estimated_position_local_enu_m(), self.estimated_velocity_enu_m_s(), self.estimated_euler_rad()

    def step(self, setpoint: AttitudeSetpoint) -> None:
        """Advance by dt_s under this setpoint."""
        state = before = self.state
        error, gusts = self._error, self._gusts
        wind_enu_m_s = gusts.mean_m_s if gusts.quiet else gusts.step()
        if self._ideal_attitude:
            state, moments_n_m = self._at_commanded_attitude(state, setpoint), ZERO3
        else:  # the loops know only the estimate
            _, _, _, _, _, _, w, x, y, z, p, q, r, _, _, _, _ = state
            measured = (w, x, y, z) if error.quiet else turned((w, x, y, z), error.turn)
            moments_n_m = self._control.moments_n_m(setpoint, measured, p, q, r)
        thrust_n = setpoint.thrust_norm * self._newton_per_thrust
        state = self._body.step(state, thrust_n, moments_n_m, wind_enu_m_s)
        self._steps += 1
        if self._steps % ESTIMATE_PERIOD_STEPS == 0:
            error.step()
        self.on_ground = state[2] <= self._ground_z_m and state[5] <= 0.0
        self.state = self._at_rest(state, before) if self.on_ground else state

    def _at_commanded_attitude(self, state: State, setpoint: AttitudeSetpoint) -> State:
        """The ideal of section 3.1: the estimated attitude equals the commanded one without delay."""
        rates = setpoint.rates_rad_s
        if rates is not None:
            p, q, r = rates
            turn = small_turn((p * self._dt_s, q * self._dt_s, r * self._dt_s))
            attitude = turned((state[6], state[7], state[8], state[9]), turn)
        elif self._error.quiet:
            attitude = setpoint.quaternion
        else:
            attitude = turned(setpoint.quaternion, back(self._error.turn))
        return (*state[:6], *attitude, 0.0, 0.0, 0.0, *state[THRUST:])

    def _at_rest(self, state: State, before: State) -> State:
        """Flat ground: it stops the fall, levels the vehicle, and holds one that was on the ground before against wind."""
        x, y, *_ = before if before[2] <= self._ground_z_m and before[5] <= 0.0 else state
        tilted = (state[6], state[7], state[8], state[9])
        if tilted != self._tilted:  # at rest it is the same in every step
            self._tilted, self._level = tilted, quaternion_from_euler(0.0, 0.0, euler_from_quaternion(tilted)[2])
        return (x, y, self._ground_z_m, 0.0, 0.0, 0.0, *self._level, 0.0, 0.0, 0.0, *state[THRUST:])
