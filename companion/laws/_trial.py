"""A few calls that every law must answer before it flies. Pure: no clock, no random numbers."""

from __future__ import annotations

from collections.abc import Callable
from math import dist, isclose
from typing import SupportsFloat

from companion.laws import Law, Neighbour, Own
from companion.laws._feedback_gains import feedback_gains
from companion.types.values import ZERO3, Vector3

MOST_M_S2 = 1e5  # on an axis, in any state; a gain of 10 gives a tenth of it 1 km away from the slot
MOST_BESIDE_M_S2 = 500.0  # on an axis, within 1 m and 1 m/s of the neighbours
MOST_GAIN = 100.0  # 1/s^2, 1/s
SAME_M_S2 = 1e-6
PRCS = (1, 2, 3)
ELSEWHERE_ENU_M: Vector3 = (1000.0, -2000.0, 100.0)


def trial_problem(law: Law) -> str:
    """Why this law must not fly; empty where these calls find nothing. Raises whatever the law raises."""
    alone = Own(ZERO3, ZERO3, memory=(ZERO3,) * law.memory)
    here = _beside_one_neighbour(law, ZERO3)
    for neighbours, given in (("no neighbour", law.acceleration(alone, (), None)), ("one neighbour", here)):
        if not _is_vector(given):
            text = f"with {neighbours} its acceleration is {given!r:.60}; expected (x, y, z), three numbers"
            return f"{_line_of(law.acceleration)}{text}"
    for method, count in ((law.remember, law.memory), (law.publish, law.publishes)):
        vectors = method(alone, (), None) if count else ()
        if not (isinstance(vectors, tuple | list) and len(vectors) == count and all(map(_is_vector, vectors))):
            text = (
                f"{method.__name__} gives {vectors!r:.60}; expected a tuple of (x, y, z), as many as declared: {count}"
            )
            return f"{_line_of(method)}{text}"
    for leads in (False, True):
        weights = law.weights(leads, PRCS)
        if len(weights) and not (len(weights) == len(PRCS) and isclose(sum(weights), 1.0, abs_tol=1e-6)):
            text = (
                f"weights gives {weights!r:.60} for PrCs {list(PRCS)}; expected one for each with a sum of 1, or none"
            )
            return f"{_line_of(law.weights)}{text}"
    if not all(-MOST_BESIDE_M_S2 <= axis <= MOST_BESIDE_M_S2 for axis in here):
        return f"within 1 m of its neighbour it gives {here} m/s^2; expected numbers up to {MOST_BESIDE_M_S2:g}"
    gains = feedback_gains(law)
    for name, gain in (("position", gains.position_1_s2), ("velocity", gains.velocity_1_s)):
        if not 0.0 < gain <= MOST_GAIN:
            expected = f"expected above 0, up to {MOST_GAIN:g}: it must pull back"
            return f"its {name} gain about one neighbour is {gain:g}; {expected}"
    if _beside_one_neighbour(law, ZERO3) != here:
        return "asked twice it answers differently; expected no state of its own but `memory`"
    if (change_m_s2 := dist(_beside_one_neighbour(law, ELSEWHERE_ENU_M), here)) > SAME_M_S2:
        what = f"its acceleration changes by {change_m_s2:.3g} m/s^2 where the whole formation is elsewhere"
        return f"{what}; expected differences of positions alone"
    return ""


def _is_vector(given: object) -> bool:
    return (
        isinstance(given, tuple | list) and len(given) == 3 and all(isinstance(axis, SupportsFloat) for axis in given)
    )


def _line_of(method: Callable[..., object]) -> str:
    """Where the method begins in the file of the law; empty for one that is no function of Python."""
    code = getattr(getattr(method, "__func__", None), "__code__", None)
    return f"line {code.co_firstlineno}: " if code else ""


def _beside_one_neighbour(law: Law, place_enu_m: Vector3) -> Vector3:
    x, y, z = place_enu_m
    memory = (ZERO3,) * law.memory
    ahead = Own(place_enu_m, (0.5, 0.0, 0.0), memory=memory)
    values = law.publish(ahead, (), None) if law.publishes else ()
    neighbour = Neighbour(ahead.position_enu_m, ahead.velocity_enu_m_s, values=values)
    return law.acceleration(Own((x + 0.4, y - 0.3, z + 0.2), (0.6, 0.2, -0.1), memory=memory), (neighbour,), None)
