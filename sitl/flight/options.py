"""Options of the commands that fly a scenario. Light to import."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from companion.config.fleet import LawName


@dataclass(frozen=True, slots=True)
class RunOptions:
    """`others` are the laws to compare with, None without --compare. `anyway` flies an unstable formation, too.

    `record`: agents in virtual time leave recordings; those of real processes always do.
    """

    scenario: Path
    overrides: Sequence[str] = ()
    others: Sequence[LawName] | None = None
    out: Path | None = None
    quiet: bool = False
    anyway: bool = False
    record: bool = False


@dataclass(frozen=True, slots=True)
class FlyOptions:
    """`port_offset` is chosen automatically when it is None; `external` is the file of the external autopilots."""

    run: RunOptions
    port_offset: int | None = None
    external: Path | None = None


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """`port_offset` is chosen automatically when it is None."""

    scenario: Path
    overrides: Sequence[str] = ()
    out: Path | None = None
    quiet: bool = False
    port_offset: int | None = None
