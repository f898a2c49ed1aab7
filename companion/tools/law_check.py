"""What `companion law check` tries: what a law must keep before it flies on a vehicle."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from math import dist, hypot, radians
from random import Random
from statistics import median
from types import FrameType

import msgspec

from companion.config.code_file import raised_in_words
from companion.config.law import LawSection, law_class, law_problems, parameter_problem
from companion.core.consensus.law import LawError
from companion.core.safety.safeguard import SLOW_LAW_S
from companion.laws import FormationState, Law, Neighbour, Own
from companion.laws._trial import MOST_BESIDE_M_S2, MOST_M_S2
from companion.tools.ideal_flight import FLIGHT_S, STEP_S, Placed, fly_ideal_line
from companion.types.values import Vector3

SETTLED_M = 0.1
SAME_M = 1e-6
LONGEST_CHECK_S = 60.0
STATES, CALLS, NEIGHBOURS = 200, 1000, 6


@dataclass(frozen=True, slots=True)
class LawFinding:
    """One thing that was tried: whether the law passed, and what was found."""

    subject: str
    passed: bool
    found: str


def check_law(section: LawSection) -> Iterator[LawFinding]:
    """Everything that is tried, in order; ends after the first that would make the rest meaningless.

    Raises ConfigError where the law cannot be loaded at all.
    """
    cls = law_class(section)
    problem = parameter_problem(cls)
    yield LawFinding("parameters", not problem, problem or ("each has bounds" if cls.__struct_fields__ else "none"))
    if problem:
        return
    for found in law_problems(section, "law"):
        subject = found.field.removeprefix("law.").removeprefix("parameters.")
        yield LawFinding(
            "first calls" if subject in ("file", "name") else subject, False, _without(section.file, found.text)
        )
        return
    law = msgspec.convert(section.parameters, cls)
    for subject, attempt in (
        ("any state", _any_state),
        ("time of a call", _time_of_a_call),
        ("same again", _same_again),
        ("moved", _moved),
        ("turned", _turned),
        ("settles", _settles),
    ):
        finding = _tried(subject, attempt, law)
        yield finding
        if subject in ("any state", "time of a call") and not finding.passed:
            return  # the flights would tell the same, or take minutes


def _tried(subject: str, attempt: Callable[[Law], tuple[bool, str]], law: Law) -> LawFinding:
    try:
        with _time_limit():
            passed, found = attempt(law)
    except TimeoutError:
        return LawFinding(
            subject, False, f"not done after {LONGEST_CHECK_S:g} s; in flight the autopilot's failsafe would act"
        )
    except Exception as error:  # noqa: BLE001 -- the code of a user
        raised = (
            error.__cause__ if isinstance(error, LawError) else None
        )  # what the law itself has raised names its line
        return LawFinding(subject, False, raised_in_words(raised or error))
    return LawFinding(subject, passed, found)


def _without(source: str | None, text: str) -> str:
    return text.removeprefix(f"{source}: ")


def _any_state(law: Law) -> tuple[bool, str]:
    """Finite and bounded: without neighbours, with one at the same place, with many, near and far."""
    random = Random(1)
    largest_m_s2 = 0.0
    for state in range(STATES):
        reach = 1.0 if state % 2 else 300.0
        own = _own(law, random, reach)
        neighbours = [_neighbour(law, random, reach) for _ in range((0, 1, 2, 6, 40)[state // 2 % 5])]
        if neighbours and state % 3 == 0:
            neighbours[0] = Neighbour(own.position_enu_m, own.velocity_enu_m_s, values=neighbours[0].values)
        reference = None if state % 4 < 2 else FormationState(*_state(random, reach))
        wanted_m_s2 = _answer(law, own, neighbours, reference)[0]
        most_m_s2 = MOST_BESIDE_M_S2 if reach == 1.0 else MOST_M_S2
        if not all(-most_m_s2 <= axis <= most_m_s2 for axis in wanted_m_s2):
            text = f"within {reach:g} m it gives {wanted_m_s2} m/s^2; expected numbers up to {most_m_s2:g}"
            return False, text
        if reach == 1.0:
            largest_m_s2 = max(largest_m_s2, hypot(*wanted_m_s2))
    return True, f"finite; up to {largest_m_s2:.3g} m/s^2 within 1 m and 1 m/s of the formation"


def _same_again(law: Law) -> tuple[bool, str]:
    """A law that keeps something between calls answers otherwise in another order."""
    random = Random(2)
    questions = [
        (_own(law, random, 5.0), [_neighbour(law, random, 5.0) for _ in range(3)], FormationState(*_state(random, 5.0)))
        for _ in range(50)
    ]
    order = random.sample(range(len(questions)), len(questions))
    first = [_answer(law, *question) for question in questions]
    again = {i: _answer(law, *questions[i]) for i in order}
    differing = sum(answer != again[i] for i, answer in enumerate(first))
    if differing:
        return (
            False,
            f"{differing} of 50 answers differ when asked again in another order; expected no state but `memory`",
        )
    return True, "50 questions, asked again in another order, have the same answers"


def _moved(law: Law) -> tuple[bool, str]:
    far = Placed(shift_enu_m=(1000.0, -2000.0, 100.0))
    difference_m = _difference_m(law, far)
    if difference_m > SAME_M:
        return (
            False,
            f"2 km away it flies up to {difference_m:.3g} m otherwise; expected differences of positions alone",
        )
    return True, "2 km away it flies the same"


def _turned(law: Law) -> tuple[bool, str]:
    difference_m = max(_difference_m(law, Placed(angle_rad=radians(angle))) for angle in (30.0, 90.0))
    if difference_m > SAME_M:
        text = f"about the vertical by 30 or 90 degrees it flies up to {difference_m:.3g} m otherwise"
        return False, f"{text}; expected x and y treated as one vector"
    return True, "about the vertical by 30 and 90 degrees it flies the same"


def _settles(law: Law) -> tuple[bool, str]:
    flight = _flight(law)
    errors_m = [max(dist(at, slot) for at, slot in row) for row in flight]
    late = [step for step, error_m in enumerate(errors_m) if error_m > SETTLED_M]
    if not late:
        return True, f"five ideal vehicles stay within {SETTLED_M:g} m"
    if late[-1] == len(errors_m) - 1:
        text = f"five ideal vehicles in a line are {errors_m[-1]:.2g} m off after {FLIGHT_S:g} s, {errors_m[0]:.2g} m at first"
        return errors_m[-1] < errors_m[0], text
    return (
        True,
        f"five ideal vehicles in a line are within {SETTLED_M:g} m of their slots after {late[-1] * STEP_S:.1f} s",
    )


def _time_of_a_call(law: Law) -> tuple[bool, str]:
    random = Random(3)
    own, neighbours = _own(law, random, 5.0), [_neighbour(law, random, 5.0) for _ in range(NEIGHBOURS)]
    taken_s = []
    for _ in range(CALLS):
        began_s = time.perf_counter()
        _answer(law, own, neighbours, None)
        taken_s.append(time.perf_counter() - began_s)
        if sum(taken_s) > 2.0:
            break
    usual_us, limit_us = median(taken_s) * 1e6, SLOW_LAW_S * 1e6
    text = f"{usual_us:.0f} us with {NEIGHBOURS} neighbours on this computer; a vehicle allows {limit_us:.0f} us"
    return usual_us < limit_us, text


@lru_cache(maxsize=1)
def _flight(law: Law) -> list[list[tuple[Vector3, Vector3]]]:
    return fly_ideal_line(law, Placed())


def _difference_m(law: Law, placed: Placed) -> float:
    """The largest distance between a flight that is placed otherwise, and the flight, placed likewise."""
    pairs = zip(_flight(law), fly_ideal_line(law, placed), strict=True)
    return max(
        dist(placed.place(here), there)
        for row, other in pairs
        for (here, _), (there, _) in zip(row, other, strict=True)
    )


def _answer(
    law: Law, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None
) -> tuple[Vector3, ...]:
    """All that the law gives, acceleration first."""
    x, y, z = law.acceleration(own, neighbours, reference)
    memory = law.remember(own, neighbours, reference) if law.memory else ()
    return ((x, y, z), *memory, *(law.publish(own, neighbours, reference) if law.publishes else ()))


def _state(random: Random, reach: float) -> tuple[Vector3, Vector3, Vector3]:
    return _vector(random, reach), _vector(random, min(reach, 15.0)), _vector(random, min(reach, 5.0))


def _own(law: Law, random: Random, reach: float) -> Own:
    state, slot = _state(random, reach), _vector(random, 10.0)
    return Own(*state, slot, 0.2, STEP_S, tuple([_vector(random, reach) for _ in range(law.memory)]))


def _neighbour(law: Law, random: Random, reach: float) -> Neighbour:
    state, slot = _state(random, reach), _vector(random, 10.0)
    values = tuple([_vector(random, reach) for _ in range(law.publishes)])
    return Neighbour(*state, random.randint(1, 5), slot, random.uniform(0.0, 0.3), values)


def _vector(random: Random, size: float) -> Vector3:
    return (random.uniform(-size, size), random.uniform(-size, size), random.uniform(-size, size))


@contextmanager
def _time_limit() -> Iterator[None]:
    """Raises TimeoutError in the block once it is over. Main thread only."""

    def end(signal_number: int, frame: FrameType | None) -> None:  # noqa: ARG001
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_CHECK_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
