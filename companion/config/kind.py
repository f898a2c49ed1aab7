"""The kind of a file, by its keys: a file of another kind than expected is refused as such."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from companion.config.file import ConfigError, read_yaml

FileKind = Literal["scenario", "vehicle", "fleet", "external", "slots", "reference"]
KEYS_OF_KIND: dict[FileKind, set[str]] = {  # no other kind of file has these
    "scenario": {"starts_enu_m", "timeline"},
    "vehicle": {"mavlink", "hover_thrust_norm"},
    "fleet": {"vehicles", "neighbours", "takeoff_height_m"},
    "external": {"external_vehicles"},
    "slots": {"slots_enu_m"},
    "reference": set(),  # scenarios and vehicle files have such a section, too
}
A_FILE: dict[FileKind, str] = {
    "scenario": "a scenario",
    "vehicle": "a vehicle file",
    "fleet": "a fleet file",
    "external": "a file of external vehicles",
    "slots": "a file with slots_enu_m",
    "reference": "a file with nothing but a reference",
}


def kind_of_file(data: Any) -> FileKind | None:
    """The kind by the keys; None if they do not show one kind."""
    kinds = [kind for kind, keys in KEYS_OF_KIND.items() if isinstance(data, dict) and keys & data.keys()]
    return kinds[0] if len(kinds) == 1 else None


def read_as(path: Path, *expected: FileKind) -> Any:
    """The plain content of a YAML file of one of these kinds. Raises ConfigError."""
    data = read_yaml(path)
    kind = kind_of_file(data)
    if kind is not None and kind not in expected:
        wanted = " or ".join(A_FILE[kind] for kind in expected)
        raise ConfigError(path, "", f"this is {A_FILE[kind]}; {wanted} is expected")
    return data
