"""The formation laws of a batch: asked as `companion.core.consensus.law` asks them, but about many vehicles at once.

Vehicles with the same class of law, the same role and as many neighbours are asked about together: each number of `Own`,
`Neighbour` and the reference is an array then, and so is a parameter in which their laws differ. A law that cannot take arrays,
or gives something else for them, is asked about one vehicle after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, pairwise
from math import inf
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from msgspec.structs import replace

from companion.analysis.interaction import FloatArray
from companion.config.code_file import raised_in_words
from companion.config.law import law_of
from companion.core.consensus.kept_off import target
from companion.core.consensus.law import SHORTEST_STEP_S, STEP_S, finite_vectors
from companion.laws import FormationState, Law, Neighbour, Own
from companion.laws._trial import MOST_M_S2
from companion.types.flight import Role
from companion.types.values import MAX_COORDINATE_M
from sitl.batch.columns import BoolArray, Columns, IntArray
from sitl.batch.packets import PRC, STATE, VALUES, Packets, ReceivedPackets
from sitl.flight.files import known_drag_1_s
from sitl.flight.scenario import Scenario

# Rows of what a vehicle knows of itself: position minus slot, velocity, command, slot, drag, step, and what it remembers.
DRAG, STEP, MEMORY = 12, 13, 14
SAMPLE = 16  # vehicles for which a law is asked both ways, once for each number of neighbours
SHIFT = 1.0  # m, m/s and so on: a formation in its slots tells nothing of a law
SAME = 1e-9
FEW = 8  # so many vehicles are asked about sooner one by one; with more neighbours than that they are a cohort of their own
FloatRows: TypeAlias = tuple[list[float], list[list[float]], list[float]]  # own, neighbours, reference; of one vehicle


class Question(NamedTuple):
    """What a law is asked: how an answer reads in a message, the method, how many vectors it gives, and up to what."""

    verb: str
    ask: Callable[[Law, Own, Sequence[Neighbour], FormationState | None], Sequence[Any]]
    vectors: Callable[[Law], int]
    most: float


U = Question("gives the acceleration", lambda law, *known: (law.acceleration(*known),), lambda _: 1, MOST_M_S2)
REMEMBER = Question("remembers", lambda law, *known: law.remember(*known), lambda law: law.memory, inf)
PUBLISH = Question("publishes", lambda law, *known: law.publish(*known), lambda law: law.publishes, MAX_COORDINATE_M)


@dataclass(slots=True)
class LawKind:
    """Laws of one class in one role that differ in real numbers alone.

    `laws` by formation. `differing`: fields that do, with the value of each formation (B,).
    """

    laws: dict[int, Law]
    leads: bool
    differing: dict[str, FloatArray]
    in_arrays: bool = True
    agreed: set[tuple[str, int]] = field(default_factory=set)  # questions and numbers of neighbours

    @property
    def first(self) -> Law:
        """Any of them."""
        return next(iter(self.laws.values()))

    def law(self, formations: IntArray) -> Law:
        """The law of vehicles of these formations (G,)."""
        if not self.differing:
            return self.first
        return replace(self.first, **{name: values[formations] for name, values in self.differing.items()})


class Cohort(NamedTuple):
    """Vehicles `begin` to `end` of a sorted group, with `seen` neighbours each, the first ones from `first` on.

    Of a law that weighs its neighbours some vehicles have fewer: the others have an infinite PrC.
    """

    kind: LawKind
    begin: int
    end: int
    seen: int
    first: int


@dataclass(slots=True)
class Known:
    """What the vehicles of a group know, sorted into `cohorts`: a row for each number, the last axis is the vehicles.

    `columns` (G,) and `places` (G,) in the group. `own` (rows, G). `neighbours` (rows, P) as packets: for each cohort those of
    all its vehicles that are first in rising order of ids, then the second. `reference` (9, G).
    """

    columns: IntArray
    places: IntArray
    cohorts: list[Cohort]
    own: FloatArray
    neighbours: FloatArray
    reference: FloatArray

    def together(self, law: Law, cohort: Cohort, end: int) -> tuple[Own, list[Neighbour], FormationState | None]:
        """What vehicles up to `end` of this cohort know, in arrays that the law cannot change."""
        size, vehicles = cohort.end - cohort.begin, slice(cohort.begin, end)
        firsts = range(cohort.first, cohort.first + cohort.seen * size, size)
        neighbours = [list(self.neighbours[:, at : at + end - cohort.begin]) for at in firsts]
        own, reference = list(self.own[:, vehicles]), list(self.reference[:, vehicles])
        return _arguments(law, cohort.kind.leads, own, neighbours, reference)

    def of_each(self, cohort: Cohort, begin: int, end: int) -> Iterator[FloatRows]:
        """What each of the vehicles `begin` to `end` of this cohort knows, in floats."""
        size, seen, first = cohort.end - cohort.begin, cohort.seen, cohort.first
        packets = self.neighbours[:, first : first + seen * size].reshape(len(self.neighbours), seen, size)
        packets = packets[:, :, begin - cohort.begin : end - cohort.begin].transpose(2, 1, 0)
        own, reference = self.own[:, begin:end].T, self.reference[:, begin:end].T
        return zip(own.tolist(), packets.tolist(), reference.tolist(), strict=True)

    def alone(self, law: Law, cohort: Cohort, vehicle: int) -> tuple[Own, list[Neighbour], FormationState | None]:
        """What one vehicle knows, as its law is asked with it."""
        (rows,) = self.of_each(cohort, vehicle, vehicle + 1)
        return _of_floats(law, cohort.kind.leads, rows)

    def shifted(self, by: float) -> Known:
        """Other numbers, but for PrC."""
        arrays = [a + by * np.sin(np.arange(a.size, dtype=np.float64)).reshape(a.shape) for a in self._arrays]
        arrays[1][PRC] = self.neighbours[PRC]
        return Known(self.columns, self.places, self.cohorts, *arrays)

    def locked(self) -> Known:
        """The same. A law that changes an array in place fails, instead of changing what others know."""
        for array in self._arrays:
            array.setflags(write=False)
        return self

    @property
    def _arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.own, self.neighbours, self.reference


class BatchLaws:
    """The laws of all columns, what they remember, and which formations they have failed.

    `memory` and `values`: the most vectors that any of them remembers or publishes. `failures`: what happened, by formation;
    its vehicles are not asked about any more, and fly without an acceleration. `remarks`: why a formation is not asked about in
    arrays.
    """

    def __init__(self, scenarios: Sequence[Scenario], columns: Columns, slot_enu_m: FloatArray) -> None:
        self._columns = columns
        self._formation: list[int] = columns.formation.tolist()
        self._ids = [sorted(member.id for member in scenario.fleet.vehicles) for scenario in scenarios]
        laws = {b: law_of(scenario.fleet.law) for b, scenario in enumerate(scenarios)}
        self.memory = max(law.memory for law in laws.values())
        self.values = max(law.publishes for law in laws.values())
        self.is_leader = is_leader(scenarios, columns)
        self._kinds: list[LawKind] = []
        self._kind = np.zeros(columns.count, dtype=np.int64)  # -1: not asked about
        for alike in _alike(laws):
            for leads in (False, True):
                self._kind[np.isin(columns.formation, list(alike)) & (self.is_leader == leads)] = len(self._kinds)
                self._kinds.append(LawKind(alike, leads, _differing(alike, len(scenarios))))
        self._weighs = np.array([kind.first.weighs for kind in self._kinds])
        drag_1_s = columns.spread([known_drag_1_s(scenario) for scenario in scenarios])
        self._constant = np.vstack([slot_enu_m, drag_1_s])
        self._memory = np.zeros((3 * self.memory, columns.count))
        self.failures: dict[int, str] = {}
        self.remarks: dict[int, str] = {}

    def known(
        self,
        group: slice,
        state: FloatArray,
        used: ReceivedPackets,
        packets: Packets,
        reference: FloatArray,
    ) -> Known:
        """`state` (9, G) with the last command, `reference` (9, G). The packets in use are the first of their rows."""
        kinds, counts = self._kind[group], used.fresh.sum(axis=1)
        key = kinds * (used.fresh.shape[1] + 1) + np.where(self._weighs[kinds], counts > FEW, counts)
        places = np.argsort(key, kind="stable")
        key, counts, indices, age_s = key[places], counts[places], used.indices[places], used.age_s[places]
        ends = [0, *(np.flatnonzero(np.diff(key)) + 1).tolist(), key.size]
        cohorts: list[Cohort] = []
        rows, ages_s, absent = [np.zeros(0, dtype=np.int64)], [np.zeros(0)], [np.zeros(0, dtype=np.bool_)]
        first = 0
        for begin, end in pairwise(ends):
            kind, count = int(kinds[places[begin]]), int(counts[begin:end].max())
            if kind < 0:
                continue
            cohorts.append(Cohort(self._kinds[kind], begin, end, count, first))
            rows.append(indices[begin:end, :count].T.ravel())
            ages_s.append(age_s[begin:end, :count].T.ravel())
            absent.append((np.arange(count)[:, None] >= counts[begin:end]).ravel())
            first += count * (end - begin)
        columns = places + group.start
        step_s = np.full((1, places.size), STEP_S)
        own = np.concatenate([state[:, places], self._constant[:, columns], step_s, self._memory[:, columns]])
        neighbours = packets.extrapolated(np.concatenate(rows), np.concatenate(ages_s))
        neighbours[PRC, np.concatenate(absent)] = inf
        return Known(columns, places, cohorts, own, neighbours, reference[:, places]).locked()

    def accelerations(self, known: Known) -> FloatArray:
        """u_i (3, G) in ENU before any limit. The laws remember."""
        accelerations = self._answers(U, known, 3)
        if self.memory:
            self._memory[:, known.columns] = self._answers(REMEMBER, known, 3 * self.memory)[:, known.places]
        return accelerations

    def target(self, known: Known, place: int) -> FormationState | None:
        """The RFT that the law of a vehicle steers to, by its place in the group."""
        vehicle = int(np.flatnonzero(known.places == place)[0])
        for cohort in known.cohorts:
            if cohort.begin <= vehicle < cohort.end:
                law = cohort.kind.laws[int(self._columns.formation[known.columns[vehicle]])]
                return target(law, *known.alone(law, cohort, vehicle)[1:])
        return None

    def published(self, known: Known, state: FloatArray) -> FloatArray:
        """What the laws publish in this state (9, G) with the new command; `known` is what `accelerations` had."""
        if not self.values:
            return np.zeros((0, known.places.size))
        own = known.own.copy()
        own[STATE], own[STEP] = state[:, known.places], SHORTEST_STEP_S
        own[MEMORY:] = self._memory[:, known.columns]
        after = Known(known.columns, known.places, known.cohorts, own, known.neighbours, known.reference)
        return self._answers(PUBLISH, after.locked(), 3 * self.values)

    def _answers(self, question: Question, known: Known, rows: int) -> FloatArray:
        """(rows, G) in the order of the group; zeros of vehicles that are not asked about."""
        answers = np.zeros((rows, known.places.size))
        with np.errstate(all="ignore"):
            for cohort in known.cohorts:
                if vectors := question.vectors(cohort.kind.first):
                    self._answer(question, known, cohort, answers[: 3 * vectors, cohort.begin : cohort.end])
        if not _flyable(answers, question.most).all():
            self._answer_again(question, known, answers)
        in_order = np.empty_like(answers)
        in_order[:, known.places] = answers
        return in_order

    def _answer(self, question: Question, known: Known, cohort: Cohort, answers: FloatArray) -> None:
        """Into `answers` (rows, vehicles of this cohort)."""
        kind = cohort.kind
        if kind.in_arrays and cohort.end - cohort.begin > FEW:
            try:
                if (question.verb, cohort.seen) not in kind.agreed:
                    self._compare(question, known, cohort, len(answers))
                self._together(question, known, cohort, cohort.end, answers)
                return
            except Exception as error:  # noqa: BLE001 -- the code of a user
                self._fly_alone(kind, error)
        rows = known.of_each(cohort, cohort.begin, cohort.end)
        of_each = [
            self._answer_alone(question, kind, column, one, len(answers) // 3)
            for column, one in zip(known.columns[cohort.begin : cohort.end].tolist(), rows, strict=True)
        ]
        answers[:] = np.array(of_each).T

    def _answer_again(self, question: Question, known: Known, answers: FloatArray) -> None:
        """About the vehicles whose answers cannot be flown, to tell why."""
        for cohort in known.cohorts:
            rows = answers[: 3 * question.vectors(cohort.kind.first), cohort.begin : cohort.end]
            for place in np.flatnonzero(~_flyable(rows, question.most).all(axis=0)).tolist():
                vehicle = cohort.begin + place
                (one,) = known.of_each(cohort, vehicle, vehicle + 1)
                rows[:, place] = self._answer_alone(
                    question, cohort.kind, int(known.columns[vehicle]), one, len(rows) // 3
                )

    def _answer_alone(
        self, question: Question, kind: LawKind, column: int, rows: FloatRows, vectors: int
    ) -> tuple[float, ...]:
        try:
            return self._alone(question, kind, column, rows, vectors)
        except Exception as error:  # noqa: BLE001 -- the code of a user
            self._fail(column, error)
            return (0.0,) * (3 * vectors)

    def _together(self, question: Question, known: Known, cohort: Cohort, end: int, answers: FloatArray) -> None:
        """Into `answers` (rows, vehicles up to `end`)."""
        law = cohort.kind.law(self._columns.formation[known.columns[cohort.begin : end]])
        row = iter(answers)
        for x, y, z in question.ask(law, *known.together(law, cohort, end)):
            next(row)[:], next(row)[:], next(row)[:] = x, y, z
        if next(row, None) is not None:
            raise ValueError("too few vectors")

    def _alone(
        self, question: Question, kind: LawKind, column: int, rows: FloatRows, vectors: int
    ) -> tuple[float, ...]:
        law = kind.laws[self._formation[column]]
        found = question.ask(law, *_of_floats(law, kind.leads, rows))
        return tuple(chain.from_iterable(finite_vectors(tuple(found), vectors, question.most, question.verb)))

    def _compare(self, question: Question, known: Known, cohort: Cohort, rows: int) -> None:
        """Raises ValueError where arrays give something else than floats, for the states of now and others."""
        end = min(cohort.end, cohort.begin + SAMPLE)
        in_arrays = np.empty((rows, end - cohort.begin))
        for numbers in (known, known.shifted(SHIFT).locked()):
            self._together(question, numbers, cohort, end, in_arrays)
            columns = known.columns[cohort.begin : end].tolist()
            of_each = numbers.of_each(cohort, cohort.begin, end)
            for place, (column, one) in enumerate(zip(columns, of_each, strict=True)):
                try:
                    alone = self._alone(question, cohort.kind, column, one, rows // 3)
                except Exception:  # noqa: BLE001 -- it may be undefined there
                    continue
                if not np.allclose(in_arrays[:, place], alone, rtol=SAME, atol=SAME):
                    raise ValueError("arrays give other results than numbers")
        cohort.kind.agreed.add((question.verb, cohort.seen))

    def _fly_alone(self, kind: LawKind, error: Exception) -> None:
        kind.in_arrays = False
        text = f"flown vehicle by vehicle, slower and with the same result, as it takes no arrays ({raised_in_words(error)})"
        self.remarks |= dict.fromkeys(kind.laws, text)

    def _fail(self, column: int, error: Exception) -> None:
        """End a formation as an agent ends, whose law fails."""
        formation = int(self._columns.formation[column])
        vehicle = int(self._columns.order[column]) % self._columns.vehicles
        self.failures.setdefault(formation, f"vehicle {self._ids[formation][vehicle]}: {raised_in_words(error)}")
        self._kind[self._columns.formation == formation] = -1


def is_leader(scenarios: Sequence[Scenario], columns: Columns) -> BoolArray:
    """Whether each column leads (B n,)."""
    members = [sorted(scenario.fleet.vehicles, key=lambda member: member.id) for scenario in scenarios]
    leaders = np.array([[float(member.role is Role.LEADER) for member in row] for row in members])
    return np.asarray(columns.in_columns(leaders)[0] > 0.0)


def _alike(laws: dict[int, Law]) -> Iterator[dict[int, Law]]:
    """Laws of one class that differ in real numbers alone."""
    alike: dict[tuple[object, ...], dict[int, Law]] = {}
    for b, law in laws.items():
        fixed = [repr(value) for name in law.__struct_fields__ if type(value := getattr(law, name)) is not float]
        alike.setdefault((type(law), *fixed), {})[b] = law
    yield from alike.values()


def _differing(laws: dict[int, Law], formations: int) -> dict[str, FloatArray]:
    one = next(iter(laws.values()))
    differing = [name for name in one.__struct_fields__ if len({repr(getattr(law, name)) for law in laws.values()}) > 1]
    of = [laws.get(b, one) for b in range(formations)]
    return {name: np.array([getattr(law, name) for law in of], dtype=np.float64) for name in differing}


def _flyable(answers: FloatArray, most: float) -> BoolArray:
    return np.asarray(np.isfinite(answers) & (np.abs(answers) <= most))


def _of_floats(law: Law, leads: bool, rows: FloatRows) -> tuple[Own, list[Neighbour], FormationState | None]:
    """What a law is asked with about one vehicle. An infinite PrC is no neighbour."""
    own, neighbours, reference = rows
    neighbours = [one for one in neighbours if one[PRC] < inf]
    for one in neighbours:
        one[PRC] = int(one[PRC])
    return _arguments(law, leads, own, neighbours, reference)


def _arguments(
    law: Law, leads: bool, own: Sequence[Any], neighbours: Sequence[Sequence[Any]], reference: Sequence[Any]
) -> tuple[Own, list[Neighbour], FormationState | None]:
    """What a law is asked with, of rows of arrays or floats."""
    position, velocity, acceleration, slot = _vectors(own[:DRAG])
    memory = _vectors(own[MEMORY : MEMORY + 3 * law.memory])
    return (
        Own(position, velocity, acceleration, slot, own[DRAG], own[STEP], memory),
        [_neighbour(*one[: VALUES + 3 * law.publishes]) for one in neighbours],
        FormationState(*_vectors(reference)) if leads else None,
    )


def _neighbour(
    x: Any,
    y: Any,
    z: Any,
    vx: Any,
    vy: Any,
    vz: Any,
    ax: Any,
    ay: Any,
    az: Any,
    prc: Any,
    sx: Any,
    sy: Any,
    sz: Any,
    age: Any,
    *values: Any,
) -> Neighbour:
    return Neighbour((x, y, z), (vx, vy, vz), (ax, ay, az), prc, (sx, sy, sz), age, _vectors(values) if values else ())


def _vectors(rows: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(zip(rows[::3], rows[1::3], rows[2::3], strict=True))
