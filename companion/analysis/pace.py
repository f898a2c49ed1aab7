"""Whether the law of a fleet follows a reference without bringing two vehicles nearer than separation_m."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations
from math import dist, inf, radians, tan

from companion.analysis.compression import ROUNDING, Chain, ClosestPair, refused_cases, slower_by
from companion.analysis.response import USUAL_DRAG_1_S, reached_from
from companion.config.file import ConfigError
from companion.config.fleet import FleetConfig
from companion.config.planned_flight import neighbour_graph
from companion.config.reference import Reference
from companion.config.reference.base import Slower
from companion.config.validation import Problem, needs
from companion.geometry.formations import to_separation_metric
from companion.laws import Law
from companion.types.flight import Role
from companion.types.steps import Steps
from companion.types.values import GRAVITY_M_S2, Vector3


def following_steps(
    fleet: FleetConfig,
    law: Law,
    reference: Reference,
    slots_enu_m: Mapping[int, Vector3],
    drag_1_s: float = USUAL_DRAG_1_S,
    where: str = "reference",
) -> Steps[Problem | None]:
    """A problem where the formation would be compressed below separation_m, with the pace that would be accepted."""
    needs(reference)
    motions = reference.motions(fleet.slots_turn)
    if not motions or len(slots_enu_m) < 2:
        return None
    slots_m = {i: to_separation_metric(slot, fleet.law.altitude == "formation") for i, slot in slots_enu_m.items()}
    if min(dist(a, b) for a, b in combinations(slots_m.values(), 2)) < fleet.separation_m * (1.0 - ROUNDING):
        return None  # refused by themselves
    if ids := ", ".join(map(str, unreached(fleet, slots_enu_m))):
        text = f"no path leads from a leader to vehicle {ids}; add an edge, more range, or a leader among them"
        return Problem("fleet.neighbours", text)
    chains = chains_of(fleet, law, slots_enu_m, drag_1_s)
    yield
    try:
        refused = yield from refused_cases(chains, motions, slots_m, fleet.separation_m)
    except ConfigError as error:  # the law, while it is linearised
        return Problem("law", str(error))
    if not refused:
        return None
    times = yield from slower_by(refused, slots_m, fleet.separation_m)
    if times == inf:
        slower = Slower("kind", reference.kind, "a point: no pace of it keeps the distance", ())
    else:
        slower = reference.slower_pace(times)
    text = f"{slower.asks}: with {fleet.law.name} {_outcome(refused[0].pair, fleet)}; expected {slower.expected}"
    return Problem(f"{where}.{slower.key}", text, slower.accepts)


def chains_of(fleet: FleetConfig, law: Law, slots_enu_m: Mapping[int, Vector3], drag_1_s: float) -> Iterator[Chain]:
    """The formation with its leaders at the start, and with each other vehicle that may lead as the only leader."""
    graph = neighbour_graph(fleet.neighbours, slots_enu_m)
    leaders = [frozenset(m.id for m in fleet.vehicles if m.role is Role.LEADER)]
    leaders += [frozenset({m.id}) for m in fleet.vehicles if m.can_lead and {m.id} != leaders[0]]
    envelope = fleet.envelope
    most_m_s2 = GRAVITY_M_S2 * tan(radians(envelope.max_tilt_deg))
    return (Chain(law, graph, of, drag_1_s, envelope.max_speed_m_s, most_m_s2, slots_enu_m) for of in leaders)


def unreached(fleet: FleetConfig, positions_enu_m: Mapping[int, Vector3]) -> list[int]:
    """The vehicles without a path to a leader, at these positions."""
    graph = neighbour_graph(fleet.neighbours, positions_enu_m)
    return sorted(set(graph) - reached_from(graph, [m.id for m in fleet.vehicles if m.role is Role.LEADER]))


def _outcome(pair: ClosestPair, fleet: FleetConfig) -> str:
    if pair.one_id == pair.other_id:
        return f"vehicle {pair.one_id} would exceed envelope.max_speed_m_s or max_tilt_deg to keep up"
    return (
        f"vehicles {pair.one_id} and {pair.other_id} would come within {pair.distance_m:.2f} m of each other,"
        f" separation_m is {fleet.separation_m:g}"
    )
