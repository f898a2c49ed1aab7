"""What an operator asks of a fleet, as plain values: the input of `companion fleet`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from companion.config.reference import Reference
from companion.types.commands import Described
from companion.types.values import Vector3


def command_line(action: str) -> Path:
    """Named in an error in place of a file."""
    return Path(f"companion fleet {action}")


@dataclass(frozen=True, slots=True)
class FormationRequest:
    """A shape by its name with `spacing_m`, or slots, or neither: the present slots. Each is rotated and scaled.

    Slots are those in `slots_file`, or `slots_enu_m` by vehicle id.
    """

    shape: str | None
    slots_file: Path | None
    spacing_m: float | None
    heading_deg: float
    scale: float
    slots_enu_m: Mapping[int, Vector3] | None = None


@dataclass(frozen=True, slots=True)
class ReferenceRequest:
    """A file, or the keys of its section `reference` without positions; `positions_enu_m` has every --at.

    Or `whole`, a reference that is complete.
    """

    file: Path | None
    described: Described
    positions_enu_m: tuple[list[float], ...]
    whole: Reference | None = None


@dataclass(frozen=True, slots=True)
class FleetRequest:
    """One action for the fleet in the file `fleet`. `only` is empty for all vehicles of the file.

    `leaders`, `formation`, `reference` and `admission_list` belong to one action each.
    """

    action: str
    fleet: Path
    connect: tuple[str, ...]
    operator: str  # "" for user@host; not used with an identity
    only: tuple[int, ...]
    wait_s: float  # for reports and replies
    as_json: bool
    wait: bool = True  # until the action is finished, after all vehicles have accepted it
    identity: Path | None = None
    timeout_s: float | None = None  # of that wait; None for the default of the action
    leaders: tuple[int, ...] = ()
    formation: FormationRequest | None = None
    reference: ReferenceRequest | None = None
    admission_list: Path | None = None
