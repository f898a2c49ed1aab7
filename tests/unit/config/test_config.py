"""Fleet and vehicle files: each error names file, field, value and what was expected."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from companion.config.file import ConfigError
from companion.config.law import law_of
from companion.config.vehicle import load_agent
from companion.laws.weighted import Weighted
from companion.types.formation import Gains
from tests.helpers.laws import cooperative, weighted

FLEET: dict[str, Any] = {
    "name": "pair",
    "origin": {"latitude_deg": 47.4, "longitude_deg": 8.5, "altitude_amsl_m": 488.0},
    "vehicles": [
        {"id": 1, "role": "leader", "slot_enu_m": [0.0, 0.0, 0.0]},
        {"id": 2, "role": "follower", "slot_enu_m": [-1.5, 0.0, 0.0]},
    ],
    "neighbours": {"kind": "edges", "edges": [[1, 2]]},
    "law": {"name": "weighted", "parameters": {"position_gain_1_s2": 1.39, "velocity_gain_1_s": 1.2}},
}
VEHICLE: dict[str, Any] = {"id": 2, "fleet": "fleet.yaml", "mavlink": "udpin:0.0.0.0:14541", "hover_thrust_norm": 0.5}
LEADER: dict[str, Any] = VEHICLE | {"id": 1, "reference": {"kind": "point", "point_enu_m": [1.0, 0.0, 1.0]}}


def write(folder: Path, fleet: Any, vehicle: Any) -> Path:
    (folder / "fleet.yaml").write_text(yaml.safe_dump(fleet))
    (folder / "vehicle.yaml").write_text(yaml.safe_dump(vehicle))
    return folder / "vehicle.yaml"


def deep_copy(data: dict[str, Any]) -> Any:
    return yaml.safe_load(yaml.safe_dump(data))


def refusal(path: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load_agent(path)
    line = str(caught.value)
    assert "\n" not in line
    return line


def test_good_files_load(tmp_path: Path) -> None:
    config = load_agent(write(tmp_path, FLEET, LEADER))
    assert config.member.id == 1
    assert law_of(config.fleet.law) == weighted(Gains(1.39, 1.2), exponent=1.0)


def test_the_default_law_is_cooperative(tmp_path: Path) -> None:
    fleet = deep_copy(FLEET)
    del fleet["law"]
    assert law_of(load_agent(write(tmp_path, fleet, LEADER)).fleet.law) == cooperative()


def test_parameters_of_a_law_can_be_changed_one_by_one(tmp_path: Path) -> None:
    fleet = deep_copy(FLEET)
    fleet["law"] = {"name": "weighted", "parameters": {"velocity_gain_1_s": 2.0, "feedforward": 0.5}}
    law = law_of(load_agent(write(tmp_path, fleet, LEADER)).fleet.law)
    assert law == Weighted(1.39, 2.0, exponent=1.0, feedforward=0.5, leader_uses_neighbours=True)


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda f: f["law"].update(paramters={}), ["law.paramters", "unknown key", '"parameters"']),
        (
            lambda f: f["law"]["parameters"].update(position_gain_1_s2=-1.0),
            ["law.parameters.position_gain_1_s2", "-1.0", "> 0"],
        ),
        (
            lambda f: f["law"]["parameters"].update(velocity_gain_1_s="fast"),
            ["law.parameters.velocity_gain_1_s", "'fast'", "a number"],
        ),
        (lambda f: f["law"].update(name="weigthed"), ["law.name", "'weigthed'", "average_22", '"weighted"']),
        (lambda f: f["law"].update(parameters={"exponent": 99}), ["law.parameters.exponent", "99", "<= 16"]),
        (lambda f: f["law"].update(parameters={"feedforward": 1.0}), ["law.parameters.feedforward", "1.0", "<= 0.99"]),
        (
            lambda f: f["law"].update(name="average_22", parameters={"exponent": 2}),
            ["law.parameters.exponent", "unknown key"],
        ),
        (
            lambda f: f["law"].update(name="average_26", parameters={"feedforward": 0.5}),
            ["law.parameters.feedforward", "unknown key"],
        ),
        (lambda f: f["vehicles"][1].update(id=1), ["vehicles[1].id", "used twice"]),
        (lambda f: f["vehicles"][1].update(id=0), ["vehicles[1].id", "0", ">= 1"]),
        (lambda f: f["vehicles"][1].pop("slot_enu_m"), ["vehicles[1].slot_enu_m", "required"]),
        (
            lambda f: f["vehicles"][1].update(slot_enu_m=[0.2, 0, 0]),
            [
                "vehicles[1].slot_enu_m",
                "vehicle 2 is 0.20 m from the slot of vehicle 1; expected at least separation_m, 1",
            ],
        ),
        (
            lambda f: (f["vehicles"][1].update(slot_enu_m=[0, 0, 3]), f["law"].update(altitude="hold")),
            ["vehicles[1].slot_enu_m", "0.00 m from the slot of vehicle 1"],
        ),
        (lambda f: f["vehicles"][0].update(role="follower"), ["vehicles", "no vehicle leads"]),
        (lambda f: f["vehicles"][0].update(role="boss"), ["vehicles[0].role", "'boss'", "leader"]),
        (lambda f: f["neighbours"].update(edges=[[1, 7]]), ["neighbours.edges[0]", "vehicle 7", "1, 2"]),
        (lambda f: f["neighbours"].update(edges=[[2, 2]]), ["neighbours.edges[0]", "itself"]),
        (lambda f: f["neighbours"].update(edges=[[1]]), ["neighbours.edges[0]", "length 2"]),
        (lambda f: f["neighbours"].update(kind="edge"), ["neighbours.kind: 'edge'", "one of edges, range", '"edges"']),
        (
            lambda f: f.update(successors=[2]),
            ["successors[0]", "vehicle 2 may not lead", "may_lead: true for vehicle 2"],
        ),
        (
            lambda f: f.update(leave_below_percent=20, land_below_percent=25),
            ["land_below_percent", "25 is more than leave_below_percent, 20"],
        ),
        (lambda f: f.update(successors=[7]), ["successors[0]", "vehicle 7 may not lead; expected some of 1"]),
        (lambda f: f.update(successors=[1, 1]), ["successors[1]", "1 is named twice"]),
        (lambda f: f.update(land_after_s=0), ["land_after_s", "0", "> 0"]),
        (lambda f: f["origin"].update(altitude_amsl_m="1e2"), ["'1e2': expected a number", "for YAML", "1.0e+2"]),
        (
            lambda f: f.update(law="weighted"),
            ["law: 'weighted': expected a section with keys; did you mean {name: weighted}?"],
        ),
        (lambda f: f.update(neighbours="range"), ["did you mean {kind: range, ...}?"]),
        (lambda f: f.update(neighbours="kind:range"), ["neighbours: 'kind:range': expected", "a blank is missing"]),
        (lambda f: f.update(neighbours={"kind:range": None}), ["neighbours.kind: missing", "a blank is missing"]),
        (lambda f: f["origin"].update(latitude_deg="47,3"), ["'47,3': expected a number; a number has a point: 47.3"]),
        (lambda f: f["origin"].update({397: None}), ["origin.397: unknown key; a number has a point, not a comma"]),
        (lambda f: f.update(vehicles={}), ["vehicles: expected a list, got a section with keys"]),
        (lambda f: f.update(name="Pair"), ["name: 'Pair'", "lower-case letters"]),
        (lambda f: f.update(neighbours={"kind": "range", "range_m": 0}), ["neighbours.range_m", "> 0"]),
        (lambda f: f["origin"].update(latitude_deg=float("nan")), ["origin.latitude_deg", "nan", "finite"]),
        (lambda f: f["origin"].update(latitude_deg=95), ["origin.latitude_deg", "95", "<= 85"]),
        (lambda f: f.update(vehicles=[]), ["vehicles", "empty"]),
        (
            lambda f: f.update(envelope={"max_tilt_rate_deg_s": 30.0}),
            ["envelope.max_tilt_rate_deg_s", "30 is too slow to evade with max_tilt_deg 25", "at least 50"],
        ),
        (
            lambda f: f.update(formation_heading="course", envelope={"max_tilt_deg": 2.0}),
            ["envelope.max_tilt_deg", "2 is no more than what slots need that turn", "expected more than"],
        ),
        (
            lambda f: f.update(formation_heading="course", slot_speed_m_s=0.5, envelope={"max_speed_m_s": 0.5}),
            ["envelope.max_speed_m_s", "0.5 is no more than what slots need", "expected more than slot_speed_m_s, 0.5"],
        ),
        (lambda f: f.update(takeoff_height_m=60.0), ["takeoff_height_m", "60 is above the fence", "50 m"]),
        (lambda f: f.update(envelope={"max_tilt_deg": 80}), ["envelope.max_tilt_deg", "80", "<= 45"]),
        (lambda f: f.update(envelope={"fence_min_enu_m": [200, 0, 0]}), ["fence_min_enu_m", "x is 200"]),
    ],
)
def test_an_error_in_a_fleet_file_is_located(tmp_path: Path, change: Callable[[Any], Any], parts: list[str]) -> None:
    fleet = deep_copy(FLEET)
    change(fleet)
    line = refusal(write(tmp_path, fleet, LEADER))
    for part in ["fleet.yaml", *parts]:
        assert part in line, line


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        ({"id": 9}, ["id: 9", "no slot", "1, 2"]),
        ({"id": 1}, ["reference", "leads"]),
        ({"reference": LEADER["reference"]}, ["reference", "only a vehicle that may lead"]),
        ({"autopilot": "apm"}, ["autopilot: 'apm'", "ardupilot, px4"]),
        ({"mavlink": "/dev/ttyACM0"}, ["mavlink: '/dev/ttyACM0': expected udpin:HOST:PORT", "serial:DEVICE:BAUD"]),
        ({"hover_thrust_norm": 49}, ["hover_thrust_norm", "49", "<= 0.9"]),
        ({"fleet": "nowhere.yaml"}, ["vehicle.yaml: fleet:", '"nowhere.yaml": no such file', "relative to"]),
        ({"hover_trust_norm": 0.4}, ["hover_trust_norm", "unknown key", "hover_thrust_norm"]),
        ({"ground_station": "udpin:0.0.0.0:1"}, ["ground_station: 'udpin:0.0.0.0:1': expected udpout:HOST:PORT"]),
        ({"signing": {}}, ["signing", "expected one of key_file and credential"]),
        ({"signing": {"key_file": "a", "credential": "b"}}, ["signing", "expected one of key_file and credential"]),
        ({"signing": {"credential": "../a"}}, ["signing.credential", "'../a'", "a name of letters"]),
        (
            {"id": 1, "reference": {"kind": "ring"}},
            ["reference.kind: 'ring'", "one of circle, figure_8, file, point, samples, target, waypoints"],
        ),
        ({"signing": {"key_file": "a", "link_id": 256}}, ["signing.link_id", "256"]),
    ],
)
def test_an_error_in_a_vehicle_file_is_located(tmp_path: Path, change: dict[str, Any], parts: list[str]) -> None:
    line = refusal(write(tmp_path, FLEET, VEHICLE | change))
    for part in parts:
        assert part in line, line


def test_errors_of_a_vehicle_file_and_of_its_fleet_file_are_reported_together(tmp_path: Path) -> None:
    fleet = deep_copy(FLEET) | {"takeoff_height_m": "high", "successors": [2]}
    path = write(tmp_path, fleet, LEADER | {"hover_thrust_norm": 49, "signing": {}})
    with pytest.raises(ConfigError) as caught:
        load_agent(path)
    assert [line.split(": ")[:2] for line in caught.value.lines] == [
        [str(path), "hover_thrust_norm"],
        [str(path), "signing"],
        [str(tmp_path / "fleet.yaml"), "successors[0]"],
        [str(tmp_path / "fleet.yaml"), "takeoff_height_m"],
    ]


def test_a_file_of_another_kind_is_refused_as_such(tmp_path: Path) -> None:
    vehicle = write(tmp_path, FLEET, VEHICLE | {"fleet": "vehicle.yaml"})
    fleet = tmp_path / "fleet.yaml"
    assert refusal(fleet) == f"{fleet}: this is a fleet file; a vehicle file is expected"
    assert refusal(vehicle) == f"{vehicle}: this is a vehicle file; a fleet file is expected"


def test_exactly_the_vehicles_that_may_lead_hold_the_reference(tmp_path: Path) -> None:
    fleet = deep_copy(FLEET)
    fleet["vehicles"][1]["may_lead"] = True
    line = refusal(write(tmp_path, fleet, VEHICLE))
    assert "reference: missing; vehicle 2 may lead and needs the reference trajectory (RFT)" in line
    config = load_agent(write(tmp_path, fleet, VEHICLE | {"reference": LEADER["reference"]}))
    assert config.member.can_lead
    fleet["vehicles"][1]["may_lead"] = False
    assert "may_lead: true" in refusal(write(tmp_path, fleet, VEHICLE | {"reference": LEADER["reference"]}))


@pytest.mark.parametrize(
    ("point", "words"),
    [([0.0, 0.0, 500.0], "vehicle 1 at z = 500 m"), ([-99.0, 0.0, 1.0], "vehicle 2 at x = -100.5 m")],
)
def test_a_reference_outside_the_fence_is_refused(tmp_path: Path, point: list[float], words: str) -> None:
    line = refusal(write(tmp_path, FLEET, LEADER | {"reference": {"kind": "point", "point_enu_m": point}}))
    assert "vehicle.yaml: reference.point_enu_m" in line
    assert words in line
    assert "outside the fence" in line


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "empty"),
        ("id: 1\nid: 2\n", "is given twice"),
        ("id: [1\n", "not valid YAML"),
        ("fleet:\n\tid: 1\n", "line 2, column 1: not valid YAML: a tab, where YAML wants spaces"),
        ("a:\n  kind:x\n  b: 2\n", "the line above has no colon with a blank after it"),
        ("a: 1\n  b: 2\n", "line 2, column 4: not valid YAML: no colon can be here: this line is indented too far"),
        (
            "a:\n  b: 1\n c: 2\n",
            "line 3, column 2: not valid YAML: this line is not indented like those of its section",
        ),
        ("id: [1,\n  2\nname: a\n", "a bracket is not closed, or a comma is missing, in what begins in line 1"),
        ("- 1\n- 2\n", "expected a section with keys"),
        ("\x00", "not valid YAML"),
        ("edges: {[1, 2], [2, 3]}", "line 1, column 9: not valid YAML: a list or a mapping cannot be a key"),
        ("id: 1\nname: 2024-13-45", "line 2, column 7: not valid YAML: not a timestamp that can be used"),
        ("name: 2024-01-01 99:99:99", "not a timestamp"),
        ("name: !!timestamp foo", "not a timestamp"),
        ("id: !!float foo", "not a float"),
        ("id: !!int ''", "not a int"),
        ("id: !!bool maybe", "not a bool"),
        ("x: &a [*a]", "&a contains itself"),
        ("x: &a {b: {c: *a}}", "&a contains itself"),
        ("x: " + "[" * 3000 + "]" * 3000, "more than 50 levels"),
        ("id: " + "9" * 5000, "not a int"),
        ("id: 0x" + "9" * 5000, "not a int"),
        ("? 0x" + "9" * 5000 + "\n: 1", "not a int"),
    ],
)
def test_content_that_is_no_valid_yaml_is_refused(tmp_path: Path, text: str, part: str) -> None:
    (tmp_path / "vehicle.yaml").write_text(text)
    line = refusal(tmp_path / "vehicle.yaml")
    assert "vehicle.yaml" in line
    assert part in line


def test_the_hash_depends_on_the_settings_only(tmp_path: Path) -> None:
    one = load_agent(write(tmp_path, FLEET, LEADER)).fleet
    same = load_agent(write(tmp_path, dict(reversed(FLEET.items())), LEADER)).fleet
    moved = deep_copy(FLEET)
    moved["vehicles"][1]["slot_enu_m"] = [-1.6, 0.0, 0.0]
    other = load_agent(write(tmp_path, moved, LEADER)).fleet
    assert one.formation_hash() == same.formation_hash() != other.formation_hash()
