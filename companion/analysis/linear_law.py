"""Any law as numbers: its derivatives about perfect formation, by differences of the law itself. Without numpy.

In perfect formation all states are equal, and memories and values are zero. One step of each input suffices where a law is
linear: a step of all inputs at once shows whether it is. Where it is not (it saturates, trims, or weighs by distance), smaller
steps tell what it does near the formation, and `remarks` says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite

from companion.config.code_file import raised_in_words
from companion.config.file import ConfigError
from companion.laws import FormationState, Law, Neighbour, Own
from companion.types.values import ZERO3, Vector3

STATES = 3  # position, velocity, acceleration: what comes before memory and values in a row
STEP, SMALL_STEP = 1.0, 1e-3  # m, m/s, m/s^2, or of a memory or value
AXES: Vector3 = (1.0, -0.5, 0.25)  # shares of a step on x, y and z: powers of two, so that exact laws remain exact
EXACT, CLOSE = 1e-9, 1e-4  # relative tolerance of the two steps
MOST_LAWS = 4096
NEAR = f"not linear: its figures hold near the formation, where it is probed with steps of {SMALL_STEP:g} m"
NOWHERE = "not linear even near the formation: its figures are of one input at a time"
ALONG_X = "its axes differ or affect each other: its figures are of x alone"
X: Vector3 = (1.0, 0.0, 0.0)
TRIALS: tuple[tuple[float, Vector3, tuple[str, ...]], ...] = (
    (STEP, AXES, ()),
    (SMALL_STEP, AXES, (NEAR,)),
    (STEP, X, (ALONG_X,)),
    (SMALL_STEP, X, (ALONG_X, NEAR)),
)

Row = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class LinearLaw:
    """What each input adds to each output. Outputs: the acceleration, each vector remembered, each value published.

    A row of `own` is of own position, velocity, acceleration and memories; one of a neighbour of its position, velocity,
    acceleration and values; one of `reference` of r, r', r''. What is published refers to the command and memory of its tick.
    """

    own: tuple[Row, ...]
    neighbours: tuple[tuple[Row, ...], ...]
    reference: tuple[Row, ...]
    remarks: tuple[str, ...]


def linearised(
    law: Law, leads: bool, prcs: Sequence[int], slots_enu_m: Sequence[Vector3], drag_1_s: float = 0.0
) -> LinearLaw:
    """The law of a vehicle with neighbours of these PrCs. `slots_enu_m` are its own slot, then theirs.

    Raises ConfigError where the law raises an exception, or gives something else than it has to.
    """
    case = _Case(law.near_formation(), leads, tuple(prcs), drag_1_s)
    return _linearised(case, tuple(slots_enu_m) if _reads_slots(case) else _spread(len(prcs)))


@dataclass(frozen=True, slots=True)
class _Case:
    law: Law
    leads: bool
    prcs: tuple[int, ...]
    drag_1_s: float

    def inputs(self) -> int:
        law, states = self.law, STATES
        return states + law.memory + len(self.prcs) * (states + law.publishes) + states * self.leads

    def outputs(self, at: Sequence[Vector3], slots: Sequence[Vector3], own_type: type[Own] = Own) -> list[Vector3]:
        """Acceleration, memory and values with these inputs. Raises ConfigError."""
        law, memory, width = self.law, self.law.memory, STATES + self.law.publishes
        position, velocity, acceleration = at[:STATES]
        own = own_type(
            position, velocity, acceleration, slots[0], self.drag_1_s, memory=tuple(at[STATES : STATES + memory])
        )
        neighbours, first = [], STATES + memory
        neighbour_type = Neighbour if own_type is Own else _SeenNeighbour
        for prc, slot in zip(self.prcs, slots[1:], strict=True):
            x, v, a, *values = at[first : first + width]
            neighbours.append(neighbour_type(x, v, a, prc, slot, values=tuple(values)))
            first += width
        reference = FormationState(*at[first:]) if self.leads else None
        try:
            found = [law.acceleration(own, neighbours, reference)]
            found += _vectors(law.remember(own, neighbours, reference), memory) if memory else ()
            found += _vectors(law.publish(own, neighbours, reference), law.publishes) if law.publishes else ()
            return [(float(x), float(y), float(z)) for x, y, z in _vectors(found, len(found))]
        except Exception as error:
            raise ConfigError(f"law {type(law).__name__}", "", raised_in_words(error)) from error


def _vectors(found: Sequence[Vector3], count: int) -> Sequence[Vector3]:
    if len(found) != count or not all(len(v) == 3 and isfinite(v[0] + v[1] + v[2]) for v in found):
        raise ValueError(f"gives {found!r:.80}; expected {count} vectors of three finite numbers")
    return found


class _SeenOwn(Own, frozen=True, gc=False):
    def __getattribute__(self, name: str) -> object:
        _seen(name)
        return super().__getattribute__(name)


class _SeenNeighbour(Neighbour, frozen=True, gc=False):
    def __getattribute__(self, name: str) -> object:
        _seen(name)
        return super().__getattribute__(name)


_read: list[str] = []


def _seen(name: str) -> None:
    if name == "slot_enu_m":
        _read.append(name)


def _spread(neighbours: int) -> tuple[Vector3, ...]:
    """Slots that are apart, for laws that do not read them."""
    return tuple([(2.0 * k, 1.5 * (k % 2), 0.5 * (k % 3)) for k in range(neighbours + 1)])


@lru_cache(maxsize=MOST_LAWS)
def _reads_slots(case: _Case) -> bool:
    """Whether the law asks for slots. Most do not, and then vehicles with the same PrCs around them are alike."""
    _read.clear()
    case.outputs([ZERO3] * case.inputs(), _spread(len(case.prcs)), _SeenOwn)
    return bool(_read)


@lru_cache(maxsize=MOST_LAWS)
def _linearised(case: _Case, slots: tuple[Vector3, ...]) -> LinearLaw:
    remarks: tuple[str, ...] = (NOWHERE,)
    for step, axes, such in TRIALS:
        columns = _columns(case, slots, step, axes)
        if _adds_up(case, slots, columns, step, axes):
            remarks = such
            break
    rows = _without_unused_memory(list(zip(*columns, strict=True)), case.law.memory)  # by output
    law, first = case.law, STATES + case.law.memory
    width, last = STATES + law.publishes, len(columns) - STATES * case.leads
    return LinearLaw(
        own=tuple([row[:first] for row in rows]),
        neighbours=tuple([tuple([row[k : k + width] for row in rows]) for k in range(first, last, width)]),
        reference=tuple([row[last:] if case.leads else (0.0,) * STATES for row in rows]),
        remarks=remarks,
    )


def _without_unused_memory(rows: list[Row], memory: int) -> list[Row]:
    """Memory that nothing else depends on and that does not grow by itself, like a counter, is zero here.

    It never decays, and need not for the errors to decay.
    """
    used = {0, *range(1 + memory, len(rows))}  # outputs: acceleration, and values
    while more := {1 + m for m in range(memory) if any(rows[output][STATES + m] for output in used)} - used:
        used |= more
    grows = any(sum(map(abs, rows[k][STATES : STATES + memory])) > 1.0 for k in range(1, 1 + memory) if k not in used)
    return rows if grows else [row if k in used else (0.0,) * len(row) for k, row in enumerate(rows)]


def _columns(case: _Case, slots: Sequence[Vector3], step: float, axes: Vector3) -> list[Row]:
    """What a step of each input adds to x of each output, by input: over the step, and on both sides where it is small."""
    columns = []
    at = [ZERO3] * case.inputs()
    rest = case.outputs(at, slots)
    for k in range(len(at)):
        at[k] = _along(axes, step)
        up, down = case.outputs(at, slots), rest
        over = step
        if step == SMALL_STEP:
            at[k], over = _along(axes, -step), 2.0 * step
            down = case.outputs(at, slots)
        at[k] = ZERO3
        columns.append(tuple([(a[0] - b[0]) / over / axes[0] for a, b in zip(up, down, strict=True)]))
    return columns


def _adds_up(case: _Case, slots: Sequence[Vector3], columns: Sequence[Row], step: float, axes: Vector3) -> bool:
    """Whether steps of all inputs at once, other ones on each axis, give the sum of what each one gives, to both sides."""
    sizes = [_along(axes, step * (-1.0) ** k / (1.0 + k % 5)) for k in range(len(columns))]
    rest = case.outputs([ZERO3] * len(columns), slots)
    for sign in (1.0, -1.0):
        at = [(sign * x, sign * y * (1.0 + k % 2), sign * z * (1.0 + k % 3)) for k, (x, y, z) in enumerate(sizes)]
        moved = case.outputs(at, slots)
        if not all(_is_sum(columns, at, step, axes, k, one, rest[k]) for k, one in enumerate(moved)):
            return False
    return True


def _is_sum(
    columns: Sequence[Row],
    at: Sequence[Vector3],
    step: float,
    axes: Vector3,
    output: int,
    moved: Vector3,
    rest: Vector3,
) -> bool:
    tolerance = EXACT if step == STEP else CLOSE
    for axis in [k for k in range(3) if axes[k]]:
        parts = [column[output] * vector[axis] for column, vector in zip(columns, at, strict=True)]
        if abs(moved[axis] - rest[axis] - sum(parts)) > tolerance * (step + sum(map(abs, parts))):
            return False
    return True


def _along(axes: Vector3, step: float) -> Vector3:
    return (axes[0] * step, axes[1] * step, axes[2] * step)
