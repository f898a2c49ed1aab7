"""Whether the law of a fleet follows a reference without bringing two vehicles nearer than separation_m."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations, pairwise
from math import ceil, dist, floor, hypot, inf, log, radians, tan, tau

from companion.analysis.response import ROUNDING, Chain, Harmonic, Motion, Pair, refused_cases, slower_by
from companion.config.fleet import FleetConfig
from companion.config.planned_flight import neighbour_graph
from companion.config.reference import (
    CircleReference,
    Figure8Reference,
    Lapping,
    PointReference,
    Reference,
    TargetReference,
    WaypointsReference,
)
from companion.config.reference_check import largest_pace
from companion.config.validation import Problem, needs
from companion.core.consensus.law import FormationLaw
from companion.geometry.curves import PEAK_ACCELERATION, PEAK_SPEED, duration_s
from companion.geometry.formations import counted
from companion.types.flight import Role
from companion.types.steps import Steps, whole
from companion.types.values import GRAVITY_M_S2, Vector3

USUAL_DRAG_1_S = 0.25  # of a small open quadrotor
MANY_LEGS, DURATION_STEP = 32, 1.06
TARGET_RATES = (0.1, 0.3, 1.0, 2.0, 4.0)  # of a target's motion, in units of largest acceleration over largest speed


def following_problems(
    fleet: FleetConfig,
    law: FormationLaw,
    reference: Reference,
    slots_enu_m: Mapping[int, Vector3],
    drag_1_s: float = USUAL_DRAG_1_S,
    where: str = "reference",
) -> Iterator[Problem]:
    """One problem where the formation would be compressed below separation_m, with the pace that would be accepted."""
    problem = whole(following_steps(fleet, law, reference, slots_enu_m, drag_1_s, where))
    return iter(() if problem is None else (problem,))


def following_steps(
    fleet: FleetConfig,
    law: FormationLaw,
    reference: Reference,
    slots_enu_m: Mapping[int, Vector3],
    drag_1_s: float = USUAL_DRAG_1_S,
    where: str = "reference",
) -> Steps[Problem | None]:
    """`following_problems` in steps."""
    needs(reference)
    motions = motions_of(reference, fleet.slots_turn)
    if not motions or len(slots_enu_m) < 2:
        return None
    slots_m = {i: counted(slot, fleet.law.altitude == "formation") for i, slot in slots_enu_m.items()}
    if min(dist(a, b) for a, b in combinations(slots_m.values(), 2)) < fleet.separation_m * (1.0 - ROUNDING):
        return None  # refused by themselves
    chains = chains_of(fleet, law, slots_enu_m, drag_1_s)
    yield
    refused = yield from refused_cases(chains, motions, slots_m, fleet.separation_m)
    if not refused:
        return None
    times = yield from slower_by(refused, slots_m, fleet.separation_m)
    field, value, advice = _slower(reference, times)
    outcome = _outcome(refused[0].pair, fleet)
    return Problem(f"{where}.{field}", f"{value}: with {fleet.law.name} {outcome}; expected {advice}")


def chains_of(
    fleet: FleetConfig, law: FormationLaw, slots_enu_m: Mapping[int, Vector3], drag_1_s: float
) -> Iterator[Chain]:
    """The formation with its leaders at the start, and with each other vehicle that may lead as the only leader."""
    graph = neighbour_graph(fleet.neighbours, slots_enu_m)
    leaders = [frozenset(m.id for m in fleet.vehicles if m.role is Role.LEADER)]
    leaders += [frozenset({m.id}) for m in fleet.vehicles if m.can_lead and {m.id} != leaders[0]]
    envelope = fleet.envelope
    most_m_s2 = GRAVITY_M_S2 * tan(radians(envelope.max_tilt_deg))
    return (Chain(law, graph, of, drag_1_s, envelope.max_speed_m_s, most_m_s2) for of in leaders)


def motions_of(reference: Reference, slots_turn: bool) -> list[Motion]:
    """What the law has to follow, each motion by itself; none of a reference at rest.

    A leg counts as the harmonic with its largest speed and acceleration. The slots of a formation that turns point in all
    directions in turn.
    """
    match reference:
        case PointReference():
            return []
        case CircleReference():
            speed_m_s, acceleration_m_s2 = largest_pace(reference)
            lap = Harmonic(tau / reference.period_s, (reference.radius_m, reference.radius_m, 0.0), rotates=True)
            return [[lap], [_harmonic(speed_m_s, acceleration_m_s2, (1.0, 1.0, 0.0), rotates=True)]]
        case Figure8Reference():
            rate_rad_s, a_m, b_m = tau / reference.period_s, reference.width_m / 2.0, reference.height_m / 2.0
            if slots_turn:
                return [
                    [
                        Harmonic(rate_rad_s, (a_m, a_m, 0.0), rotates=True),
                        Harmonic(2.0 * rate_rad_s, (b_m, b_m, 0.0), rotates=True),
                    ]
                ]
            return [[Harmonic(rate_rad_s, (a_m, 0.0, 0.0)), Harmonic(2.0 * rate_rad_s, (0.0, b_m, 0.0))]]
        case WaypointsReference():
            return [[harmonic] for harmonic in _legs(reference, slots_turn)]
        case TargetReference():
            return _target(reference)


def _legs(reference: WaypointsReference, slots_turn: bool) -> Iterator[Harmonic]:
    """One harmonic for each leg with another direction or pace.

    Of many legs the duration is shortened by up to DURATION_STEP, so that few rates remain: they are the dear part.
    """
    limits = (reference.max_speed_m_s, reference.max_acceleration_m_s2)
    lengths_m = [(a, b, leg_m) for a, b in pairwise(reference.points_enu_m) if (leg_m := dist(a, b)) > 1e-6]
    shortest_s = min((duration_s(leg_m, *limits) for _, _, leg_m in lengths_m), default=0.0)
    seen = set()
    for a, b, leg_m in lengths_m:
        lasts_s = duration_s(leg_m, *limits)
        if lasts_s <= 0.0:
            continue
        if len(lengths_m) > MANY_LEGS:
            lasts_s = shortest_s * DURATION_STEP ** floor(log(lasts_s / shortest_s) / log(DURATION_STEP) + 1e-9)
        direction = ((b[0] - a[0]) / leg_m, (b[1] - a[1]) / leg_m, (b[2] - a[2]) / leg_m)
        key = (round(leg_m, 3), *(round(abs(c), 3) for c in direction))
        if key in seen:
            continue
        seen.add(key)
        level = hypot(direction[0], direction[1])
        along = (level, level, abs(direction[2])) if slots_turn else direction
        yield _harmonic(PEAK_SPEED * leg_m / lasts_s, PEAK_ACCELERATION * leg_m / lasts_s**2, along, slots_turn)


def _target(reference: TargetReference) -> list[Motion]:
    speed_m_s, acceleration_m_s2 = reference.max_speed_m_s, reference.max_acceleration_m_s2
    direction = (1.0, 1.0, 1.0 if reference.follows_altitude else 0.0)
    motions: list[Motion] = []
    for share in TARGET_RATES:
        rate_rad_s = share * acceleration_m_s2 / speed_m_s
        most_m = min(speed_m_s / rate_rad_s, acceleration_m_s2 / rate_rad_s**2)
        x, y, z = direction
        motions.append([Harmonic(rate_rad_s, (x * most_m, y * most_m, z * most_m), rotates=True)])
    return motions


def _harmonic(speed_m_s: float, acceleration_m_s2: float, direction: Vector3, rotates: bool) -> Harmonic:
    """The harmonic with this largest speed and acceleration."""
    size_m = speed_m_s**2 / acceleration_m_s2
    x, y, z = direction
    return Harmonic(acceleration_m_s2 / speed_m_s, (x * size_m, y * size_m, z * size_m), rotates)


def _outcome(pair: Pair, fleet: FleetConfig) -> str:
    if pair.one_id == pair.other_id:
        return f"vehicle {pair.one_id} would exceed envelope.max_speed_m_s or max_tilt_deg to keep up"
    return (
        f"vehicles {pair.one_id} and {pair.other_id} would come within {pair.distance_m:.2f} m of each other,"
        f" separation_m is {fleet.separation_m:g}"
    )


def _slower(reference: Reference, times: float) -> tuple[str, str, str]:
    """(field, value, advice) of a reference that must take this many times longer."""
    if times == inf:
        return "kind", str(type(reference).__struct_config__.tag), "a point: no pace of it keeps the distance"
    if isinstance(reference, Lapping):
        period_s, ramp_s = _up(reference.period_s * times), _up(reference.ramp_s * times)
        return "period_s", f"{reference.period_s:g} s", f"at least {period_s:g} s with ramp_s {ramp_s:g}"
    assert isinstance(reference, WaypointsReference | TargetReference)
    speed_m_s = _down(reference.max_speed_m_s / times)
    acceleration_m_s2 = _down(reference.max_acceleration_m_s2 / times**2)
    advice = f"at most {acceleration_m_s2:g} m/s^2 with max_speed_m_s {speed_m_s:g}"
    return "max_acceleration_m_s2", f"{reference.max_acceleration_m_s2:g} m/s^2", advice


def _up(seconds: float) -> float:
    return ceil(seconds * 10.0) / 10.0


def _down(limit: float) -> float:
    return floor(limit * 1000.0) / 1000.0
