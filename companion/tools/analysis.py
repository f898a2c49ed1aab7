"""Analysis of a formation before its flight: fleet or scenario file -> figures. `companion analyze` prints them.

The figures are of the linear model (companion/analysis/prediction.py): no noise, no saturation.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from math import tau
from pathlib import Path
from typing import Any, get_args

import numpy as np
from msgspec import Struct, structs
from numpy.typing import NDArray

from companion.analysis.interaction import (
    Coupling,
    couple,
    eigenvalues,
    interaction_matrix,
    mode_eigenvalues,
    mode_figures,
    share_left,
    shift_m,
    time_to_shrink_s,
)
from companion.analysis.margins import delay_margin_with_lag_s, string_gains, worst_transient_peak
from companion.analysis.prediction import SETTLED_WITHIN_M, errors_over_time, settled_after_s, transient_peak
from companion.analysis.response import Graph, LinearModel, reached_from, settled_prcs
from companion.assembly import flyable_problems, law_of
from companion.config.file import SET, convert, kind_of_file, override, read_as
from companion.config.fleet import EdgeNeighbours, FleetConfig, LawName
from companion.config.fleet_check import fleet_problems
from companion.config.planned_flight import PlannedFlight, fleet_of, neighbour_graph, planned_problems, starts_of
from companion.config.reference import Reference
from companion.config.validation import Problem, each, unless_invalid
from companion.core.consensus.law import FormationLaw, Gains
from companion.types.flight import Role
from companion.types.values import ZERO3, Vector3

LAW_NAMES: tuple[LawName, ...] = get_args(LawName)
AVERAGE_LAWS: tuple[LawName, ...] = ("average_22", "average_26")
MODEL = LinearModel()
PREDICT_S = 120.0
WORST_START_UP_TO = 100  # vehicles; for more the worst start takes too long to compute
MORE = 0.1  # relative change of a gain that is tried
NOT_READ = ("origins_enu_m", "stand_in", "assumed", "targets", "links", "timeline", "agent_ends")
VELOCITY_ERROR_M_S = 0.1  # assumed error of an estimator's velocity against its own position
ERROR_TURNS_S = 30.0
STEP_M = 1.0  # step of the reference that is predicted for a fleet file, which has no start positions


class LawAnalysis(Struct, frozen=True, kw_only=True):
    """Figures of one law with the leaders of the fleet file. Distances are of pairs of neighbours.

    lambda_min, eigenvalues and G are of the interaction matrix. Rate, damping and delay_margin_s are of the modes without
    attitude lag, with feed-forward; all else is with lag and delay. String gains are None without a hop. For an unstable
    formation string gains, peaks, times and distances are None. A time is None also where the event does not occur.
    """

    gain_position_1_s2: float
    gain_velocity_1_s: float
    exponent: float
    weight_ratio: float
    feedforward: float
    stable: bool  # with attitude lag and the usual delay
    lambda_min: float
    eigenvalues: list[float]
    rate_1_s: float
    damping_min: float
    delay_margin_s: float
    delay_margin_with_lag_s: float
    delay_margin_more_velocity_gain_s: float  # the same with MORE gain on velocity, to see whether that helps
    string_gain_per_hop: float | None
    string_gain_per_hop_rad_s: float | None  # frequency of the largest gain per hop
    string_gain_to_last: float | None
    string_gain_to_last_rad_s: float | None
    velocity_error_shift_m: float  # from the slot, by a constant VELOCITY_ERROR_M_S that the correction does not see
    velocity_error_shift_corrected_m: float  # by one that turns once in ERROR_TURNS_S, with law.velocity_correction_1_s
    transient_peak: float | None  # largest error over the largest at the start
    worst_transient_peak: float | None  # largest peak from any start; None for more than WORST_START_UP_TO vehicles
    time_to_10_cm_s: float | None  # by the rate alone
    predicted_settle_s: float | None  # by the linear model with attitude lag and delay
    leader_settle_s: float | None  # likewise, of a leader without neighbours from the same largest error
    leader_step_settle_s: float | None  # likewise, from STEP_M
    predicted_max_distance_m: dict[str, float] | None
    predicted_min_distance_m: dict[str, float] | None
    stays_in_range: bool | None  # None: neighbours are given as edges
    # Range + hysteresis - the largest distance of any pair that are neighbours at the start
    margin_to_range_m: float | None
    G: list[list[float]]


class Analysis(Struct, frozen=True, kw_only=True):
    """Analysis of one file. `graph` is that at the start; `lambda_min_by_leader` is for each vehicle as the only leader.

    `converges`: every vehicle has a path to a leader, and the configured law is stable.
    """

    file: str
    settings: list[str]  # KEY=VALUE, in place of those of the file
    converges: bool
    vehicles: list[int]
    leaders: list[int]
    law: LawName
    start_error_m: float  # the largest of any vehicle at the start of the predictions
    reference_moves: bool  # in flight; in the predictions it is at rest at its start
    graph: dict[int, list[int]]
    laws: dict[LawName, LawAnalysis]
    hops: int  # hops to the vehicle farthest from a leader
    lambda_min_by_leader: dict[int, float]
    gain_on_average: dict[LawName, float]
    unreached: list[int]  # vehicles without a path to a leader
    not_read: list[str]  # sections and keys of the file that are not used


class _ScenarioPart(PlannedFlight, frozen=True, kw_only=True):
    """A scenario. The fields of type Any belong to the flight and are not read."""

    reference: Reference | None = None
    origins_enu_m: Any = None
    stand_in: Any = None
    assumed: Any = None
    targets: Any = None
    links: Any = None
    timeline: Any = None
    agent_ends: Any = None


class Subject(Struct, frozen=True, kw_only=True):
    """Input of the analysis: a fleet, its start positions and the position of its reference."""

    file: Path
    fleet: FleetConfig
    starts_enu_m: Mapping[int, Vector3]
    reference_enu_m: Vector3
    reference_moves: bool = False
    not_read: Sequence[str] = ()
    settings: Sequence[str] = ()


def load_subject(path: Path, overrides: Sequence[str] = ()) -> Subject:
    """The subject of a scenario file, or of a fleet file, with overrides "KEY.PATH=VALUE" (a YAML value).

    In a fleet file the vehicles start in formation, STEP_M behind the reference. Raises ConfigError.
    """
    data = read_as(path, "scenario", "fleet")
    subject = _subject(path, data)  # the file must be valid by itself, so that an error below is an override's
    if not overrides:
        return subject
    data = override(data, overrides, "fleet.law.name=average_22, or law.name=average_22 in a fleet file")
    return structs.replace(_subject(SET, data), file=path, settings=tuple(overrides))


def _subject(path: Path, data: Any) -> Subject:
    """`path` names the file in errors."""
    if kind_of_file(data) != "scenario" and not (isinstance(data, dict) and "fleet" in data):
        fleet = convert(path, data, FleetConfig, fleet_problems)
        starts = {member.id: member.slot_enu_m for member in fleet.vehicles}
        reference_enu_m, not_read = _a_step(fleet), _not_read(data, fleet, "")
        return Subject(file=path, fleet=fleet, starts_enu_m=starts, reference_enu_m=reference_enu_m, not_read=not_read)
    part = convert(path, data, _ScenarioPart, _problems)
    fleet = fleet_of(part.fleet)
    return Subject(
        file=path,
        fleet=fleet,
        starts_enu_m=_starts(part, fleet),
        reference_enu_m=part.reference.start_enu_m if part.reference else _a_step(fleet),
        reference_moves=part.reference is not None and part.reference.MOVES,
        not_read=_not_read(data, fleet, "fleet."),
    )


def _starts(part: _ScenarioPart, fleet: FleetConfig) -> Mapping[int, Vector3]:
    return starts_of(part, fleet, part.reference.start_enu_m if part.reference else ZERO3)


def _problems(part: _ScenarioPart) -> Iterator[Problem]:
    fleet = fleet_of(part.fleet)
    yield from planned_problems(part, fleet, unless_invalid(lambda: _starts(part, fleet)))
    if part.reference:
        yield from each(flyable_problems(fleet, part.reference))


def _not_read(data: Any, fleet: FleetConfig, where: str) -> list[str]:
    """Keys of the file that the analysis does not use; it keeps the heading of the start."""
    return [section for section in NOT_READ if section in data] + [f"{where}formation_heading"] * fleet.slots_turn


def _a_step(fleet: FleetConfig) -> Vector3:
    """Reference position STEP_M ahead of vehicles that took off at their slots."""
    return (STEP_M, 0.0, fleet.takeoff_height_m)


def analyse(subject: Subject) -> Analysis:
    """All figures of one subject. A formation that cannot converge is a result, not an error."""
    fleet = subject.fleet
    ids = sorted(member.id for member in fleet.vehicles)
    leaders = [member.id for member in fleet.vehicles if member.role is Role.LEADER]
    graph = neighbour_graph(fleet.neighbours, _flying_positions(subject))
    unreached = sorted(set(ids) - reached_from(graph, leaders))
    laws = {} if unreached else {name: _law_analysis(subject, graph, leaders, name) for name in LAW_NAMES}
    own = law_of(fleet.law)
    by_leader = {
        i: float(eigenvalues(interaction_matrix(graph, {i}, own))[0])
        for i in ids
        if len(reached_from(graph, {i})) == len(ids)
    }
    gain = {name: laws[fleet.law.name].lambda_min / laws[name].lambda_min for name in AVERAGE_LAWS if laws}
    return Analysis(
        file=str(subject.file),
        settings=list(subject.settings),
        converges=bool(laws) and laws[fleet.law.name].stable,
        vehicles=ids,
        leaders=leaders,
        law=fleet.law.name,
        start_error_m=float(np.linalg.norm(_start_errors_m(subject), axis=1).max()),
        reference_moves=subject.reference_moves,
        graph=graph,
        laws=laws,
        hops=0 if unreached else max(settled_prcs(graph, leaders).values()) - 1,
        lambda_min_by_leader=by_leader,
        gain_on_average=gain,
        unreached=unreached,
        not_read=list(subject.not_read),
    )


def _flying_positions(subject: Subject) -> dict[int, Vector3]:
    """Positions at the beginning of the formation: above the start positions."""
    return {i: (x, y, z + subject.fleet.takeoff_height_m) for i, (x, y, z) in subject.starts_enu_m.items()}


def _law_analysis(subject: Subject, graph: Graph, leaders: Collection[int], name: LawName) -> LawAnalysis:
    law = law_of(subject.fleet.law.with_name(name))
    coupling = couple(graph, leaders, law)
    spectrum = eigenvalues(coupling.G)
    modes = [mode_figures(law.gains, float(value)) for value in mode_eigenvalues(coupling)]
    rate_1_s = min(mode.rate_1_s for mode in modes)
    margin_s = delay_margin_with_lag_s(coupling, MODEL)
    stable = margin_s > MODEL.delay_s
    start_errors_m = _start_errors_m(subject)
    errors_m = errors_over_time(coupling, start_errors_m, MODEL, PREDICT_S) if stable else None
    distances_m = None if errors_m is None else _distances_m(subject.fleet, graph, errors_m)
    gains = string_gains(coupling, MODEL) if stable else None
    range_m = _margin_to_range_m(subject.fleet, distances_m) if distances_m else None
    start_error_m = float(np.linalg.norm(start_errors_m, axis=1).max())
    return LawAnalysis(
        gain_position_1_s2=law.gains.position_1_s2,
        gain_velocity_1_s=law.gains.velocity_1_s,
        exponent=law.weighting.exponent,
        weight_ratio=law.weighting.ratio,
        feedforward=law.feedforward,
        stable=stable,
        lambda_min=float(spectrum[0]),
        eigenvalues=spectrum.tolist(),
        rate_1_s=rate_1_s,
        damping_min=min(mode.damping for mode in modes),
        delay_margin_s=min(mode.delay_margin_s for mode in modes),
        delay_margin_with_lag_s=margin_s,
        delay_margin_more_velocity_gain_s=delay_margin_with_lag_s(_more_velocity_gain(coupling), MODEL),
        string_gain_per_hop=gains.per_hop if gains else None,
        string_gain_per_hop_rad_s=gains.per_hop_rad_s if gains else None,
        string_gain_to_last=gains.to_last if gains else None,
        string_gain_to_last_rad_s=gains.to_last_rad_s if gains else None,
        transient_peak=None if errors_m is None else transient_peak(errors_m),
        worst_transient_peak=_worst_transient_peak(coupling) if stable else None,
        time_to_10_cm_s=time_to_shrink_s(rate_1_s, start_error_m, SETTLED_WITHIN_M) if stable else None,
        predicted_settle_s=None if errors_m is None else settled_after_s(errors_m, SETTLED_WITHIN_M),
        leader_settle_s=_leader_settle_s(law, start_error_m) if stable else None,
        leader_step_settle_s=_leader_settle_s(law, STEP_M) if stable else None,
        velocity_error_shift_m=shift_m(law.gains, VELOCITY_ERROR_M_S),
        velocity_error_shift_corrected_m=shift_m(law.gains, VELOCITY_ERROR_M_S)
        * share_left(tau / ERROR_TURNS_S, subject.fleet.law.velocity_correction_1_s),
        predicted_max_distance_m=_extremes_m(distances_m, np.max),
        predicted_min_distance_m=_extremes_m(distances_m, np.min),
        stays_in_range=None if range_m is None else range_m >= 0.0,
        margin_to_range_m=range_m,
        G=coupling.G.tolist(),
    )


def _leader_settle_s(law: FormationLaw, start_error_m: float) -> float | None:
    alone = couple({1: []}, {1}, law)
    return settled_after_s(errors_over_time(alone, np.array([[start_error_m]]), MODEL, PREDICT_S), SETTLED_WITHIN_M)


def _more_velocity_gain(coupling: Coupling) -> Coupling:
    gains = coupling.law.gains
    more = Gains(gains.position_1_s2, gains.velocity_1_s * (1.0 + MORE))
    return replace(coupling, law=replace(coupling.law, gains=more))


def _worst_transient_peak(coupling: Coupling) -> float | None:
    return worst_transient_peak(coupling, MODEL) if len(coupling.G) <= WORST_START_UP_TO else None


def _start_errors_m(subject: Subject) -> NDArray[np.float64]:
    """e_i = x_i - r - d_i0 at the start (n, 3), in ascending order of the ids."""
    positions = _flying_positions(subject)
    slots = {member.id: member.slot_enu_m for member in subject.fleet.vehicles}
    rows = [np.subtract(np.subtract(positions[i], subject.reference_enu_m), slots[i]) for i in sorted(slots)]
    return np.array(rows, dtype=float)


def _distances_m(fleet: FleetConfig, graph: Graph, errors_m: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Distance of every pair of neighbours over time (ticks,)."""
    slots = {member.id: np.array(member.slot_enu_m) for member in fleet.vehicles}
    ids = sorted(slots)
    column = {vehicle_id: index for index, vehicle_id in enumerate(ids)}
    return {
        f"{i}-{j}": np.linalg.norm(errors_m[:, column[i]] - errors_m[:, column[j]] + slots[i] - slots[j], axis=1)
        for i in ids
        for j in sorted(graph[i])
        if i < j
    }


def _extremes_m(
    distances_m: Mapping[str, NDArray[np.float64]] | None, extreme: Callable[[NDArray[np.float64]], float]
) -> dict[str, float] | None:
    return None if distances_m is None else {pair: round(float(extreme(d)), 4) for pair, d in distances_m.items()}


def _margin_to_range_m(fleet: FleetConfig, distances_m: Mapping[str, NDArray[np.float64]]) -> float | None:
    """Range + hysteresis minus the largest distance of any pair of neighbours; None with edges."""
    if isinstance(fleet.neighbours, EdgeNeighbours):
        return None
    leave_m = fleet.neighbours.range_m + fleet.neighbours.hysteresis_m
    return leave_m - max(float(d.max()) for d in distances_m.values())
