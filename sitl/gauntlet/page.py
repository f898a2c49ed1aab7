"""The page of the documentation with the measured table: `sitl gauntlet --page docs/gauntlet.md`."""

from __future__ import annotations

from collections.abc import Sequence

from sitl.gauntlet.families import FAMILIES, RESTARTS_AFTER_S, STAYS_DEAD
from sitl.gauntlet.flight import FlightOutcome
from sitl.gauntlet.summary import COLUMNS, GRACE_S, IN_TIME, FamilySummary, cells


def page(seed: int, families: Sequence[FamilySummary], outcomes: Sequence[FlightOutcome]) -> str:
    """The whole page as Markdown."""
    return "\n".join(
        [
            "# The gauntlet",
            "",
            f"<!-- written by `make gauntlet`: {len(outcomes)} flights with seed {seed} -->",
            "",
            INTRODUCTION,
            "",
            "## Measured",
            "",
            f"{len(outcomes)} flights with seed {seed}, {_vehicles(outcomes)}.",
            "",
            *_table(families),
            "",
            EXPLANATION,
            "",
            "## Families",
            "",
            "| family | what happens |",
            "|---|---|",
            *(f"| `{name}` | {_first_sentence(family.__doc__)} |" for name, family in FAMILIES.items()),
            "",
        ]
    )


def _vehicles(outcomes: Sequence[FlightOutcome]) -> str:
    sizes = [outcome.vehicles for outcome in outcomes if outcome.vehicles]
    return f"{min(sizes)} to {max(sizes)} vehicles each" if sizes else "none of them possible"


def _table(families: Sequence[FamilySummary]) -> list[str]:
    head = "| " + " | ".join(" ".join(filter(None, (a, b))).replace("- ", "") for a, b, _ in COLUMNS) + " |"
    rows = ["| " + " | ".join(cells(family)) + " |" for family in families]
    return [head, "|" + "---|" * len(COLUMNS), *rows]


def _first_sentence(text: str | None) -> str:
    return " ".join((text or "").split()).split(". ")[0].rstrip(".")


INTRODUCTION = """\
`sitl gauntlet` flies random flights of whole fleets in virtual time: the agents that fly for real,
on simulated quadrotors. Each flight draws its fleet (4 to 12 vehicles, shape, spacing,
`separation_m` from 1 to 2.5 m), the law (`weighted` or `cooperative`), the autopilot, the sensors,
the network (delay up to 0.1 s with up to 0.05 s jitter, loss up to 10 %), and what happens to it.
Every tenth flight has a runaway: a pilot takes over one vehicle and flies it straight on at up to
2 m/s. In a split network it begins while the others receive it: no vehicle can avoid another one
that begins to move unheard. The seed and the number of a flight give the same flight bit for bit.

```sh
sitl gauntlet --flights 100 --seed 7           # on all cores, some minutes
sitl gauntlet --families joining,hovering      # some families only
sitl gauntlet --fleet fleet.yaml               # your own fleet: its slots, law and limits
sitl run runs/gauntlet-DATE-TIME/FLIGHT.yaml   # one of the worst flights again, with its plot
```"""

FIRST_S, LAST_S = RESTARTS_AFTER_S
EXPLANATION = f"""\
- **Ratio**: the smallest true distance of a flight in units of `separation_m`, over all pairs where
  an agent commands the attitude of at least one vehicle. **Automatic** is the worst of all other
  pairs in the air, which both fly by their autopilots or pilots.
- **Violation**: a flight with a ratio below 1 with ideal sensors, 0.8 with `default`, 0.6 with
  `px4_sih`.
- **Vehicles to slots** were to be in their slots at the end. **Reached**: they were: neither the
  slot nor a reference that comes to rest moved any more, and they were within 0.5 m of the slot
  (1 m with `px4_sih`) for 2 s, by their own reports. **Refused**: they were not, and had refused a
  command of the flight, for example because the path was too near to another vehicle. **Left**: not
  in formation any more, by a failsafe.
- **In time**: of the vehicles that fly to their slots in the same flight undisturbed (ideal sensors
  and network, no runaway, no separation) and refused nothing, the share that took at most
  {IN_TIME:g} times as long, plus {GRACE_S:g} s. A vehicle that left or did not reach its slot is not in time.
  Vehicles that were in their slots all the time undisturbed are not counted. Every third flight is
  flown undisturbed as well.
- The undisturbed time is at least the duration of the change, of the path into the slot, or of the
  way of a reference to its place.
- In `leader_dies` a new agent starts {FIRST_S:g} to {LAST_S:g} s after the end, as systemd starts it on a vehicle.
  It observes and publishes its position, and the others make way. {100 * STAYS_DEAD:g} % of the PX4 stay without
  an agent: they brake and hold. No ArduCopter stays without one: it would level and drift, up to
  0.8 m/s with `px4_sih`, and no other vehicle would know where it is. That the filter cannot avoid."""
