"""The state of a whole batch and its steps: the agents of one phase decide, then all bodies move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.stability.arrays import FloatArray
from sitl.autopilots.autopilot import DT_S
from sitl.batch.agents import Agents
from sitl.batch.autopilots import Autopilots
from sitl.batch.candidates import candidates_of
from sitl.batch.columns import BoolArray, Columns
from sitl.batch.laws import BatchLaws
from sitl.batch.references import References
from sitl.flight.files import ids_of
from sitl.flight.lockstep import TELEMETRY_STEPS
from sitl.flight.scenario import Scenario


@dataclass(frozen=True, slots=True)
class BatchStart:
    """True positions and velocities (B, n, 3) in ENU at t = 0; attitudes are level. `reference_s` is the RFT time then."""

    positions_enu_m: FloatArray
    velocities_enu_m_s: FloatArray
    reference_s: float = 0.0


def starts_at_rest(scenarios: Sequence[Scenario]) -> BatchStart:
    """Hover over `starts_enu_m` at take-off height."""
    starts = [[scenario.starts_enu_m[i] for i in ids_of(scenario)] for scenario in scenarios]
    positions = np.array(starts, dtype=np.float64)
    positions[:, :, 2] += np.array([[scenario.fleet.takeoff_height_m] for scenario in scenarios])
    return BatchStart(positions, np.zeros_like(positions))


class Simulation:
    """A batch in steps of DT_S. The agent of a vehicle decides in the steps of the vehicle's phase."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns, start: BatchStart) -> None:
        self._columns = columns
        self._steps = 0
        self._reference_s = start.reference_s
        laws = BatchLaws(scenarios, columns)
        self.slots_enu_m = laws.slots_by_vehicle_enu_m
        self.references = References(scenarios, columns, laws.is_leader)
        self._autopilots = Autopilots(
            scenarios,
            columns,
            columns.in_columns(start.positions_enu_m),
            columns.in_columns(start.velocities_enu_m_s),
        )
        all_columns = slice(0, columns.count)
        self._agents = Agents(
            scenarios,
            columns,
            laws,
            self.references,
            candidates_of(scenarios, columns),
            self._autopilots.telemetry(all_columns),
        )
        self._autopilots.begin(self._agents.targets(all_columns))

    @property
    def time_s(self) -> float:
        return self._steps * DT_S

    def step(self) -> None:
        """Run the agents whose telemetry is due in this step, then move all bodies."""
        tick, phase = divmod(self._steps, TELEMETRY_STEPS)
        group = self._columns.groups[phase]
        if group.stop > group.start:
            targets = self._agents.decide(
                tick, phase, self._reference_s + self.time_s, self._autopilots.telemetry(group)
            )
            self._autopilots.command(tick, group, targets)
        self._steps += 1
        self._autopilots.step(self._steps)

    def positions_enu_m(self) -> FloatArray:
        """True positions (B, n, 3)."""
        return self._columns.by_vehicle(self._autopilots.positions_enu_m)

    def neighbours(self) -> BoolArray:
        """Whether i uses j as a neighbour, [b, i, j] of (B, n, n)."""
        return self._agents.relation()
