"""Draws one flight of the gauntlet. Its number decides its family; seed and number decide everything else."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from math import cos, pi, sin
from pathlib import Path
from random import Random
from typing import Any, Self

from companion.config.file import ConfigError
from companion.config.fleet import FleetConfig
from companion.types.autopilot import AutopilotKind
from companion.types.errors import CompanionError
from sitl.flight.flights import DivergesError, check_convergence
from sitl.flight.scenario import Scenario, scenario_from
from sitl.gauntlet.anything import ANYTHING, SEARCHED
from sitl.gauntlet.families import FAMILIES, FORM_S, FamilyPlan, step
from sitl.gauntlet.faults import COMBINED, FAULTS
from sitl.gauntlet.fleets import START_SPACING, DrawnFleet, SensorsName, random_fleet, sections, to_thousandth
from sitl.gauntlet.liars import LIARS

RUNAWAY_EVERY = 10
SEEN_S = 1.0  # a runaway has its speed, and the others have received it
RUNAWAY_M_S = (0.3, 2.0)
DRAWS = 200
NAMES = tuple(FAMILIES)
FAULT_NAMES = tuple(FAULTS)
LIAR_NAMES = tuple(LIARS)
FAULTS_FROM = 1_000_000
"""Number of the first flight of FAULTS: those of the other families keep the numbers, and thus the bits, of before."""
COMBINED_FROM, LIARS_FROM, ANYTHING_FROM = 2_000_000, 3_000_000, 4_000_000  # likewise
ONLY_SEARCHED = {COMBINED: COMBINED_FROM, ANYTHING: ANYTHING_FROM}  # numbers of the first flights


class Chosen(Random):
    """Draws the given numbers, 0 to 1, in their order, then random ones: each draw of a family can be searched over."""

    def __new__(cls, _seed: str, _choices: Sequence[float]) -> Self:
        return super().__new__(cls)

    def __init__(self, seed: str, choices: Sequence[float]) -> None:
        super().__init__(seed)
        self._left = iter(choices)

    def random(self) -> float:
        given = next(self._left, None)
        return super().random() if given is None else given

    def _randbelow(self, n: int) -> int:
        """What choice, sample, shuffle and randrange call; a neighbouring number chooses the same or the next item."""
        return int(self.random() * n)


@dataclass(frozen=True, slots=True)
class Drawn:
    """A flight before it is flown.

    `expected`: the vehicles that are to be in their slots at the end. `handed_over`: those that fly by their autopilots only
    where their agents chose to hand over, so that pairs of them count then as well.
    """

    number: int
    family: str
    scenario: Scenario
    expected: tuple[int, ...]
    slots_from_s: float
    ends_s: float
    runaway: int | None
    handed_over: frozenset[int]


class ImpossibleFlightError(CompanionError):
    """No draw gave a flight that vehicles accept. str() names the last refusal."""


def family_of(number: int) -> str:
    """The family of a flight; it depends on its number alone."""
    if number < FAULTS_FROM:
        return NAMES[number % len(NAMES)]
    if number >= ANYTHING_FROM:
        return ANYTHING
    if number >= LIARS_FROM:
        return LIAR_NAMES[(number - LIARS_FROM) % len(LIAR_NAMES)]
    if number >= COMBINED_FROM:
        return COMBINED
    return FAULT_NAMES[(number - FAULTS_FROM) % len(FAULT_NAMES)]


def numbers_of(families: Collection[str]) -> Iterator[int]:
    """Numbers of flights of these families: in turn as many of each."""
    for turn in count():
        others = range(turn * len(NAMES), (turn + 1) * len(NAMES))
        faults = range(FAULTS_FROM + turn * len(FAULT_NAMES), FAULTS_FROM + (turn + 1) * len(FAULT_NAMES))
        liars = range(LIARS_FROM + turn * len(LIAR_NAMES), LIARS_FROM + (turn + 1) * len(LIAR_NAMES))
        yield from (number for number in (*others, *faults, *liars) if family_of(number) in families)


def has_runaway(number: int) -> bool:
    """Not beside a liar: a runaway is one whose words are true. `anything` has pilots of its own."""
    return number < LIARS_FROM and number % RUNAWAY_EVERY == RUNAWAY_EVERY - 1


def draw_flight(
    seed: int,
    number: int,
    sensors: SensorsName | None = None,
    own: FleetConfig | None = None,
    choices: Sequence[float] = (),
) -> Drawn:
    """The flight with this seed and number, of a user's own fleet if one is given. Raises ImpossibleFlightError.

    The first draws are `choices`.
    """
    source, last = f"{seed} {number} gauntlet", ""
    random = Chosen(source, choices) if choices else Random(source)
    for _ in range(DRAWS):
        fleet = random_fleet(random, sensors, own)
        plan = SEARCHED[family_of(number)](random, fleet)
        content, runaway = _content(random, fleet, plan, has_runaway(number))
        content["description"] = f"Flight {number} of the gauntlet with seed {seed}, {family_of(number)}."
        try:
            scenario = scenario_from(Path(f"flight {number}"), content)
            check_convergence(scenario)
        except (ConfigError, DivergesError) as error:
            last = str(error)
            continue
        expected = plan.expected if plan.expected is not None else fleet.ids
        arrives = tuple(i for i in expected if i != runaway and (i not in plan.stays_out or _joins(plan, i)))
        times_s = (to_thousandth(FORM_S + plan.slots_from_s), to_thousandth(FORM_S + plan.lasts_s))
        handed_over = _not_taken(scenario) if plan.judges_hand_over else frozenset()
        return Drawn(number, family_of(number), scenario, arrives, *times_s, runaway, handed_over)
    raise ImpossibleFlightError(f"no draw of flight {number} with seed {seed} can be flown: {last}")


def _not_taken(scenario: Scenario) -> frozenset[int]:
    """The vehicles that no pilot takes over and that know their positions; no ArduCopter whose telemetry is late.

    It drifts, as it waits for setpoints, and its agent does not know whether a pilot has taken over.
    """
    taken = {pilot.vehicle for pilot in scenario.stand_in.pilots}
    taken |= {loss.vehicle for loss in scenario.stand_in.position_losses}
    if scenario.stand_in.autopilot is AutopilotKind.ARDUPILOT:
        taken |= {late.vehicle for late in scenario.links.late_telemetry}
    return frozenset(member.id for member in scenario.fleet.vehicles if member.id not in taken)


def _joins(plan: FamilyPlan, vehicle_id: int) -> bool:
    return any(one["command"] == "form" and vehicle_id in one.get("vehicles", ()) for one in plan.steps)


def _content(
    random: Random, fleet: DrawnFleet, plan: FamilyPlan, with_runaway: bool
) -> tuple[dict[str, Any], int | None]:
    """The scenario as plain content, and the runaway vehicle."""
    stays_out, runaway, pilots = set(plan.stays_out), None, []
    without_gps = {loss["vehicle"] for loss in plan.stand_in.get("position_losses", ())}
    others = {fleet.successor, *stays_out, *without_gps}
    free = [i for i in fleet.followers if i not in others]
    if with_runaway and free:
        runaway = random.choice(free)
        pilot, from_outside = _pilot(random, fleet, runaway)
        pilots.append(pilot | {"at_s": _seen_at_s(pilot["at_s"], plan)})
        stays_out |= {runaway} if from_outside else set()
        plan.steps = [_without(one, runaway) for one in plan.steps]
    content = sections(fleet, random)
    if fleet.own is None:
        content["fleet"]["formation_heading"] = "course" if plan.turns else "fixed"
    content["reference"] = plan.reference
    content["stand_in"] |= plan.stand_in | {"pilots": [*plan.stand_in.get("pilots", ()), *pilots]}
    content["links"] |= plan.links | {"partitions": plan.partitions}
    for path, value in plan.settings.items():
        _set(content["fleet"], path, value)
    content["agent_ends"] = plan.agent_ends
    forming = [i for i in fleet.ids if i not in stays_out]
    content["timeline"] = [
        {"command": "prepare"},
        {"command": "arm"},
        {"command": "takeoff"},
        step("form", 0.0, vehicles=forming if stays_out else None),
        *plan.steps,
    ]
    _end(content["timeline"], FORM_S + plan.lasts_s)
    return content, runaway


def _set(section: dict[str, Any], path: str, value: object) -> None:
    first, _, rest = path.partition(".")
    if rest:
        _set(section.setdefault(first, {}), rest, value)
    else:
        section[first] = value


def _without(one: dict[str, Any], runaway: int) -> dict[str, Any]:
    """The step without the runaway vehicle, which no command concerns."""
    vehicles = [i for i in one.get("vehicles", ()) if i != runaway]
    return one | {"vehicles": vehicles} if vehicles else one


def _pilot(random: Random, fleet: DrawnFleet, runaway: int) -> tuple[dict[str, Any], bool]:
    """The pilot of the runaway vehicle, and whether it comes from outside the formation."""
    speed_m_s, from_outside = random.uniform(*RUNAWAY_M_S), random.random() < 0.7
    angle_rad = random.uniform(0.0, 2.0 * pi)
    if from_outside:
        others = [start for i, start in fleet.starts_enu_m.items() if i != runaway]
        aim = random.choice(others)
        away_m = random.uniform(4.0, 8.0)
        while True:
            x, y = aim[0] + away_m * cos(angle_rad), aim[1] + away_m * sin(angle_rad)
            if all(abs(complex(x - a, y - b)) > 2.0 * START_SPACING * fleet.separation_m for a, b, _ in others):
                break
            away_m += 0.5
        fleet.starts_enu_m[runaway] = (to_thousandth(x), to_thousandth(y), 0.0)
        angle_rad += pi + random.uniform(-0.1, 0.1)
    velocity = [to_thousandth(speed_m_s * cos(angle_rad)), to_thousandth(speed_m_s * sin(angle_rad)), 0.0]
    at_s = to_thousandth(FORM_S + random.uniform(2.0 if from_outside else 5.0, 9.0))
    return {"vehicle": runaway, "at_s": at_s, "velocity_enu_m_s": velocity}, from_outside


def _seen_at_s(at_s: float, plan: FamilyPlan) -> float:
    """When the pilot takes over: not while a partition may hide from the others that the vehicle begins to move."""
    for split in plan.partitions:
        if split["from_s"] - SEEN_S < at_s < split["until_s"]:
            return to_thousandth(split["until_s"] + SEEN_S)
    return at_s


def _end(timeline: list[dict[str, Any]], ends_s: float) -> None:
    """The last step lasts until the end of the flight."""
    last = timeline[-1]
    last["for_s"] = to_thousandth(max(ends_s - last["at_s"], 0.0))
