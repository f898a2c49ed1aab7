"""Seeded random processes: the estimator's error against truth, and gusts."""

from __future__ import annotations

from math import exp, radians, sqrt
from random import Random

from companion.types.vectors import Vector3
from sitl.vehicle.config import Sensors, Wind


class GaussMarkov:
    """Noise of standard deviation `sd` and correlation time `time_s`; it starts in its stationary distribution."""

    def __init__(self, random: Random, sd: float, time_s: float, dt_s: float) -> None:
        self._gauss = random.gauss
        self._keep = exp(-dt_s / time_s)
        self._kick = sd * sqrt(1.0 - self._keep**2)
        self.value = random.gauss(0.0, sd)

    def step(self) -> float:
        self.value = value = self._keep * self.value + self._gauss(0.0, self._kick)
        return value


class EstimatorError:
    """Error of the autopilot's estimate, advanced every `dt_s`: position [m], velocity [m/s], attitude [rad]."""

    def __init__(self, sensors: Sensors, random: Random, dt_s: float) -> None:
        self._random = random
        self._white_m_s = sensors.velocity_white_sd_m_s
        self._attitude_rad = radians(sensors.attitude_sd_deg)
        self._position = [GaussMarkov(random, sd, sensors.position_time_s, dt_s) for sd in sensors.position_sd_m]
        self._velocity = [GaussMarkov(random, sensors.velocity_sd_m_s, sensors.velocity_time_s, dt_s) for _ in range(3)]
        self._attitude = [GaussMarkov(random, self._attitude_rad, sensors.velocity_time_s, dt_s) for _ in range(3)]
        self.quiet = sensors == Sensors(origin_sd_m=sensors.origin_sd_m)
        self.position_m: Vector3 = (0.0, 0.0, 0.0)
        self.velocity_m_s: Vector3 = (0.0, 0.0, 0.0)
        self.attitude_rad: Vector3 = (0.0, 0.0, 0.0)
        self.step()

    def step(self) -> None:
        if self.quiet:
            return
        white, white_m_s = self._random.gauss, self._white_m_s
        x, y, z = self._position
        self.position_m = (x.step(), y.step(), z.step())
        x, y, z = self._velocity
        self.velocity_m_s = (
            x.step() + white(0.0, white_m_s),
            y.step() + white(0.0, white_m_s),
            z.step() + white(0.0, white_m_s),
        )
        x, y, z = self._attitude
        self.attitude_rad = (x.step(), y.step(), z.step())


class Gusts:
    """Steady wind with first-order gusts, m/s in ENU."""

    def __init__(self, wind: Wind, random: Random, dt_s: float) -> None:
        self._mean = wind.mean_enu_m_s
        self._quiet = wind.gust_sd_m_s == 0.0
        self._gusts = [GaussMarkov(random, wind.gust_sd_m_s, wind.gust_time_s, dt_s) for _ in range(3)]

    def step(self) -> Vector3:
        if self._quiet:
            return self._mean
        x, y, z = (mean + gust.step() for mean, gust in zip(self._mean, self._gusts, strict=True))
        return (x, y, z)
