"""Seeded random processes: the estimator's error against truth, and gusts."""

from __future__ import annotations

from math import cos, exp, log, radians, sin, sqrt, tau
from random import Random

from companion.types.values import ZERO3, Vector3
from sitl.vehicle.config import Sensors, Wind
from sitl.vehicle.dynamics import NO_TURN, small_turn


class Normals:
    """Standard normal numbers: those of `random.gauss(0.0, 1.0)`, of which one call takes as long as three here."""

    def __init__(self, random: Random) -> None:
        self._random, self._uniform = random, random.random
        self._left: list[float] = []  # they are made in pairs

    def reseed(self, seed: str) -> None:
        """From now on the numbers are those of this seed."""
        self._random.seed(seed)
        self._left = []

    def take(self, count: int) -> list[float]:
        """The next `count` numbers."""
        uniform, numbers = self._uniform, self._left
        while len(numbers) < count:
            angle_rad, radius = uniform() * tau, sqrt(-2.0 * log(1.0 - uniform()))
            numbers += (cos(angle_rad) * radius, sin(angle_rad) * radius)
        self._left = numbers[count:]
        return numbers[:count]


class GaussMarkov:
    """Noise of three numbers with standard deviations `sd` and one correlation time, from its stationary distribution on."""

    def __init__(self, normals: Normals, sd: Vector3, time_s: float, dt_s: float) -> None:
        self._keep = exp(-dt_s / time_s)
        of_sd = sqrt(1.0 - self._keep**2)
        sd_x, sd_y, sd_z = sd
        self._kicks = (sd_x * of_sd, sd_y * of_sd, sd_z * of_sd)
        x, y, z = normals.take(3)
        self.value: Vector3 = (sd_x * x, sd_y * y, sd_z * z)

    def step(self, normal_x: float, normal_y: float, normal_z: float) -> Vector3:
        """The value one step later, with three new standard normal numbers."""
        (x, y, z), (kick_x, kick_y, kick_z), keep = self.value, self._kicks, self._keep
        self.value = (keep * x + kick_x * normal_x, keep * y + kick_y * normal_y, keep * z + kick_z * normal_z)
        return self.value


class EstimatorError:
    """Error of the autopilot's estimate, advanced every `dt_s`: position [m], velocity [m/s], attitude [rad]."""

    def __init__(self, sensors: Sensors, random: Random, dt_s: float) -> None:
        self._normals = Normals(random)
        self._white_m_s = sensors.velocity_white_sd_m_s
        of_velocity, of_attitude = (sensors.velocity_sd_m_s,) * 3, (radians(sensors.attitude_sd_deg),) * 3
        self._position = GaussMarkov(self._normals, sensors.position_sd_m, sensors.position_time_s, dt_s)
        self._velocity = GaussMarkov(self._normals, of_velocity, sensors.velocity_time_s, dt_s)
        self._attitude = GaussMarkov(self._normals, of_attitude, sensors.velocity_time_s, dt_s)
        self.quiet = sensors == Sensors(origin_sd_m=sensors.origin_sd_m)
        self.position_m = self.velocity_m_s = ZERO3
        self.turn = NO_TURN  # from the true attitude to the estimated one
        self.step()

    def reseed(self, seed: str) -> None:
        """The errors go on from what they are, with the random numbers of this seed."""
        self._normals.reseed(seed)

    def step(self) -> None:
        if self.quiet:
            return
        px, py, pz, vx, white_x, vy, white_y, vz, white_z, ax, ay, az = self._normals.take(12)
        white_m_s = self._white_m_s
        self.position_m = self._position.step(px, py, pz)
        x, y, z = self._velocity.step(vx, vy, vz)
        self.velocity_m_s = (x + white_m_s * white_x, y + white_m_s * white_y, z + white_m_s * white_z)
        self.turn = small_turn(self._attitude.step(ax, ay, az))


class Gusts:
    """Steady wind with first-order gusts, m/s in ENU."""

    def __init__(self, wind: Wind, random: Random, dt_s: float) -> None:
        self.mean_m_s = wind.mean_enu_m_s
        self.quiet = wind.gust_sd_m_s == 0.0  # the mean alone
        self._normals = Normals(random)
        self._gusts = GaussMarkov(self._normals, (wind.gust_sd_m_s,) * 3, wind.gust_time_s, dt_s)

    def reseed(self, seed: str) -> None:
        """The gusts go on from what they are, with the random numbers of this seed."""
        self._normals.reseed(seed)

    def step(self) -> Vector3:
        if self.quiet:
            return self.mean_m_s
        (x, y, z), (gust_x, gust_y, gust_z) = self.mean_m_s, self._gusts.step(*self._normals.take(3))
        return (x + gust_x, y + gust_y, z + gust_z)
