"""sitl.vehicle.disturbances for many vehicles: estimator errors relative to truth, and gusts."""

from __future__ import annotations

from collections.abc import Sequence
from math import radians

import numpy as np

from companion.stability.arrays import FloatArray
from sitl.autopilots.autopilot import DT_S
from sitl.batch.columns import Columns
from sitl.batch.noise import GUSTS, SENSORS, BatchGaussMarkov, Gaussians
from sitl.flight.scenario import Scenario
from sitl.vehicle.config import Sensors
from sitl.vehicle.quadrotor import ESTIMATE_PERIOD_STEPS

BLOCK_S = 1.0  # duration for which random numbers are drawn at once


class EstimatorErrors:
    """`position_m`, `velocity_m_s` and `attitude_rad` (small angles about the body axes) are (3, B n).

    Call `step` every ESTIMATE_PERIOD_STEPS. Errors of the origins are left out, because agents correct for them.
    """

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns) -> None:
        sensors = [scenario.stand_in.sensor_model() for scenario in scenarios]
        quiet = [model == Sensors(origin_sd_m=model.origin_sd_m) for model in sensors]
        self.quiet = all(quiet)
        self.position_m = self.velocity_m_s = self.attitude_rad = np.zeros((3, columns.count))
        if self.quiet:
            return
        period_s = ESTIMATE_PERIOD_STEPS * DT_S
        seeds = [scenario.stand_in.seed for scenario in scenarios]
        self._gaussians = Gaussians(seeds, quiet, SENSORS, columns, 12, round(BLOCK_S / period_s))
        sd = np.array(
            [[*m.position_sd_m, *[m.velocity_sd_m_s] * 3, *[radians(m.attitude_sd_deg)] * 3] for m in sensors]
        )
        time_s = np.array([[m.position_time_s] * 3 + [m.velocity_time_s] * 6 for m in sensors])
        first = self._gaussians.next()[:9]
        self._drifts = BatchGaussMarkov(sd[columns.formation].T, time_s[columns.formation].T, period_s, first)
        self._white_m_s = columns.spread([m.velocity_white_sd_m_s for m in sensors])
        self.step()

    def step(self) -> None:
        if self.quiet:
            return
        gaussian = self._gaussians.next()
        self._drifts.step(gaussian[:9])
        drifts = self._drifts.value
        self.position_m, self.attitude_rad = drifts[:3], drifts[6:9]
        self.velocity_m_s = drifts[3:6] + gaussian[9:12] * self._white_m_s


class BatchGusts:
    """Steady wind with first-order gusts [m/s] in ENU, (3, B n)."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns) -> None:
        winds = [scenario.stand_in.wind for scenario in scenarios]
        quiet = [wind.gust_sd_m_s == 0.0 for wind in winds]
        self._mean = np.array([wind.mean_enu_m_s for wind in winds])[columns.formation].T.copy()
        self._wind = self._mean.copy()
        self._quiet = all(quiet)
        if self._quiet:
            return
        seeds = [scenario.stand_in.seed for scenario in scenarios]
        self._gaussians = Gaussians(seeds, quiet, GUSTS, columns, 3, round(BLOCK_S / DT_S))
        sd = columns.spread([wind.gust_sd_m_s for wind in winds])
        time_s = columns.spread([wind.gust_time_s for wind in winds])
        self._gusts = BatchGaussMarkov(sd, time_s, DT_S, self._gaussians.next())

    def step(self) -> FloatArray:
        """The wind (3, B n) of the next physics step."""
        if not self._quiet:
            self._gusts.step(self._gaussians.next())
            np.add(self._mean, self._gusts.value, out=self._wind)
        return self._wind
