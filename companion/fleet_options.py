"""The command line of `companion fleet`. Light to import: what talks to the vehicles is imported when it does."""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass
from pathlib import Path

from companion.arguments import number
from companion.fleet_where_options import (
    FORMATION,
    FORMATION_MORE,
    REFERENCE,
    REFERENCE_MORE,
    FormationWish,
    ReferenceWish,
    add_formation_arguments,
    add_reference_arguments,
    formation_wish,
    reference_wish,
)

HIGHEST_ID = 250

DESCRIPTION = """\
Command a fleet from the ground: every vehicle is asked at the same time, judges for itself and answers for itself. One line
for each: accepted, refused and why, or missing, and how long its answer took.

  status      what each vehicle does, and who holds command
  ready       what each vehicle checks before it flies: autopilot, estimator, battery, origin, peers, fleet file, separation
  arm         prepares those that only observe, then arms
  takeoff     climbs vertically to takeoff_height_m, into the autopilot's own hold
  form        from there into the formation
  hold        out of the formation into the autopilot's own hold
  land        vertically, where each one is
  return      home to where each one took off, and down there, by the autopilot's own return mode
  disarm      on the ground
  abort       whatever it does: disarmed on the ground, into the autopilot's own hold in the air
  leader      who leads from now on, in flight as well
  formation   other slots, gone to in flight: a shape, a file, or what is flown, scaled; formation --help has more
  reference   another reference, gone over to in flight: a point, waypoints, a circle, ...; reference --help has more
  take        take command over from another operator
"""

MORE = """\
examples:
  companion fleet ready --fleet fleet.yaml --connect tcp/192.168.1.11:7447
  companion fleet arm --fleet fleet.yaml && sleep 5 && companion fleet takeoff --fleet fleet.yaml
  companion fleet form --fleet fleet.yaml --only 2 3
  companion fleet leader 2 --fleet fleet.yaml
  companion fleet formation diamond --spacing 4 --heading 90 --fleet fleet.yaml
  companion fleet reference point --at 10 -5 4 --fleet fleet.yaml
  companion fleet land --fleet fleet.yaml --json | jq '.vehicles[] | select(.answer != "accepted")'

An answer says what the vehicle begins, not that it is done: `companion fleet status` and `companion monitor` show that. The
first operator who asks a vehicle for something holds command of it; another is refused and told who that is, until it takes
command. An operator is user@host, or --as NAME. Vehicles refuse what is not for their present start, and what is not newer
than the last command, so that nothing recorded can be given again.

abort is for everybody, also for those who do not hold command, and works in every phase. It never makes things worse: a
vehicle that lands goes on landing, and one that its pilot flies is left to him. In the air all stop where they are, so
two that are on their way past each other stop, too. `hold` takes a vehicle from its pilot, `abort` does not.

return is for vehicles in formation or in hold. Their autopilots climb first, as high as RTL_RETURN_ALT (PX4) or RTL_ALT
(ArduCopter) says, fly straight home and land; from then on they need neither agent nor network. They know nothing of each
other, so a vehicle refuses where its straight way home comes nearer than separation_m to another vehicle or to that one's
way home, whoever of them is asked, and where it does not know its home, as after a restart of its agent in the air. Land
those that refuse, ask them again when others are home, or first bring the formation back to where it took off. `hold` and
`land` end a return, and so does `abort`, but for vehicles that come down at home already.

One vehicle's endpoint (zenoh.listen in its vehicle file) leads to all that it is connected with; more endpoints help
where one vehicle may be away. Without --connect: tcp/127.0.0.1:7448 to 7455, vehicles 1 to 8 of a simulation.

exit codes:
  0    every vehicle has accepted; with status: is heard; with ready: is ready
  1    some have refused, are missing or are not ready
  2    the fleet file, an endpoint or an argument cannot be used; nothing was asked
  130  ended by Ctrl-C
"""

PLAIN = ("arm", "takeoff", "form", "hold", "land", "return", "disarm", "abort", "take")


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """What the command line says. `only` is empty for all; `leaders` and both wishes go with one action each."""

    action: str
    fleet: Path
    connect: tuple[str, ...]
    operator: str  # "" where it is left out
    only: tuple[int, ...]
    wait_s: float
    as_json: bool
    leaders: tuple[int, ...] = ()
    formation: FormationWish | None = None
    reference: ReferenceWish | None = None


def add_fleet_arguments(parser: argparse.ArgumentParser) -> None:
    common = _common()
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    for name in ("status", "ready", *PLAIN):
        actions.add_parser(name, parents=[common, _some()], epilog=SEE)
    leader = actions.add_parser("leader", parents=[common], epilog=SEE)
    leader.add_argument("leaders", nargs="+", type=_vehicle_id, metavar="ID", help="who leads; all others follow")
    raw = argparse.RawDescriptionHelpFormatter
    for name, says, more, add in (
        ("formation", FORMATION, FORMATION_MORE, add_formation_arguments),
        ("reference", REFERENCE, REFERENCE_MORE, add_reference_arguments),
    ):
        add(actions.add_parser(name, parents=[common], description=says, epilog=more, formatter_class=raw))


SEE = "`companion fleet --help` explains all actions, who holds command, and the exit codes."


def fleet_options(parsed: argparse.Namespace) -> FleetOptions:
    return FleetOptions(
        parsed.action,
        parsed.fleet,
        tuple(parsed.connect or ()),
        parsed.operator or "",
        tuple(getattr(parsed, "only", ())),
        parsed.wait_s,
        parsed.json,
        tuple(getattr(parsed, "leaders", ())),
        formation_wish(parsed) if parsed.action == "formation" else None,
        reference_wish(parsed) if parsed.action == "reference" else None,
    )


def _common() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument(
        "--fleet", type=Path, required=True, metavar="FILE", help="the fleet file that the vehicles have"
    )
    parser.add_argument("--connect", nargs="+", metavar="ENDPOINT", help="Zenoh endpoints of vehicles")
    parser.add_argument(
        "--as", dest="operator", type=_operator, metavar="NAME", help="the operator (default: user@host)"
    )
    parser.add_argument(
        "--wait-s", type=_wait_s, default=3.0, metavar="S", help="how long to wait for the vehicles (default 3)"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the lines")
    return parser


def _some() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument(
        "--only",
        nargs="+",
        type=_vehicle_id,
        default=[],
        metavar="ID",
        help="these vehicles (default: all of the fleet)",
    )
    return parser


def _vehicle_id(text: str) -> int:
    if not re.fullmatch("[0-9]{1,3}", text) or not 1 <= int(text) <= HIGHEST_ID:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a vehicle's id from 1 to {HIGHEST_ID}")
    return int(text)


def _operator(text: str) -> str:
    from companion.wire.ground import OPERATOR, OPERATOR_WORDS

    if not re.fullmatch(OPERATOR, text):
        raise argparse.ArgumentTypeError(f"{text!r}, expected {OPERATOR_WORDS}")
    return text


def _wait_s(text: str) -> float:
    return number(text, "seconds from 0.1 to 60", 0.1, 60.0)
