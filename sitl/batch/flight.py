"""Flight of B formations of n vehicles at once.

The model is that of lockstep: the same bodies, loops, delays, law, separation filter and output limits, 250 physics steps per
second, and one tick of every agent in each telemetry period, at the phase of that vehicle. It starts in formation: the vehicles
hover over their starts, have fresh packets and settled PrCs, and fly the law from t = 0.

`LEFT_OUT` says what it leaves out. Delays are exact to the step. Random numbers differ from those of lockstep but have the
same distributions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from companion.analysis.interaction import FloatArray
from sitl.autopilots.autopilot import DT_S
from sitl.batch.agents import Agents
from sitl.batch.autopilots import Autopilots
from sitl.batch.columns import BoolArray, Columns, columns_of
from sitl.batch.laws import BatchLaws
from sitl.batch.packets import candidates_of
from sitl.batch.references import References
from sitl.flight.files import ids_of
from sitl.flight.lockstep import TELEMETRY_STEPS
from sitl.flight.scenario import Scenario

# What differs from a flight of the agents, for readers of its figures.
LEFT_OUT = (
    "It begins in formation, in a hover with known mean wind and hover thrust: no take-off, no paths into the slots, no"
    " landing.",
    "Leader, slots and reference stay as they are; the formation does not turn.",
    "No failsafe acts, and no state of a peer is refused as implausible.",
    "All vehicles receive all others at 50 Hz (peers.full_rate_up_to); a vehicle that loses the range to all neighbours gets no"
    " other one instead.",
    "The separation filter does not keep off a vehicle that was not heard for peers.max_age_s, nor traffic.",
    "Yaw stays as it was.",
    "A formation whose law fails is given up as a whole; in flight the agent of that vehicle alone ends, by a hand-over.",
)
PROGRESS_EVERY_S = 1.0  # of virtual time


@dataclass(frozen=True, slots=True)
class BatchFlight:
    """True tracks of B formations of n vehicles, in rising order of their ids.

    `times_s` (ticks,) starts at 0 with the law; `positions_enu_m` (ticks, B, n, 3) is float32; `slots_enu_m` is (B, n, 3).
    `reference_enu_m` is r, (ticks, 3) where all formations have the same and (ticks, B, 3) otherwise. `neighbours`
    (ticks, B, n, n) is whether i uses j as a neighbour, None unless requested. `commanded_m_s2` (ticks, B, n) is the size of
    the acceleration that the last attitude and thrust command, float32.
    `failures`: why a formation ended, by its index; its positions are NaN from then on. `remarks`: why the law
    of a formation was not asked about in arrays, by its index.
    """

    times_s: FloatArray
    positions_enu_m: NDArray[np.float32]
    slots_enu_m: FloatArray
    reference_enu_m: FloatArray
    neighbours: BoolArray | None
    commanded_m_s2: NDArray[np.float32]
    failures: Mapping[int, str] = field(default_factory=dict)
    remarks: Mapping[int, str] = field(default_factory=dict)

    def reference_of_formations_enu_m(self) -> FloatArray:
        """r as (ticks, B or 1, 3)."""
        return self.reference_enu_m if self.reference_enu_m.ndim == 3 else self.reference_enu_m[:, None, :]

    def errors_m(self) -> FloatArray:
        """Distance (ticks, B, n) of each vehicle to its slot r + d_i0."""
        reference = self.reference_of_formations_enu_m()
        squares = np.zeros(self.positions_enu_m.shape[:3])
        for axis in range(3):
            off = self.positions_enu_m[..., axis] - reference[:, :, None, axis]
            off -= self.slots_enu_m[None, :, :, axis]
            squares += np.square(off, out=off)
        return np.asarray(np.sqrt(squares, out=squares))


def fly_batch(
    scenarios: Sequence[Scenario],
    duration_s: float,
    progress: Callable[[float], None] | None = None,
    *,
    sample_s: float = 0.02,
    keep_neighbours: bool = False,
    start: BatchStart | None = None,
) -> BatchFlight:
    """Fly these scenarios at once for `duration_s`. Calls `progress` with the seconds flown, about once per virtual second.

    Without `start` the vehicles hover at rest over `starts_enu_m` at take-off height. Timelines are ignored. Raises ValueError
    where the scenarios cannot be flown in one batch.
    """
    stride = round(sample_s / DT_S)
    if stride < 1 or abs(stride * DT_S - sample_s) > 1e-9:
        raise ValueError(f"sample_s is {sample_s:g}; it must be a multiple of {DT_S:g} s")
    columns = columns_of(scenarios)
    begin = start or starts_at_rest(scenarios)
    simulation = Simulation(scenarios, columns, begin)
    samples = round(duration_s / DT_S) // stride + 1
    n = columns.vehicles
    positions = np.empty((samples, columns.formations, n, 3), dtype=np.float32)
    commanded = np.empty((samples, columns.formations, n), dtype=np.float32)
    neighbours = np.zeros((samples, columns.formations, n, n), dtype=np.bool_) if keep_neighbours else None
    reported_s, failures = 0.0, dict[int, str]()
    for sample in range(samples):
        if sample:
            for _ in range(stride):
                simulation.step()
        positions[sample] = simulation.positions_enu_m()
        commanded[sample] = simulation.commanded_m_s2()
        for formation, text in simulation.laws.failures.items():
            failures.setdefault(formation, f"ended after {simulation.time_s:.2f} s: {text}")
            positions[sample, formation] = np.nan
        if neighbours is not None:
            neighbours[sample] = simulation.neighbours()
        if progress and simulation.time_s >= reported_s + PROGRESS_EVERY_S:
            reported_s = simulation.time_s
            progress(reported_s)
    times_s = np.arange(samples, dtype=np.float64) * (stride * DT_S)
    return BatchFlight(
        times_s=times_s,
        positions_enu_m=positions,
        slots_enu_m=simulation.slots_enu_m,
        reference_enu_m=simulation.references.positions_enu_m(begin.reference_s + times_s),
        neighbours=neighbours,
        commanded_m_s2=commanded,
        failures=failures,
        remarks=simulation.laws.remarks,
    )


@dataclass(frozen=True, slots=True)
class BatchStart:
    """True positions and velocities (B, n, 3) in ENU at t = 0; `reference_s` is the RFT time then.

    Attitudes are those of a hover in the mean wind, which the disturbance observers know.
    """

    positions_enu_m: FloatArray
    velocities_enu_m_s: FloatArray
    reference_s: float = 0.0


def starts_at_rest(scenarios: Sequence[Scenario]) -> BatchStart:
    """Hover over `starts_enu_m` at take-off height."""
    starts = [[scenario.starts_enu_m[i] for i in ids_of(scenario)] for scenario in scenarios]
    positions = np.array(starts, dtype=np.float64)
    positions[:, :, 2] += np.array([[scenario.fleet.takeoff_height_m] for scenario in scenarios])
    return BatchStart(positions, np.zeros_like(positions))


def slots_by_vehicle_enu_m(scenarios: Sequence[Scenario]) -> FloatArray:
    """Slots (B, n, 3) by rising ids."""
    members = [sorted(scenario.fleet.vehicles, key=lambda member: member.id) for scenario in scenarios]
    return np.array([[member.slot_enu_m for member in row] for row in members], dtype=np.float64)


class Simulation:
    """A batch in steps of DT_S. The agent of a vehicle decides in the steps of the vehicle's phase."""

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns, start: BatchStart) -> None:
        self._columns = columns
        self._steps = 0
        self._reference_s = start.reference_s
        self.slots_enu_m = slots_by_vehicle_enu_m(scenarios)
        slot_enu_m = columns.in_columns(self.slots_enu_m)
        self.laws = BatchLaws(scenarios, columns, slot_enu_m)
        self.references = References(scenarios, columns, self.laws.is_leader)
        self._autopilots = Autopilots(
            scenarios, columns, columns.in_columns(start.positions_enu_m), columns.in_columns(start.velocities_enu_m_s)
        )
        all_columns = slice(0, columns.count)
        candidates, telemetry = candidates_of(scenarios, columns), self._autopilots.telemetry(all_columns)
        self._agents = Agents(scenarios, columns, self.laws, slot_enu_m, self.references, candidates, telemetry)
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

    def commanded_m_s2(self) -> FloatArray:
        """Sizes of the commanded accelerations (B, n)."""
        return self._columns.by_vehicle(self._agents.commanded_m_s2()[None])[:, :, 0]

    def neighbours(self) -> BoolArray:
        """Whether i uses j as a neighbour, [b, i, j] of (B, n, n)."""
        return self._agents.relation()
