"""Analysis of a formation before its flight: fleet or scenario file -> figures. `companion analyze` prints them.

The figures are of the linear model (companion/analysis/response.py): no noise, no saturation, and of the separation filter
the distance alone that it keeps. What it predicts is what `sitl run` flies with ideal sensors; tests/bench/verdicts.py
compares the two.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from itertools import combinations
from math import dist, sqrt, tau
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from companion.analysis.interaction import (
    Coupling,
    couple,
    share_left,
    shift_m,
    time_to_shrink_s,
)
from companion.analysis.margins import (
    IDEAL,
    StringGains,
    are_stable,
    delay_margin_with_lag_s,
    least_delay_margin_s,
    string_gains,
)
from companion.analysis.prediction import (
    SETTLED_WITHIN_M,
    errors_over_time,
    paths_into_slots,
    settled_after_s,
    transient_peak,
    worst_transient_peak,
)
from companion.analysis.response import (
    ATTITUDE_LOOPS,
    Graph,
    LinearModel,
    flown_graphs,
    links_borne_s,
    reached_from,
    settled_prcs,
)
from companion.config.fleet import EdgeNeighbours, FleetConfig
from companion.config.law import LawName, law_of
from companion.config.planned_flight import (
    graph_in_slots,
    neighbour_graph,
)
from companion.core.filter.vehicles import PASSING_M, RIPPLE_M
from companion.core.formation.paths import Path as SlotPath
from companion.geometry.formations import to_separation_metric
from companion.laws import Law
from companion.tools.second_edges import SecondEdges, second_edges
from companion.tools.subject import STEP_M, Subject
from companion.types.flight import Role
from companion.types.notices import Notice, Refused
from companion.types.values import Vector3

# Parameters of any law that analysis knows: what its advice is about.
GAIN_PARAMETERS = ("position_gain_1_s2", "velocity_gain_1_s")
LAW_NAMES: tuple[LawName, ...] = ("cooperative", "weighted", "average_22", "average_26")
AVERAGE_LAWS: tuple[LawName, ...] = ("average_22", "average_26")
PREDICT_S = 120.0
WORST_START_UP_TO = 100  # vehicles; for more the worst start takes too long to compute
MORE = 0.1  # relative change of a gain that is tried
VELOCITY_ERROR_M_S = 0.1  # assumed error of an estimator's velocity against its own position
ERROR_TURNS_S = 30.0


class LawAnalysis(Struct, frozen=True, kw_only=True):
    """Figures of one law with the leaders of the fleet file. Distances are of pairs of neighbours.

    lambda_min, eigenvalues and G are of the interaction matrix; of complex eigenvalues, which only laws that are not built in
    can have, they are the real parts. The gains are those about one neighbour over 1 m and 1 m/s: of a law that saturates less
    than near the formation. Rate, damping and delay_margin_s are of the
    modes without attitude lag and link, with feed-forward; all else is with lag and delays. String gains are None without a
    hop. For an unstable formation string gains, peaks, times and distances are None. A time is None also where the event does
    not occur. The margin is the smallest for the links of the scenario, or up to LATE_LINK_S where it has none, of the
    neighbours at the start and in the slots; peaks, times and distances are with the link of the scenario.
    """

    gain_position_1_s2: float
    gain_velocity_1_s: float
    exponent: float | None  # None: no parameter of this law
    weight_ratio: float | None
    feedforward: float | None
    remarks: list[str]  # what does not hold of its linearisation
    stable: bool  # with attitude lag, the delay on board and these links
    lambda_min: float
    eigenvalues: list[float]
    rate_1_s: float
    damping_min: float
    delay_margin_s: float
    delay_margin_with_lag_s: float
    more_velocity_gain_helps: (
        bool | None
    )  # whether MORE gain on velocity makes it larger; None: it has no such parameter
    string_gain_per_hop: float | None
    string_gain_per_hop_rad_s: float | None  # frequency of the largest gain per hop
    string_gain_to_last: float | None
    string_gain_to_last_rad_s: float | None
    # From the slot, by a constant VELOCITY_ERROR_M_S that the correction does not see; None: the law has a memory
    velocity_error_shift_m: float | None
    # By one that turns once in ERROR_TURNS_S, with law.velocity_correction_1_s
    velocity_error_shift_corrected_m: float | None
    transient_peak: float | None  # largest error over the largest at the start
    worst_transient_peak: float | None  # largest peak from any start; None for more than WORST_START_UP_TO vehicles
    time_to_10_cm_s: float | None  # by the rate alone
    predicted_settle_s: float | None  # as flown: with the paths into the slots, or by the law alone
    leader_settle_s: float | None  # likewise, of a leader without neighbours from the same largest error
    limit_s: (
        float | None
    )  # and so long after it at the earliest, the farthest vehicle: that motion passed on over all hops
    leader_step_settle_s: float | None  # likewise, from STEP_M
    predicted_max_distance_m: dict[str, float] | None
    predicted_min_distance_m: dict[str, float] | None
    predicted_smallest_distance_m: float | None  # of all pairs, as the separation filter leaves it
    law_alone_distance_m: float | None  # and as the law alone would
    smallest_distance_of: str | None
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
    link_s: float  # delay of the links between the agents in the predictions
    latest_link_s: float  # and the latest one that the law must be stable with
    least_margin_s: float  # the delay margin that it must have
    separation_m: float
    reference_moves: bool  # in flight; in the predictions it is at rest at its start
    graph: dict[int, list[int]]
    laws: dict[LawName, LawAnalysis]
    hops: int  # hops to the vehicle farthest from a leader
    lambda_min_by_leader: dict[int, float]
    gain_on_average: dict[LawName, float]
    unreached: list[int]  # vehicles without a path to a leader
    second_edges: SecondEdges | None  # that make the string gain of the fleet's law smaller
    looks_wrong: list[Notice]  # what of the file is probably meant otherwise
    not_read: list[str]  # sections and keys of the file that are not used
    kinds: int  # of vehicles, by autopilot and drag
    # Of several kinds, all figures are of a fleet like this vehicle, with the least delay to spare
    like_vehicle: int | None


def analyse(subject: Subject) -> Analysis:
    """All figures of one subject. A formation that cannot converge is a result, not an error.

    Of several kinds of vehicle they are those of a fleet of one kind: the one with the least delay to spare.
    """
    fleet = subject.fleet
    ids = sorted(member.id for member in fleet.vehicles)
    leaders = [member.id for member in fleet.vehicles if member.role is Role.LEADER]
    graph = neighbour_graph(fleet.neighbours, subject.flying_enu_m)
    unreached = sorted(set(ids) - reached_from(graph, leaders))
    graphs = flown_graphs(graph, graph_in_slots(fleet), leaders)
    if len(subject.kinds) > 1 and not unreached:
        subject = _of_least_spare(subject, graphs, leaders)
    names = () if unreached else dict.fromkeys((*LAW_NAMES, fleet.law.name))
    laws = {name: _law_analysis(subject, graphs, leaders, name) for name in names}
    own = law_of(fleet.law)
    by_leader = {
        i: float(_couple(subject, graph, {i}, own).spectrum[0])
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
        link_s=subject.link_s,
        latest_link_s=max(links_borne_s(subject.link_s)),
        least_margin_s=subject.least_margin_s,
        separation_m=fleet.separation_m,
        reference_moves=subject.reference_moves,
        graph=graph,
        laws=laws,
        hops=0 if unreached else max(settled_prcs(graph, leaders).values()) - 1,
        lambda_min_by_leader=by_leader,
        gain_on_average=gain,
        unreached=unreached,
        second_edges=_second_edges(subject, graph, leaders) if laws and laws[fleet.law.name].stable else None,
        looks_wrong=list(subject.looks_wrong),
        not_read=list(subject.not_read),
        kinds=len(subject.kinds),
        like_vehicle=subject.kinds[subject.kind] if len(subject.kinds) > 1 else None,
    )


def _of_least_spare(subject: Subject, graphs: Sequence[Graph], leaders: Collection[int]) -> Subject:
    """The subject with that kind of vehicle first whose delay margin is least above what it needs."""
    law, kinds = law_of(subject.fleet.law), subject.kinds

    def spare_s(alike: Subject) -> float:
        models = [alike.model(link_s) for link_s in links_borne_s(alike.link_s)]
        couplings = [_couple(alike, graph, leaders, law) for graph in graphs]
        return least_delay_margin_s(couplings, models) - alike.least_margin_s

    return min((replace(subject, kinds={kind: kinds[kind]} | kinds) for kind in kinds), key=spare_s)


def _second_edges(subject: Subject, graph: Graph, leaders: Collection[int]) -> SecondEdges | None:
    law, model = law_of(subject.fleet.law), subject.model(subject.link_s)

    def gains_of(graph: Graph) -> StringGains | None:
        coupling = _couple(subject, graph, leaders, law)
        return string_gains(coupling, model) if are_stable([coupling], [model], model.delay_s) else None

    gains = gains_of(graph) if isinstance(subject.fleet.neighbours, EdgeNeighbours) else None
    return second_edges(graph, leaders, gains, gains_of) if gains else None


def _law_analysis(subject: Subject, graphs: Sequence[Graph], leaders: Collection[int], name: LawName) -> LawAnalysis:
    """`graphs`: that at the start first, that in the slots last."""
    law = law_of(subject.fleet.law.with_name(name))
    hops = max(settled_prcs(graphs[0], leaders).values()) - 1
    flown = [_couple(subject, graph, leaders, law) for graph in graphs]
    coupling, in_slots = flown[0], flown[-1]
    rate_1_s, law_gains = coupling.rate_1_s, coupling.gains
    models = [subject.model(link_s) for link_s in links_borne_s(subject.link_s)]
    margin_s = least_delay_margin_s(flown, models)
    stable = margin_s > subject.least_margin_s
    model = subject.model(subject.link_s)
    flight = _predict(subject, graphs[0], in_slots) if stable else _NO_FLIGHT
    gains = string_gains(coupling, model) if stable else None
    start_error_m = float(np.linalg.norm(_start_errors_m(subject), axis=1).max())
    leader_settle_s, leader_step_settle_s = _leader_settles_s(subject, law, start_error_m) if stable else (None, None)
    shifted_m = None if law.memory else shift_m(law_gains, VELOCITY_ERROR_M_S)  # an integral takes the shift out
    correction_1_s = subject.fleet.law.velocity_correction_1_s
    return LawAnalysis(
        gain_position_1_s2=law_gains.position_1_s2,
        gain_velocity_1_s=law_gains.velocity_1_s,
        exponent=getattr(law, "exponent", None),
        weight_ratio=getattr(law, "weight_ratio", None),
        feedforward=getattr(law, "feedforward", None),
        remarks=coupling.network.remarks,
        stable=stable,
        lambda_min=float(coupling.spectrum[0]),
        eigenvalues=coupling.spectrum.tolist(),
        rate_1_s=rate_1_s,
        damping_min=coupling.damping,
        delay_margin_s=delay_margin_with_lag_s(coupling, IDEAL),
        delay_margin_with_lag_s=margin_s,
        more_velocity_gain_helps=_more_velocity_gain_helps(subject, flown, models, margin_s),
        string_gain_per_hop=gains.per_hop if gains else None,
        string_gain_per_hop_rad_s=gains.per_hop_rad_s if gains else None,
        string_gain_to_last=gains.to_last if gains else None,
        string_gain_to_last_rad_s=gains.to_last_rad_s if gains else None,
        worst_transient_peak=_worst_transient_peak(coupling, model) if stable else None,
        time_to_10_cm_s=time_to_shrink_s(rate_1_s, start_error_m, SETTLED_WITHIN_M) if stable else None,
        leader_settle_s=leader_settle_s,
        limit_s=None if leader_settle_s is None else leader_settle_s + hops * subject.pass_on_s,
        leader_step_settle_s=leader_step_settle_s,
        velocity_error_shift_m=shifted_m,
        velocity_error_shift_corrected_m=None
        if shifted_m is None
        else shifted_m * share_left(tau / ERROR_TURNS_S, correction_1_s),
        G=coupling.G.tolist(),
        **flight,
    )


_NO_FLIGHT: dict[str, Any] = dict.fromkeys(
    (
        "transient_peak",
        "predicted_settle_s",
        "predicted_max_distance_m",
        "predicted_min_distance_m",
        "law_alone_distance_m",
        "predicted_smallest_distance_m",
        "smallest_distance_of",
        "stays_in_range",
        "margin_to_range_m",
    )
)


def _predict(subject: Subject, graph: Graph, coupling: Coupling) -> dict[str, Any]:
    """The figures of the flight of a stable law. `graph` has the neighbours at the start, whose distances are reported."""
    model, start_errors_m = subject.model(subject.link_s), _start_errors_m(subject)
    errors_m = errors_over_time(coupling, start_errors_m, model, PREDICT_S, _paths(subject, coupling, start_errors_m))
    extremes_m = _extremes_m(subject.fleet, errors_m)
    of_neighbours = {pair: found for pair, found in extremes_m.items() if pair[1] in graph[pair[0]]}
    closest = min(extremes_m, key=lambda pair: extremes_m[pair][0], default=None)
    range_m = _margin_to_range_m(subject.fleet, of_neighbours.values()) if of_neighbours else None
    nearest_m = extremes_m[closest][0] if closest else None
    return {
        "transient_peak": transient_peak(errors_m),
        "predicted_settle_s": settled_after_s(errors_m, SETTLED_WITHIN_M),
        "predicted_max_distance_m": {f"{i}-{j}": round(most, 4) for (i, j), (_, most) in of_neighbours.items()},
        "predicted_min_distance_m": {f"{i}-{j}": round(least, 4) for (i, j), (least, _) in of_neighbours.items()},
        "law_alone_distance_m": None if nearest_m is None else round(nearest_m, 4),
        "predicted_smallest_distance_m": None
        if nearest_m is None
        else round(max(nearest_m, _kept_m(subject.fleet)), 4),
        "smallest_distance_of": f"{closest[0]}-{closest[1]}" if closest else None,
        "stays_in_range": None if range_m is None else range_m >= 0.0,
        "margin_to_range_m": range_m,
    }


def _kept_m(fleet: FleetConfig) -> float:
    """The distance that the separation filter keeps on the way to the slots, in metres; slots may be nearer to each other."""
    slots = [to_separation_metric(member.slot_enu_m, fleet.law.altitude == "formation") for member in fleet.vehicles]
    return min(fleet.separation_m + PASSING_M + RIPPLE_M, *(dist(one, other) for one, other in combinations(slots, 2)))


def _paths(subject: Subject, coupling: Coupling, start_errors_m: NDArray[np.float64]) -> Sequence[SlotPath | None]:
    """The paths into the slots, by rising id; none where a slot is too far away, which `form` refuses."""
    fleet = subject.fleet
    ids = sorted(member.id for member in fleet.vehicles)
    offsets_m: dict[int, Vector3] = {}
    for i, (x, y, z) in zip(ids, start_errors_m.tolist(), strict=True):
        offsets_m[i] = (x, y, z if fleet.law.altitude == "formation" else 0.0)
    leader = ids[int(np.flatnonzero(coupling.is_leader)[0])]
    led = subject.link_s < ATTITUDE_LOOPS[subject.kind.autopilot].engages_s
    try:
        found = paths_into_slots(offsets_m, leader, coupling.gains, fleet.slot_speed_m_s, led=led)
    except Refused:
        return ()
    return [found[i] for i in ids] if any(found.values()) else ()


def _couple(subject: Subject, graph: Graph, leaders: Collection[int], law: Law) -> Coupling:
    slots_enu_m = {member.id: member.slot_enu_m for member in subject.fleet.vehicles}
    return couple(graph, leaders, law, slots_enu_m, subject.kind.drag_1_s)


def _leader_settles_s(subject: Subject, law: Law, start_error_m: float) -> tuple[float | None, float | None]:
    """A leader alone, from this error and from STEP_M."""
    alone, model = couple({1: []}, {1}, law, drag_1_s=subject.kind.drag_1_s), subject.model(subject.link_s)
    errors_m = errors_over_time(alone, np.array([[1.0]]), model, PREDICT_S)
    return settled_after_s(start_error_m * errors_m, SETTLED_WITHIN_M), settled_after_s(
        STEP_M * errors_m, SETTLED_WITHIN_M
    )


def _more_velocity_gain_helps(
    subject: Subject, couplings: Sequence[Coupling], models: Sequence[LinearModel], margin_s: float
) -> bool | None:
    """Whether the margin grows with MORE gain on velocity; where there is none, whether that without lag does."""
    law = couplings[0].law
    if not set(GAIN_PARAMETERS) <= set(law.__struct_fields__):
        return None
    more = msgspec.structs.replace(law, velocity_gain_1_s=getattr(law, GAIN_PARAMETERS[1]) * (1.0 + MORE))
    changed = [_couple(subject, *one.network.formation, more) for one in couplings]
    if margin_s > 0.0:
        return are_stable(changed, models, margin_s)
    return delay_margin_with_lag_s(changed[0], IDEAL) > delay_margin_with_lag_s(couplings[0], IDEAL)


def _worst_transient_peak(coupling: Coupling, model: LinearModel) -> float | None:
    return worst_transient_peak(coupling, model) if len(coupling.G) <= WORST_START_UP_TO else None


def _start_errors_m(subject: Subject) -> NDArray[np.float64]:
    """e_i = x_i - r - d_i0 at the start (n, 3), in ascending order of the ids."""
    positions = subject.flying_enu_m
    slots = {member.id: member.slot_enu_m for member in subject.fleet.vehicles}
    rows = [np.subtract(np.subtract(positions[i], subject.reference_enu_m), slots[i]) for i in sorted(slots)]
    return np.array(rows, dtype=float)


def _extremes_m(fleet: FleetConfig, errors_m: NDArray[np.float64]) -> dict[tuple[int, int], tuple[float, float]]:
    """Smallest and largest distance of every pair."""
    slots = sorted((member.id, member.slot_enu_m) for member in fleet.vehicles)
    along_m = {i: errors_m[:, column].T + np.array(slot)[:, np.newaxis] for column, (i, slot) in enumerate(slots)}
    found = {}
    for i, j in combinations(along_m, 2):
        x, y, z = along_m[i] - along_m[j]
        apart_m2 = x * x + y * y + z * z
        found[i, j] = (sqrt(apart_m2.min()), sqrt(apart_m2.max()))
    return found


def _margin_to_range_m(fleet: FleetConfig, extremes_m: Iterable[tuple[float, float]]) -> float | None:
    """Range + hysteresis minus the largest distance of any pair of neighbours; None with edges."""
    if isinstance(fleet.neighbours, EdgeNeighbours):
        return None
    leave_m = fleet.neighbours.range_m + fleet.neighbours.hysteresis_m
    return leave_m - max(most_m for _, most_m in extremes_m)
