"""Whether a fleet can fly a reference: inside the fence, clear of obstacles, within tilt and speed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from math import dist, floor, radians, tan
from pathlib import Path

from companion.config.degrees import degree_hint
from companion.config.file import refuse
from companion.config.fleet import FleetConfig
from companion.config.reference import Reference
from companion.config.reference.base import LimitedReference
from companion.config.validation import Problem, each, needs, without_pauses
from companion.geometry.airspace import Airspace, conflict_steps, leg_conflict_steps, nearest_kind
from companion.geometry.curves import PEAK_SPEED, duration_s
from companion.geometry.formations import SLOT_ACCELERATION_M_S2, course, reach_m, swept, turn_limits
from companion.geometry.vectors import plus
from companion.types.steps import Steps, coarser
from companion.types.values import GRAVITY_M_S2, Vector3

ROUNDED = 1.0 + 1e-9  # a limit that is met exactly is met


def reference_checks(
    fleet: FleetConfig, reference: Reference, where: str = "reference", slots_enu_m: Mapping[int, Vector3] | None = None
) -> Iterator[Problem | None]:
    """Each slot r + d_i0 must stay inside the fence, and the fleet must be able to follow r. None after each part of the work.

    `slots_enu_m`: the slots of the formation that is flown; None for those of the fleet file.
    `where`: the path of the section of the reference.
    """
    needs(reference)
    slots = slots_enu_m or {member.id: member.slot_enu_m for member in fleet.vehicles}
    if contradictions := [Problem(f"{where}.{key}", text) for key, text in reference.contradictions()]:
        yield from contradictions
        return
    yield from each(
        _positions(where, fleet, reference, slots),
        _paths(where, fleet, reference, slots, reference.largest_pace()[0]),
    )
    yield None
    if reference.MOVES:
        yield from each(_pace(where, fleet, reference))
        yield None
    if fleet.slots_turn and reference.MOVES:
        yield from each(_turns(where, fleet, reference, slots))


reference_problems = without_pauses(reference_checks)


def check_reference(
    file: Path, fleet: FleetConfig, reference: Reference, slots_enu_m: Mapping[int, Vector3] | None = None
) -> None:
    """Raises ConfigError with all `reference_problems`."""
    refuse(file, reference_problems(fleet, reference, slots_enu_m=slots_enu_m))


def accepted_values(reference: Reference, problems: Iterable[Problem]) -> tuple[tuple[str, float], ...]:
    """Keys of the reference with values that meet all these problems: of each key the one farthest from what it asks for."""
    accepts: dict[str, float] = {}
    for key, value in (one for problem in problems for one in problem.accepts):
        asked = getattr(reference, key)
        accepts[key] = max(accepts.get(key, asked), value, key=lambda other: abs(other - asked))
    return tuple(accepts.items())


def most_pace(fleet: FleetConfig) -> tuple[float, float]:
    """Largest speed [m/s] and acceleration [m/s^2] that a reference may have.

    The speed is that of the envelope, the acceleration that of the largest tilt in level flight. Both are reduced by what
    slots need that turn about the RFT.
    """
    speed_m_s, acceleration_m_s2 = (
        fleet.envelope.max_speed_m_s,
        GRAVITY_M_S2 * tan(radians(fleet.envelope.max_tilt_deg)),
    )
    if fleet.slots_turn:
        return speed_m_s - fleet.slot_speed_m_s, acceleration_m_s2 - SLOT_ACCELERATION_M_S2
    return speed_m_s, acceleration_m_s2


def _positions(
    where: str, fleet: FleetConfig, reference: Reference, slots_enu_m: Mapping[int, Vector3]
) -> Iterator[Problem]:
    """One problem for each axis: the first vehicle that would leave the fence along it."""
    corners = reference.corners_enu_m()
    fence, clearance_m = (fleet.envelope.fence_min_enu_m, fleet.envelope.fence_max_enu_m), fleet.envelope.clearance_m
    offsets = [
        (vehicle_id, offset_m)
        for vehicle_id, slot_enu_m in slots_enu_m.items()
        for offset_m in (swept([slot_enu_m]) if fleet.slots_turn else [slot_enu_m])
    ]
    for axis, name in enumerate("xyz"):
        low_m, high_m = fence[0][axis] + clearance_m, fence[1][axis] - clearance_m
        positions = ((i, corner[axis] + offset[axis]) for i, offset in offsets for corner in corners)
        outside = next(((i, at_m) for i, at_m in positions if not low_m <= at_m <= high_m), None)
        if outside is not None:
            yield Problem(
                f"{where}.{reference.POSITION}",
                f"puts vehicle {outside[0]} at {name} = {outside[1]:g} m,"
                f" outside the fence less clearance_m ({low_m:g} to {high_m:g})"
                + degree_hint(fleet.origin, reference.start_enu_m, slots_enu_m[outside[0]]),
            )


def _paths(
    where: str, fleet: FleetConfig, reference: Reference, slots_enu_m: Mapping[int, Vector3], speed_m_s: float
) -> Iterator[Problem | None]:
    """The first vehicle whose path with this reference leaves the fence or meets an obstacle, in an airspace beyond a box.

    `speed_m_s` is the largest speed of the reference. A slot that turns about the RFT needs room on its whole circle. None
    stands for a pause of the check.
    """
    airspace = fleet.airspace
    if airspace.is_box:
        return
    for vehicle_id, slot_enu_m in slots_enu_m.items():
        offset, around_m = ((0.0, 0.0, slot_enu_m[2]), reach_m([slot_enu_m])) if fleet.slots_turn else (slot_enu_m, 0.0)
        steps = _conflict(airspace, reference, offset, around_m, speed_m_s)
        position = yield from coarser(steps, airspace.positions_per_step())
        yield None
        if position is not None:
            x, y, z = position
            place = f"({x:.1f}, {y:.1f}, {z:.1f})" + (f" with {around_m:.1f} m around it to turn" if around_m else "")
            text = f"brings vehicle {vehicle_id} to {place}, too near to {nearest_kind(airspace, position)}"
            clearance = f"expected a path that keeps envelope.clearance_m, {airspace.clearance_m:g} m"
            yield Problem(f"{where}.{reference.POSITION}", f"{text}; {clearance}")
            return


def _conflict(
    airspace: Airspace, reference: Reference, offset: Vector3, around_m: float, speed_m_s: float
) -> Steps[Vector3 | None]:
    if legs := reference.legs_enu_m():
        for a, b in legs:
            steps = leg_conflict_steps(airspace, plus(a, offset), plus(b, offset), around_m)
            if (found := (yield from steps)) is not None:
                return found
        return None
    curve, lasts_s = reference.curve(), reference.curve_s()
    at, rate_m_s = lambda time_s: plus(curve(time_s)[0], offset), max(speed_m_s, 0.1)
    return (yield from conflict_steps(airspace, at, lasts_s, rate_m_s, around_m))


def _pace(where: str, fleet: FleetConfig, reference: Reference) -> Iterator[Problem]:
    """Above these limits vehicles cannot follow."""
    speed_m_s, acceleration_m_s2 = reference.largest_pace()
    accepted_m_s, most_m_s2 = most_pace(fleet)
    if accepted_m_s <= 0.0 or most_m_s2 <= 0.0:
        return  # the fleet is refused: turning slots leave a reference nothing
    for_turning = ", less what slots need that turn" if fleet.slots_turn else ""
    found: dict[str, tuple[float, Problem]] = {}  # by field: how many times slower it must be, and the problem
    if acceleration_m_s2 > most_m_s2 * ROUNDED:
        times = (acceleration_m_s2 / most_m_s2) ** 0.5
        slower = reference.excess("max_acceleration_m_s2", most_m_s2, times)
        given = f"envelope.max_tilt_deg {fleet.envelope.max_tilt_deg:g} gives {most_m_s2:.1f}{for_turning}"
        text = f"{slower.asks} for {acceleration_m_s2:.1f} m/s^2, {given}; expected {slower.expected}"
        found[slower.key] = times, Problem(f"{where}.{slower.key}", text, slower.accepts)
    if speed_m_s > accepted_m_s * ROUNDED:
        times = speed_m_s / accepted_m_s
        slower = reference.excess("max_speed_m_s", accepted_m_s, times)
        given = f"envelope.max_speed_m_s allows {accepted_m_s:g}{for_turning}"
        text = f"{slower.asks} for {speed_m_s:.1f} m/s, {given}; expected {slower.expected}"
        if times > found.get(slower.key, (0.0,))[0]:  # the slower pace meets both limits
            found[slower.key] = times, Problem(f"{where}.{slower.key}", text, slower.accepts)
    yield from (problem for _, problem in found.values())
    yield from _climbs(where, fleet, reference) if isinstance(reference, LimitedReference) else ()
    yield from _rates(where, fleet, reference)


def _climbs(where: str, fleet: FleetConfig, reference: LimitedReference) -> Iterator[Problem]:
    """The first leg that is faster upwards or downwards than the vehicles may be."""
    for a, b in reference.legs_enu_m():
        rise_m, leg_m = b[2] - a[2], dist(a, b)
        name = "max_climb_m_s" if rise_m > 0.0 else "max_descent_m_s"
        most_m_s = getattr(fleet.envelope, name)
        lasts_s = duration_s(leg_m, *reference.limits)
        rate_m_s = PEAK_SPEED * abs(rise_m) / lasts_s if lasts_s > 0.0 else 0.0
        if rate_m_s > most_m_s * ROUNDED:
            expected_m_s = floor(most_m_s * leg_m / abs(rise_m) * 100.0) / 100.0
            yield Problem(
                f"{where}.max_speed_m_s",
                f"{reference.max_speed_m_s:g} gives {rate_m_s:.1f} m/s vertically, envelope.{name} allows {most_m_s:g};"
                f" expected at most {expected_m_s:g}",
                (("max_speed_m_s", expected_m_s),),
            )
            return


def _rates(where: str, fleet: FleetConfig, reference: Reference) -> Iterator[Problem]:
    """One without legs that is faster upwards or downwards than the vehicles may be."""
    for name, rate_m_s in zip(("max_climb_m_s", "max_descent_m_s"), reference.largest_climb(), strict=True):
        most_m_s = getattr(fleet.envelope, name)
        if rate_m_s > most_m_s * ROUNDED:
            slower = reference.slower_pace(rate_m_s / most_m_s)
            text = f"{slower.asks} gives {rate_m_s:.1f} m/s vertically, envelope.{name} allows {most_m_s:g}"
            yield Problem(f"{where}.{slower.key}", f"{text}; expected {slower.expected}", slower.accepts)


def _turns(
    where: str, fleet: FleetConfig, reference: Reference, slots_enu_m: Mapping[int, Vector3]
) -> Iterator[Problem]:
    """A formation that cannot turn as fast as the course falls behind more and more."""
    outermost_m = reach_m(slots_enu_m.values())
    most_rad_s = turn_limits(outermost_m, fleet.slot_speed_m_s).rate_rad_s
    motions = map(reference.curve(), reference.turning_s())
    turns = (course(velocity, acceleration, 0.0) for _, velocity, acceleration in motions)
    fastest_rad_s = max((abs(turn.rate_rad_s) for turn in turns if turn), default=0.0)
    if fastest_rad_s > most_rad_s * ROUNDED:
        slower = reference.slower_turn(fastest_rad_s / most_rad_s)
        yield Problem(
            f"{where}.{slower.key}",
            f"{slower.asks} turns the course by up to {fastest_rad_s:.2f} rad/s; a formation that turns with it and reaches"
            f" {outermost_m:.1f} m can {most_rad_s:.2f}; expected {slower.expected}, or a larger slot_speed_m_s",
            slower.accepts,
        )
