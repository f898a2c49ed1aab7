"""`sitl new`: a commented scenario file from a few choices, which flies as it is."""

from __future__ import annotations

from pathlib import Path

from companion.assembly import flyable_problems
from companion.config.new_formation import (
    NewFormation,
    PlannedFormation,
    add_comment,
    check_choices,
    flight_time_s,
    inline,
    planned_formation,
    settings_lines,
    vehicle_lines,
    write_new,
)
from sitl.flight.scenario import load_scenario

NEXT = """\
wrote {path}: {count} vehicles, {shape}, {spacing:g} m apart
next:
  sitl run {path}              fly it in virtual time; figures and plots follow
  companion analyze {path}     predict its behaviour
  sitl fly {path}              fly it as real processes
"""


def new_scenario(new: NewFormation, folder: Path) -> str:
    """Writes FOLDER/NAME.yaml, checks it by loading it, and returns what to do next. Raises ConfigError."""
    check_choices(new, "sitl new")
    path = folder / f"{new.name}.yaml"
    write_new({path: scenario_text(new)}, check=lambda: load_scenario(path))
    return NEXT.format(path=path, count=new.vehicles, shape=new.shape, spacing=new.spacing_m)


def scenario_text(new: NewFormation) -> str:
    """The whole file."""
    planned = planned_formation(new, flyable_problems)
    fleet = [add_comment("vehicles:", "the slots are offsets from the reference: x east, y north, z up")]
    fleet += [*vehicle_lines(planned.fleet.vehicles), *settings_lines(planned, new)]
    lines = [
        f"description: {new.vehicles} vehicles, shape {new.shape}, {new.spacing_m:g} m apart, reference {new.reference}.",
        "fleet:",
        f"  name: {new.name}",
        *(f"  {line}" for line in fleet),
        "# origin and starts_enu_m have defaults: a place in Zurich, and the ground below the slots at the reference's start.",
        f"reference: {inline(planned.reference)}",
        "stand_in:",
        add_comment("  autopilot: px4", "or ardupilot"),
        add_comment("  sensors: default", "or ideal, px4_sih"),
        "  # wind: {mean_enu_m_s: [3.0, 0.0, 0.0], gust_sd_m_s: 1.0}",
        *timeline_lines(planned),
    ]
    return "\n".join(lines) + "\n"


def timeline_lines(planned: PlannedFormation) -> list[str]:
    """The standard timeline, with enough time in formation for the whole reference."""
    return [
        add_comment("timeline:", "for_s: time before the next command, once all have done this one"),
        "  - {command: prepare}",
        "  - {command: arm}",
        "  - {command: takeoff, for_s: 3.0}",
        f"  - {{command: form, for_s: {flight_time_s(planned.reference):.1f}}}",
        "  # - {command: formation, formation: {shape: line, spacing_m: 3.0}, for_s: 20.0}",
        "  - {command: hold, for_s: 2.0}",
        "  - {command: land}",
    ]
