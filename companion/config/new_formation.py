"""A consistent formation from a few choices: slots, neighbours, a reference that the fleet can fly, and a fence around it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from math import ceil, floor
from pathlib import Path
from typing import Any, Literal

import yaml
from msgspec import Struct, to_builtins
from msgspec.structs import replace

from companion.config.file import ConfigError, refuse
from companion.config.fleet import Envelope, FleetConfig, FormationMember, GeodeticOrigin
from companion.config.law import LawName, LawSection
from companion.config.planned_flight import (
    DEFAULT_ORIGIN,
    TOPOLOGY_WORDS,
    ShapeName,
    Topology,
    members_of,
    neighbours_of,
)
from companion.config.reference import KINDS, FirstKind, Reference
from companion.config.validation import Problem
from companion.config.values import FLEET_NAME_WORDS
from companion.geometry.formations import reach_m
from companion.types.values import FLEET_NAME, quoted

ProblemsOf = Callable[[FleetConfig, Reference], Iterable[Problem]]
"""Why a fleet cannot fly a reference."""
TURNING_SLOT_SPEED_M_S = 2.0  # default for formations that turn: at 1 m/s a lap would take minutes
SLOWER = 1.1  # factor by which a reference is made slower until the formation can follow it
MOST_ATTEMPTS = 60
PACE_FIELDS = frozenset({"reference.period_s", "reference.max_speed_m_s", "reference.max_acceleration_m_s2"})
SMALLEST_REFERENCE_M = 10.0
FENCE_MARGIN_M = 20.0
SEPARATION_M = 1.0
SEPARATION_OF_SPACING = 0.6  # at most this share of the spacing, so that vehicles may be off their slots
MOST_VEHICLES = 100


class NewFormation(Struct, frozen=True, kw_only=True):
    """The choices. `may_lead`: the followers that can become leader."""

    name: str
    vehicles: int
    shape: ShapeName = "line"
    spacing_m: float = 3.0
    topology: Topology = "chain"
    reference: FirstKind = "point"
    law: LawName = "cooperative"
    heading: Literal["fixed", "course"] = "fixed"
    height_m: float = 3.0
    may_lead: tuple[int, ...] = ()


class PlannedFormation(Struct, frozen=True):
    """A fleet that is complete, and a reference that it can fly."""

    fleet: FleetConfig
    reference: Reference


def planned_formation(
    new: NewFormation, problems_of: ProblemsOf, origin: GeodeticOrigin | Literal["indoor"] = DEFAULT_ORIGIN
) -> PlannedFormation:
    """The fleet and its reference, which is slow enough for the limits of the fleet and its law, as far as possible."""
    members = tuple(
        replace(member, may_lead=member.id in new.may_lead)
        for member in members_of(new.shape, new.vehicles, new.spacing_m)
    )
    reference = _reference(new, members)
    fleet = FleetConfig(
        name=new.name,
        origin=origin,
        vehicles=members,
        neighbours=neighbours_of(new.topology, members),
        law=LawSection(name=new.law),
        separation_m=round(min(SEPARATION_M, SEPARATION_OF_SPACING * new.spacing_m), 2),
        formation_heading=new.heading,
        slot_speed_m_s=TURNING_SLOT_SPEED_M_S if new.heading == "course" else 1.0,
        takeoff_height_m=new.height_m,
        successors=new.may_lead,
        envelope=_envelope(members, reference),
    )
    for _ in range(MOST_ATTEMPTS):
        if not any(problem.field in PACE_FIELDS for problem in problems_of(fleet, reference)):
            break
        reference = reference.slow_down(SLOWER)
    return PlannedFormation(fleet, reference)


def flight_time_s(reference: Reference) -> float:
    """Time in formation that shows the whole reference: a lap and the time to get up to its speed, or all legs."""
    return reference.whole_s() or 40.0


# ---------------------------------------------------------------- YAML


def inline(value: Any) -> str:
    """A value as YAML in one line; a struct with the fields that differ from their defaults, and its kind."""
    plain = to_builtins(value, builtin_types=())
    return yaml.safe_dump(plain, default_flow_style=True, sort_keys=False, width=10**6).removesuffix("...\n").strip()


def vehicle_lines(members: tuple[FormationMember, ...]) -> list[str]:
    """The list `vehicles` of a fleet section, without its key."""
    lines = []
    for member in members:
        fields = {"id": member.id, "role": str(member.role), "slot_enu_m": list(member.slot_enu_m)}
        fields |= {"may_lead": True} if member.may_lead else {}
        lines.append("  - " + inline(fields | ({"address": member.address} if member.address else {})))
    return lines


def settings_lines(planned: PlannedFormation, new: NewFormation) -> list[str]:
    """The keys of a fleet section after `vehicles`, with comments."""
    fleet, envelope = planned.fleet, planned.fleet.envelope
    laws = "cooperative is the law to fly; the paper's are weighted, average_22, average_26"
    headings = "fixed: the slots' x axis is east; course: it follows the direction of flight"
    return [
        add_comment(f"neighbours: {inline(fleet.neighbours)}", TOPOLOGY_WORDS[new.topology]),
        add_comment(f"law: {{name: {new.law}}}", laws),
        add_comment(f"formation_heading: {new.heading}", headings),
        add_comment(
            f"slot_speed_m_s: {fleet.slot_speed_m_s:g}", "largest speed of a slot when the formation turns or changes"
        ),
        add_comment(f"separation_m: {fleet.separation_m:g}", "smallest distance at take-off and between slots"),
        f"takeoff_height_m: {fleet.takeoff_height_m:g}",
        add_comment("envelope:", "the fence contains the reference with all slots, and a margin"),
        f"  fence_min_enu_m: {inline(list(envelope.fence_min_enu_m))}",
        f"  fence_max_enu_m: {inline(list(envelope.fence_max_enu_m))}",
    ]


def add_comment(line: str, comment: str) -> str:
    """A line of YAML with a comment, in one column where the line is short."""
    return f"{line:<28} # {comment}"


def check_choices(new: NewFormation, command: str) -> None:
    """Raises ConfigError with all choices that are out of bounds; `command` is named instead of a file."""
    problems = []
    if not re.fullmatch(FLEET_NAME, new.name):
        problems.append(Problem("name", f"{quoted(new.name)}: expected {FLEET_NAME_WORDS}"))
    for option, value, least, most in (
        ("--vehicles", new.vehicles, 2, MOST_VEHICLES),
        ("--spacing", new.spacing_m, 1, 100),
        ("--height", new.height_m, 1, 100),
    ):
        if not least <= value <= most:
            problems.append(Problem(option, f"{value:g}: expected {least} to {most}"))
    wrong = [vehicle_id for vehicle_id in new.may_lead if not 2 <= vehicle_id <= new.vehicles]
    if wrong:
        problems.append(Problem("--may-lead", f"{wrong}: expected some of 2 to {new.vehicles}; vehicle 1 leads"))
    refuse(command, problems)


def write_new(texts: Mapping[Path, str], check: Callable[[], object]) -> None:
    """Writes files that do not exist yet, and checks them. Raises ConfigError; then none is left."""
    for path in texts:
        if path.exists():
            raise ConfigError(path, "", "exists; choose another name, or remove it")
    written: list[Path] = []
    try:
        for path, text in texts.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
            written.append(path)
        check()
    except (OSError, ConfigError) as error:
        for path in written:
            path.unlink()
        if isinstance(error, OSError):
            raise ConfigError(error.filename or "", "", f"cannot be written: {error.strerror}") from error
        raise


# ---------------------------------------------------------------- reference and fence


def _reference(new: NewFormation, members: tuple[FormationMember, ...]) -> Reference:
    """A reference in proportion to the formation, at the height of the take-off."""
    size_m = float(ceil(max(SMALLEST_REFERENCE_M, 1.5 * reach_m(member.slot_enu_m for member in members))))
    reference = KINDS[new.reference].first(size_m, new.height_m)
    assert reference is not None  # a kind of FirstKind
    return reference


def _envelope(members: tuple[FormationMember, ...], reference: Reference) -> Envelope:
    """A fence around the reference with all slots, in whichever direction they point."""
    low, high = reference.corners_enu_m()
    around_m = reach_m(member.slot_enu_m for member in members) + FENCE_MARGIN_M
    top_m = max(member.slot_enu_m[2] for member in members) + FENCE_MARGIN_M
    x0, y0 = (floor(low[axis] - around_m) for axis in (0, 1))
    x1, y1, z1 = ceil(high[0] + around_m), ceil(high[1] + around_m), ceil(high[2] + top_m)
    return Envelope(fence_min_enu_m=(float(x0), float(y0), -5.0), fence_max_enu_m=(float(x1), float(y1), float(z1)))
