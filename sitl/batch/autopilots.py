"""The stand-ins for many vehicles: delayed targets, attitude loops, bodies, wind, sensor errors and telemetry."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, floor, radians

import numpy as np

from companion.analysis.interaction import FloatArray
from sitl.autopilots.autopilot import DT_S
from sitl.autopilots.types import hover_thrust_norm
from sitl.batch.bodies import (
    ATTITUDE,
    POSITION,
    RATES,
    AttitudeLoops,
    Bodies,
    delay_steps,
    euler_rad,
    product,
    quaternion_of_turns,
)
from sitl.batch.columns import GUSTS, SENSORS, BatchGaussMarkov, Columns, Gaussians, IntArray
from sitl.flight.lockstep import TELEMETRY_STEPS
from sitl.flight.scenario import Scenario
from sitl.vehicle.config import Links, Sensors
from sitl.vehicle.quadrotor import ESTIMATE_PERIOD_STEPS


class Autopilots:
    """All stand-ins of a batch. Targets are (5, k): quaternion (FLU to ENU) and thrust in 0..1."""

    def __init__(
        self, scenarios: Sequence[Scenario], columns: Columns, position_enu_m: FloatArray, velocity_enu_m_s: FloatArray
    ) -> None:
        airframes = [scenario.stand_in.airframe for scenario in scenarios]
        self._bodies = Bodies(airframes, columns.formation)
        self._loops = AttitudeLoops(self._bodies.inertia_kg_m2)
        self._gusts = BatchGusts(scenarios, columns)
        self._state = self._bodies.hovering(position_enu_m, velocity_enu_m_s, self._gusts.mean_enu_m_s)
        hover_norm = columns.spread([hover_thrust_norm(scenario.stand_in) for scenario in scenarios])
        self._newton_per_thrust = self._bodies.hover_n / hover_norm
        self._instant = airframes[0].attitude == "instant"
        self._command = np.zeros((4, columns.count))
        self._goal = np.zeros((4, columns.count))
        self._errors = EstimatorErrors(scenarios, columns)
        self._turns = quaternion_of_turns(self._errors.attitude_rad)
        late = np.array([command_steps(scenario.links) for scenario in scenarios])[columns.formation]
        loops = 0 if self._instant else delay_steps(DT_S)
        self._thrusts = _TargetDelay(columns, late)
        self._attitudes = _TargetDelay(columns, late + loops)
        kept = int((late.max() + loops) // TELEMETRY_STEPS) + 2
        self._targets = np.empty((kept, 5, columns.count))

    @property
    def positions_enu_m(self) -> FloatArray:
        """Truth (3, B n)."""
        return self._state[POSITION]

    def begin(self, targets: FloatArray) -> None:
        """Set the targets (5, B n) that all vehicles follow until the first targets of the agents arrive."""
        self._targets[:] = targets
        self._goal[:] = targets[:4]
        np.multiply(targets[4], self._newton_per_thrust, out=self._command[0])

    def telemetry(self, group: slice) -> FloatArray:
        """Telemetry (9, G): position, velocity, roll, pitch, yaw."""
        telemetry = np.empty((9, group.stop - group.start))
        telemetry[:6] = self._state[:6, group]
        if self._errors.quiet:
            telemetry[6:9] = euler_rad(self._state[ATTITUDE, group])
            return telemetry
        telemetry[:3] += self._errors.position_m[:, group]
        telemetry[3:6] += self._errors.velocity_m_s[:, group]
        telemetry[6:9] = euler_rad(product(self._state[ATTITUDE, group], self._turns[:, group]))
        return telemetry

    def command(self, tick: int, group: slice, targets: FloatArray) -> None:
        """Send the targets of these vehicles' agents, decided in this tick."""
        self._targets[tick % len(self._targets), :, group] = targets

    def step(self, step: int) -> None:
        """Make the step of this number, counted from 1."""
        arrived, rows = self._thrusts.arriving(step, len(self._targets))
        self._command[0, arrived] = self._targets[rows, 4, arrived] * self._newton_per_thrust[arrived]
        arrived, rows = self._attitudes.arriving(step, len(self._targets))
        self._goal[:, arrived] = self._targets[rows, :4, arrived].T
        if self._instant:
            self._take_attitude()
        else:
            self._loops.moments(self._goal, self._estimated(), self._state[RATES], self._command[1:])
        self._bodies.step(self._state, self._command, self._gusts.step(), DT_S)
        if step % ESTIMATE_PERIOD_STEPS == 0 and not self._errors.quiet:
            self._errors.step()
            self._turns = quaternion_of_turns(self._errors.attitude_rad)

    def _estimated(self) -> FloatArray:
        """The autopilots' attitude estimates (4, B n), the input of every loop."""
        attitude = self._state[ATTITUDE]
        return attitude if self._errors.quiet else product(attitude, self._turns)

    def _take_attitude(self) -> None:
        """The ideal of section 3.1: the estimated attitude equals the commanded one at once."""
        self._state[ATTITUDE] = self._goal
        self._state[RATES] = 0.0
        if not self._errors.quiet:
            self._state[ATTITUDE] = product(self._goal, quaternion_of_turns(-self._errors.attitude_rad))


class _TargetDelay:
    """Steps in which targets reach their vehicles. `late_steps` (B n,) count from the sampling of the telemetry."""

    def __init__(self, columns: Columns, late_steps: IntArray) -> None:
        due = columns.phase_steps + late_steps
        self._columns = [np.flatnonzero(due % TELEMETRY_STEPS == phase) for phase in range(TELEMETRY_STEPS)]
        self._ticks_late = [due[own] // TELEMETRY_STEPS for own in self._columns]

    def arriving(self, step: int, kept: int) -> tuple[IntArray, IntArray]:
        """The columns that receive a target for this step, and the ticks, modulo `kept`, of these targets."""
        tick, phase = divmod(step, TELEMETRY_STEPS)
        return self._columns[phase], (tick - self._ticks_late[phase]) % kept


def command_steps(links: Links) -> int:
    """Steps from the sampling of telemetry to the first step under the target computed from it; exact."""
    arrives = (links.telemetry_delay_s + links.setpoint_delay_s) / DT_S
    return max(floor(links.telemetry_delay_s / DT_S + 1e-9) + 1, ceil(arrives - 1e-9))


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
        self.mean_enu_m_s = np.array([wind.mean_enu_m_s for wind in winds])[columns.formation].T.copy()
        self._wind = self.mean_enu_m_s.copy()
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
            np.add(self.mean_enu_m_s, self._gusts.value, out=self._wind)
        return self._wind
