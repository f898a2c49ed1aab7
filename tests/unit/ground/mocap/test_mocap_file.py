"""The file of `companion mocap`: each mistake is one line that names file, field and what is expected."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from companion.config.file import ConfigError
from companion.ground.mocap.file import load_mocap

FLEET = {
    "name": "lab",
    "origin": "indoor",
    "vehicles": [
        {"id": 1, "role": "leader", "slot_enu_m": [0, 0, 0]},
        {"id": 2, "role": "follower", "slot_enu_m": [-2, 0, 0]},
    ],
    "neighbours": {"kind": "edges", "edges": [[1, 2]]},
}
MOCAP = {
    "fleet": "fleet.yaml",
    "system": "natnet",
    "host": "192.168.1.5",
    "up": "y",
    "forward": "x",
    "bodies": {"cf1": 1, "cf2": 2},
}


def written(folder: Path, of_fleet: dict | None = None, **changes: object) -> Path:
    file = folder / "lab.yaml"
    (folder / "fleet.yaml").write_text(yaml.safe_dump({**FLEET, **(of_fleet or {})}), encoding="utf-8")
    content = {key: value for key, value in {**MOCAP, **changes}.items() if value is not None}
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    return file


def test_a_file(tmp_path: Path):
    file, fleet, path = load_mocap(written(tmp_path))
    assert (file.bodies, fleet.name, path) == ({"cf1": 1, "cf2": 2}, "lab", tmp_path / "fleet.yaml")


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"system": "optitrak"}, "lab.yaml: system: 'optitrak': expected one of"),
        ({"up": "x"}, "lab.yaml: up: 'x': expected one of y, z"),
        ({"forward": "-y"}, "lab.yaml: forward: -y: expected another axis than that of up, y"),
        ({"host": "a host"}, "lab.yaml: host: 'a host': expected an IPv4 address or a name, like 192.168.1.5"),
        ({"host": None}, "lab.yaml: host: missing; this key is required"),
        ({"bodies": {"cf1": 1, "cf2": 1}}, "lab.yaml: bodies.cf2: 1 is the vehicle of cf1 already; give each its own"),
        ({"bodies": {"cf1": 7}}, "lab.yaml: bodies.cf1: 7: no such vehicle in"),
        ({"bodies": {}}, "lab.yaml: bodies: "),
        ({"fleet": "flet.yaml"}, 'lab.yaml: fleet: "flet.yaml": no such file'),
        ({"turn_deg": 400}, "lab.yaml: turn_deg: 400: expected"),
        ({"rate": 100}, 'lab.yaml: rate: unknown key; did you mean "rate_hz"?'),
    ],
)
def test_a_mistake_is_one_line(tmp_path: Path, changes: dict, line: str):
    with pytest.raises(ConfigError) as raised:
        load_mocap(written(tmp_path, **changes))
    assert str(raised.value).startswith(str(tmp_path / line))
    assert len(raised.value.lines) == 1


def test_a_fleet_with_an_origin_on_earth_is_refused(tmp_path: Path):
    origin = {"latitude_deg": 47.4, "longitude_deg": 8.5, "altitude_amsl_m": 488.0}
    with pytest.raises(ConfigError, match="origin: expected indoor"):
        load_mocap(written(tmp_path, {"origin": origin}))
