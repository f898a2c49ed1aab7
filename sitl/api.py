"""Flights and analyses from Python, in a program or a notebook.

    from sitl.api import analyze, fly, fly_seeds, load

    flight = fly("platoon", law="average_22", seed=2, overrides={"links.peer_loss": 0.1})
    flight.positions_enu_m[:, 0]        # (T, 3) of the first vehicle
    flight.to_pandas()                  # needs pandas

What this module exports is stable: docs/python-api.md says what is promised. Errors are of `companion/types/errors.py`;
str() of one is what the command line prints.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from msgspec import to_builtins

from companion.analysis.interaction import FloatArray
from companion.config.file import ConfigError
from companion.config.named_files import read_named, with_overrides
from companion.config.new_formation import inline
from companion.config.shipped import scenario_file
from companion.tools.analysis import Analysis, LawAnalysis, analyse
from companion.tools.subject import subject_of
from companion.types.errors import UnusableError
from sitl.compare.command import compare as flown_comparison
from sitl.compare.options import DEFAULT_SEEDS, CompareOptions
from sitl.compare.statistics import CellSummary, Checked, Winner
from sitl.flight.flights import FlightEnd, check_convergence, reference_flown, result_of
from sitl.flight.scenario import Scenario, load_scenario, scenario_from, with_law
from sitl.flight.virtual_flight import Flown, fly_in_virtual_time
from sitl.report.metrics import distances_m, errors_m, pair_name, pairs_of, reference_positions_m
from sitl.report.progress import FlightProgress, ShareProgress
from sitl.report.summary import ReportedEvent, RunSummary
from sitl.workers import LocalWorkers, all_results

if TYPE_CHECKING:
    from pandas import DataFrame

__all__ = [
    "Analysis",
    "FlightData",
    "LawAnalysis",
    "LawComparison",
    "ReportedEvent",
    "RunSummary",
    "Scenario",
    "analyze",
    "compare",
    "fly",
    "fly_seeds",
    "load",
]

Source = str | Path | Scenario
"""The name of a shipped scenario, the path of a file, or what `load` returned."""
Overrides = Mapping[str, object]
"""Values by key, as of `--set`: {"stand_in.sensors": "default", "timeline[3].for_s": 20}."""
NOTHING: Overrides = {}
NOTHING_VARIED: Mapping[str, Iterable[object]] = {}
EXAMPLE = "fleet.takeoff_height_m=3.0 or timeline[3].for_s=20"


@dataclass(frozen=True, slots=True, eq=False)
class FlightData:
    """One flight in virtual time. T sample times, N vehicles, P pairs of vehicles; metres, seconds and radians in ENU.

    scenario: as flown
    vehicles: ids of the vehicles (N), rising: the order of the axis N
    pairs: ids of each pair (P): the order of the axis P
    time_s: (T,) since the start of the flight, 50 each second
    positions_enu_m: (T, N, 3) true positions
    velocities_enu_m_s: (T, N, 3) true velocities
    setpoints: (T, N, 4) commanded roll, pitch, yaw [rad] and thrust [0 to 1]; NaN where the agent commands none
    errors_m: (T, N) distance of each vehicle to its slot about the reference; NaN out of formation
    distances_m: (T, P) distance of the two vehicles of each pair
    events: what the vehicles reported, in the order of time
    summary: the figures of `summary.json`; `summary.failure` is None for a flight without one
    """

    scenario: Scenario
    vehicles: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]
    time_s: FloatArray
    positions_enu_m: FloatArray
    velocities_enu_m_s: FloatArray
    setpoints: FloatArray
    errors_m: FloatArray
    distances_m: FloatArray
    events: tuple[ReportedEvent, ...]
    summary: RunSummary

    def to_pandas(self) -> DataFrame:
        """A row for each time and vehicle. Raises UnusableError where pandas is not installed."""
        pandas = _pandas()
        count = len(self.vehicles)
        columns = {"time_s": np.repeat(self.time_s, count), "vehicle": np.tile(self.vehicles, self.time_s.size)}
        for values, names in (
            (self.positions_enu_m, ("x_m", "y_m", "z_m")),
            (self.velocities_enu_m_s, ("vx_m_s", "vy_m_s", "vz_m_s")),
            (self.setpoints, ("roll_rad", "pitch_rad", "yaw_rad", "thrust_norm")),
            (self.errors_m[:, :, None], ("error_m",)),
        ):
            columns |= {name: values[:, :, index].ravel() for index, name in enumerate(names)}
        return pandas.DataFrame(columns)

    def distances_to_pandas(self) -> DataFrame:
        """A row for each time, by `time_s`, and a column "1-2" for each pair. Raises UnusableError as `to_pandas`."""
        pandas = _pandas()
        times = pandas.Index(self.time_s, name="time_s")
        return pandas.DataFrame(self.distances_m, index=times, columns=[pair_name(pair) for pair in self.pairs])


@dataclass(frozen=True, slots=True, eq=False)
class LawComparison:
    """What `sitl compare` gives. docs/statistics.md defines the figures.

    flights: a mapping for each flight, with the columns of `compare.csv`
    cells: medians with intervals of each law in each place
    winners: the best law in each place by each figure
    checks: figures of flights that the agents flew as well
    """

    flights: tuple[dict[str, Any], ...]
    cells: tuple[CellSummary, ...]
    winners: tuple[Winner, ...]
    checks: tuple[Checked, ...]

    def to_pandas(self) -> DataFrame:
        """A row for each flight. Raises UnusableError where pandas is not installed."""
        return _pandas().DataFrame(list(self.flights))


def load(scenario: Source, overrides: Overrides = NOTHING, law: str | None = None) -> Scenario:
    """A scenario under another law, then with other values, checked as a whole. Raises ConfigError."""
    file = None if isinstance(scenario, Scenario) else scenario_file(Path(scenario))
    found = load_scenario(file) if file else cast(Scenario, scenario)
    if law is not None:
        try:
            found = with_law(found, law)
        except ConfigError as error:
            raise ConfigError.of([ConfigError("law", "", line) for line in error.lines]) from error
    elif not overrides:
        return found
    lines = [f"{key}={inline(_plain(value))}" for key, value in overrides.items()]
    data = with_overrides(_plain(to_builtins(found)), lines, EXAMPLE)
    return scenario_from(Path(_name(scenario)), read_named(data, file) if file else data)


def fly(
    scenario: Source,
    *,
    law: str | None = None,
    seed: int | None = None,
    overrides: Overrides = NOTHING,
    anyway: bool = False,
) -> FlightData:
    """Fly a scenario in virtual time, as `sitl run` does: the same scenario and seed give the same flight to the last bit.

    A flight that fails is a result with `summary.failure`. Raises ConfigError, and for a formation that cannot converge
    DivergesError; `anyway` flies it.
    """
    seeded = overrides if seed is None else {**overrides, "stand_in.seed": seed}
    found = load(scenario, seeded, law)
    if not anyway:
        check_convergence(found)
    return _fly(_Job(found, _name(scenario)))


def fly_seeds(
    scenario: Source,
    seeds: Iterable[int],
    *,
    law: str | None = None,
    overrides: Overrides = NOTHING,
    anyway: bool = False,
    processes: int | None = None,
    quiet: bool = False,
) -> list[FlightData]:
    """`fly` with each of the seeds, in their order, on all cores or in so many processes. Progress is a line on standard error.

    The processes are spawned: a program, not a notebook, needs `if __name__ == "__main__":` around its calls.
    """
    found = load(scenario, overrides, law)
    if not anyway:
        check_convergence(found)
    jobs = [_Job(load(found, {"stand_in.seed": seed}), _name(scenario)) for seed in seeds]
    with ShareProgress(quiet) as shown:
        shown.begin(f"{_name(scenario)}, {len(jobs)} flights")
        return all_results(LocalWorkers(processes), _fly, jobs, shown.show)


def analyze(scenario: Source, overrides: Overrides = NOTHING, law: str | None = None) -> Analysis:
    """What `companion analyze --json` computes of a formation: convergence, margins, distances. Raises ConfigError."""
    return analyse(subject_of(Path(_name(scenario)), to_builtins(load(scenario, overrides, law))))


def compare(
    laws: Iterable[str] = (),
    *,
    scenario: str | Path | None = None,
    graphs: Iterable[str] = (),
    conditions: Iterable[str] = (),
    vehicles: Iterable[int] = (),
    vary: Mapping[str, Iterable[object]] = NOTHING_VARIED,
    overrides: Overrides = NOTHING,
    seeds: int = DEFAULT_SEEDS,
    seconds: float | None = None,
    lockstep: int = 0,
    processes: int | None = None,
    quiet: bool = False,
) -> LawComparison:
    """Fly what `sitl compare` flies with these options, on all cores or in so many processes. Raises ConfigError.

    The processes are spawned, as those of `fly_seeds`.
    """
    options = CompareOptions(
        scenario=None if scenario is None else Path(scenario),
        laws=tuple(laws),
        graphs=tuple(graphs),
        conditions=tuple(conditions),
        vehicles=tuple(vehicles),
        varied=[f"{key}={','.join(inline(_plain(value)) for value in values)}" for key, values in vary.items()],
        overrides=[f"{key}={inline(_plain(value))}" for key, value in overrides.items()],
        seeds=seeds,
        seconds=seconds,
        lockstep=lockstep,
        processes=processes,
        quiet=quiet,
    )
    flights, result = flown_comparison(options)
    return LawComparison(tuple(flights), tuple(result.cells), tuple(result.winners), tuple(result.checks))


class _Job(NamedTuple):
    """A flight for one of the processes."""

    scenario: Scenario
    name: str


def _fly(job: _Job) -> FlightData:
    scenario = job.scenario
    flown = fly_in_virtual_time(scenario, FlightProgress(job.name, quiet=True, began_s=0.0))
    tracks, stand_ins = flown.tracks(), sorted(flown.stand_ins, key=lambda stand_in: stand_in.vehicle_id)
    end = FlightEnd(failure=flown.failure, flight_s=flown.flight_s)
    summary = result_of(scenario, job.name, flown.watch, tracks, end).summary
    time_s, pairs = stand_ins[0].track().time_s, pairs_of(tracks)
    apart = [distances_m(tracks, pair, time_s) for pair in pairs]
    return FlightData(
        scenario=scenario,
        vehicles=tuple(stand_in.vehicle_id for stand_in in stand_ins),
        pairs=tuple(pairs),
        time_s=time_s,
        positions_enu_m=np.stack([stand_in.track().position_enu_m for stand_in in stand_ins], axis=1),
        velocities_enu_m_s=np.stack([stand_in.velocities_enu_m_s() for stand_in in stand_ins], axis=1),
        setpoints=np.stack([stand_in.setpoints() for stand_in in stand_ins], axis=1),
        errors_m=_errors_m(scenario, flown, time_s),
        distances_m=np.stack(apart, axis=1) if apart else np.empty((time_s.size, 0)),
        events=tuple(flown.watch.events),
        summary=summary,
    )


def _errors_m(scenario: Scenario, flown: Flown, time_s: FloatArray) -> FloatArray:
    """In all formations of the flight."""
    tracks, watch = flown.tracks(), flown.watch
    found = np.full((time_s.size, len(tracks)), np.nan)
    slots, reference = watch.slots(), reference_flown(scenario, watch)
    for formation in watch.formations:
        inside = (time_s >= formation.start_s) & (time_s <= formation.end_s)
        times_s = time_s[inside]
        if times_s.size:
            reference_enu_m = reference_positions_m(reference, formation.reference_start_s, times_s)
            for index, i in enumerate(sorted(tracks)):
                found[inside, index] = errors_m(tracks[i], slots[i], reference_enu_m, times_s)
    return found


def _name(scenario: Source) -> str:
    return scenario.fleet.name if isinstance(scenario, Scenario) else Path(scenario).stem


def _plain(value: object) -> object:
    """Numbers and arrays of numpy as those of Python, also inside of lists and mappings."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _pandas() -> Any:
    try:
        import pandas
    except ImportError as error:
        raise UnusableError("to_pandas: pandas is not installed; pip install pandas") from error
    return pandas
