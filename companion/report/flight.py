"""A recorded flight as columns: what findings and figures use. All times are seconds since the first record of the flight.

Arrays of one vehicle have one row per record, in the order of time. NaN stands for a value that is not known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.config.fleet import FleetConfig
from companion.recording.alignment import FIRST_DATE_UNIX_S
from companion.types.flight import FLYING
from companion.types.notices import Code

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Words = NDArray[np.str_]
Anything = NDArray[Any]
FLYING_PHASES = tuple(str(phase) for phase in FLYING)


@dataclass(frozen=True, slots=True)
class NeighbourUse:
    """How one neighbour was used, per tick (n,): its weight w_ij and the age of its packet, NaN where it was not used."""

    weight: Floats
    age_s: Floats

    @property
    def used(self) -> Bools:
        return ~np.isnan(self.age_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class TickColumns:
    """The decisions of one vehicle, one row per tick; vectors are (n, 3)."""

    time_s: Floats
    phase: Words
    role: Words
    leader_id: Floats  # NaN without a leader
    prc: Floats
    position_enu_m: Floats
    velocity_enu_m_s: Floats
    slot_offset_enu_m: Floats
    reference_enu_m: Floats
    neighbours: Mapping[int, NeighbourUse]
    nearest_m: Floats
    required_m: Floats
    nearest: Words
    filter_changed_m_s2: Floats
    wind_acceleration_enu_m_s2: Floats
    battery_percent: Floats
    flags: Mapping[str, Bools]

    @property
    def located(self) -> Bools:
        """Whether there is a position."""
        return ~np.isnan(self.position_enu_m[:, 0])

    @property
    def flying(self) -> Bools:
        """By the phase of the agent."""
        return np.isin(self.phase, FLYING_PHASES)


@dataclass(frozen=True, slots=True)
class TickTiming:
    """Timing of the ticks (n,), milliseconds. `to_command_ms` is NaN in ticks without a setpoint."""

    time_s: Floats
    late_ms: Floats
    to_command_ms: Floats


@dataclass(frozen=True, slots=True)
class Statuses:
    """What the vehicle reported (n,), five times a second and with every event. `peers` has the fresh ones of each report."""

    time_s: Floats
    armed: Bools
    landed: Floats  # LandedState
    mode: Words
    error_horizontal_m: Floats
    peers: tuple[frozenset[int], ...]

    @property
    def in_air(self) -> Bools:
        return self.landed >= 2.0  # IN_AIR, TAKEOFF, LANDING


@dataclass(frozen=True, slots=True)
class FlightEvent:
    time_s: float
    code: Code
    text: str


@dataclass(frozen=True, slots=True)
class GivenCommand:
    """A command as the vehicle received it, with its answer. `answered_s` None: no answer is recorded."""

    time_s: float
    name: str
    number: int
    operator: str
    answered_s: float | None = None
    accepted: bool = False
    code: Code | None = None
    text: str = ""


@dataclass(frozen=True, slots=True)
class AgentStart:
    """One start of the agent. `problems`: one line for each file that could not be read to its end."""

    session: int
    software: str
    begins_s: float
    ends_s: float
    files: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class VehicleLog:
    """Everything recorded of one vehicle, in all starts of its agent."""

    vehicle_id: int
    starts: tuple[AgentStart, ...]
    ticks: TickColumns
    timing: TickTiming
    statuses: Statuses
    events: tuple[FlightEvent, ...] = ()
    commands: tuple[GivenCommand, ...] = ()
    aligned: bool = True  # whether its clock could be compared with those of the others

    def in_air(self) -> Bools:
        """Per tick: by the autopilot's landed state where it was reported, else by the phase of the agent."""
        if not self.statuses.time_s.size:
            return self.ticks.flying
        index = np.searchsorted(self.statuses.time_s, self.ticks.time_s, side="right") - 1
        return np.asarray(self.statuses.in_air[np.maximum(index, 0)], dtype=np.bool_)

    def in_air_at(self, time_s: Floats) -> Bools:
        """Whether it is in the air at these times (n,), by the newest tick before each; before the first one it is not.

        A vehicle whose records end in the air counts as in the air from then on: its agent may have died, not the vehicle.
        """
        row = np.searchsorted(self.ticks.time_s, time_s, side="right") - 1
        known = np.append(self.in_air(), False)  # row -1
        return np.asarray(known[row], dtype=np.bool_)


@dataclass(frozen=True, slots=True)
class FlightRecords:
    """A whole flight. `begin_unix_s` is the Unix time of 0 s, by the clock of the first vehicle.

    `fleet` is None where no recording has a usable fleet file. `problems`: files that could not be read at all.
    """

    fleet_name: str
    vehicles: tuple[VehicleLog, ...]
    begin_unix_s: float
    fleet: FleetConfig | None = None
    problems: tuple[str, ...] = ()

    @property
    def has_date(self) -> bool:
        """Not in virtual time, and not where the clock on board was never set."""
        return self.begin_unix_s >= FIRST_DATE_UNIX_S

    @property
    def ends_s(self) -> float:
        return max((start.ends_s for vehicle in self.vehicles for start in vehicle.starts), default=0.0)

    @property
    def ids(self) -> tuple[int, ...]:
        return tuple(vehicle.vehicle_id for vehicle in self.vehicles)

    @property
    def separation_m(self) -> float | None:
        return self.fleet.separation_m if self.fleet else None
