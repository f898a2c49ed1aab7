"""`sitl new` and `companion init`: what they write loads, is consistent, and nothing is overwritten."""

from itertools import combinations
from math import dist
from pathlib import Path
from typing import get_args

import pytest

from companion.analysis.response import reached_from
from companion.cli.main import main
from companion.config.file import ConfigError
from companion.config.new_formation import NewFormation, flight_time_s
from companion.config.planned_flight import ShapeName, Topology, neighbour_graph
from companion.config.reference import FirstKind
from companion.config.vehicle import AgentConfig, load_agent
from companion.geometry.formations import smallest_distance
from companion.tools.subject import load_subject
from sitl.flight.new_scenario import new_scenario
from sitl.flight.scenario import Scenario, load_scenario

SHAPES, TOPOLOGIES, REFERENCES = get_args(ShapeName), get_args(Topology), get_args(FirstKind)
FIELD = ("--origin", "47.4", "8.5", "488")


def scenario_of(folder: Path, new: NewFormation) -> Scenario:
    output = new_scenario(new, folder)
    assert f"sitl run {folder / new.name}.yaml" in output
    return load_scenario(folder / f"{new.name}.yaml")


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_every_shape_with_every_topology_and_count_loads(shape: ShapeName, topology: Topology, tmp_path: Path) -> None:
    for count in (2, 3, 4, 7, 12):
        reference = REFERENCES[count % len(REFERENCES)]
        heading = ("fixed", "course")[count // 4 % 2]
        new = NewFormation(
            name=f"n{count}", vehicles=count, shape=shape, topology=topology, reference=reference, heading=heading
        )
        scenario = scenario_of(tmp_path, new)
        slots = {member.id: member.slot_enu_m for member in scenario.fleet.vehicles}
        assert reached_from(neighbour_graph(scenario.fleet.neighbours, slots), [1]) == set(range(1, count + 1))
        assert smallest_distance(list(slots.values())) == pytest.approx(3.0, abs=0.003)
        starts = scenario.starts_enu_m.values()
        assert min(dist(a, b) for a, b in combinations(starts, 2)) >= scenario.fleet.separation_m
    assert load_subject(tmp_path / "n12.yaml").fleet == scenario.fleet


@pytest.mark.parametrize("count", [2, 5, 12])
def test_double_stays_connected_without_any_one_vehicle(count: int, tmp_path: Path) -> None:
    scenario = scenario_of(tmp_path, NewFormation(name="a", vehicles=count, shape="v", topology="double"))
    path = tmp_path / "a.yaml"
    path.write_text(path.read_text().replace("  separation_m", "  when_one_leaves: close_up\n  separation_m"))
    assert load_scenario(path).fleet.neighbours == scenario.fleet.neighbours


def test_a_larger_formation_gets_a_longer_lap_and_a_larger_fence(tmp_path: Path) -> None:
    laps = {}
    for spacing_m in (3.0, 30.0):
        new = NewFormation(
            name=f"s{spacing_m:.0f}",
            vehicles=5,
            shape="column",
            spacing_m=spacing_m,
            reference="circle",
            heading="course",
        )
        scenario = scenario_of(tmp_path, new)
        laps[spacing_m] = (flight_time_s(scenario.reference), scenario.fleet.envelope.fence_max_enu_m[0])
    assert laps[30.0] > laps[3.0]


def test_choices_out_of_bounds_are_refused_together(tmp_path: Path) -> None:
    new = NewFormation(name="V on circle", vehicles=1, spacing_m=0.1, height_m=0.0, may_lead=(1, 9))
    with pytest.raises(ConfigError) as caught:
        new_scenario(new, tmp_path)
    assert [line.split(": ")[1] for line in caught.value.lines] == [
        "name", "--vehicles", "--spacing", "--height", "--may-lead"
    ]  # fmt: skip
    assert list(tmp_path.iterdir()) == []


def test_a_scenario_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("mine")
    with pytest.raises(ConfigError, match=r"a\.yaml: exists; choose another name"):
        new_scenario(NewFormation(name="a", vehicles=2), tmp_path)
    assert path.read_text() == "mine"


# ---------------------------------------------------------------- companion init


def fleet_of(folder: Path, *arguments: str) -> list[AgentConfig]:
    assert main(["init", str(folder), *FIELD, *arguments]) == 0
    return [load_agent(path) for path in sorted(folder.glob("vehicle-*.yaml"))]


def test_the_files_of_a_fleet_agree(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    agents = fleet_of(tmp_path / "field", "--vehicles", "4", "--shape", "v", "--may-lead", "2", "--autopilot", "px4")
    assert [agent.vehicle.id for agent in agents] == [1, 2, 3, 4]
    assert len({agent.fleet.formation_hash() for agent in agents}) == 1
    assert [agent.vehicle.reference is not None for agent in agents] == [True, True, False, False]
    assert agents[0].fleet.successors == (2,)
    assert {agent.vehicle.autopilot for agent in agents} == {"px4"}
    output = capsys.readouterr().out
    assert {agent.vehicle.identity for agent in agents} == {"identity"}
    assert "companion provision new" in output


@pytest.mark.parametrize(("spacing_m", "separation_m"), [(3, 1.5), (5, 2.5), (12, 2.5)])
def test_outdoors_vehicles_keep_off_by_the_error_of_gps(spacing_m: int, separation_m: float, tmp_path: Path) -> None:
    agents = fleet_of(tmp_path / "field", "--vehicles", "4", "--spacing", str(spacing_m))
    assert {agent.fleet.separation_m for agent in agents} == {separation_m}
    assert main(["init", str(tmp_path / "hall"), "--origin", "indoor", "--vehicles", "4", "--spacing", "5"]) == 0
    assert load_agent(tmp_path / "hall" / "vehicle-1.yaml").fleet.separation_m == 1.0


def test_without_security_the_files_are_copied_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    agents = fleet_of(tmp_path / "field", "--vehicles", "4", "--security", "none")
    assert {agent.vehicle.identity for agent in agents} == {None}
    assert agents[0].fleet.security == "none"
    output = capsys.readouterr().out
    assert "scp" in output and "192.168.10.14:/etc/companion/" in output


def test_every_pair_of_vehicles_has_one_connection(tmp_path: Path) -> None:
    agents = fleet_of(
        tmp_path, "--vehicles", "3", "--address", "127.0.0.1:{id+7447}", "--mavlink", "udpin:127.0.0.1:{id+14539}"
    )
    zenoh = [agent.zenoh for agent in agents]
    assert [one.listen for one in zenoh] == [(f"tcp/127.0.0.1:{port}",) for port in (7448, 7449, 7450)]
    for one, other in combinations(zenoh, 2):
        assert (set(one.listen) <= set(other.connect)) != (set(other.listen) <= set(one.connect))
    assert [agent.vehicle.mavlink for agent in agents] == [f"udpin:127.0.0.1:{port}" for port in (14540, 14541, 14542)]


def test_addresses_can_be_a_list(tmp_path: Path) -> None:
    agents = fleet_of(tmp_path, "--vehicles", "2", "--address", "drone-a.local", "10.0.0.7:7000")
    assert agents[0].zenoh.listen == ("tls/0.0.0.0:7447",)
    assert agents[1].zenoh.listen == ("tls/0.0.0.0:7000",)
    assert agents[1].zenoh.connect == ("tls/drone-a.local:7447",)


@pytest.mark.parametrize("security", [(), ("--security", "none")])
def test_on_one_network_segment_states_are_datagrams(
    security: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    agents = fleet_of(tmp_path, "--vehicles", "3", "--address", "10.0.7.{id+20}", *security)
    assert {agent.fleet.multicast for agent in agents} == {"239.255.7.21:7446"}
    assert [agent.datagrams and agent.datagrams.listen for agent in agents] == [
        f"10.0.7.{i}:7446" for i in (21, 22, 23)
    ]
    (said,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("states: ")]
    assert "239.255.7.21:7446, as all addresses are in 10.0.7.0/24; over Zenoh without multicast in fleet.yaml" in said
    assert "# states as datagrams: all addresses are in 10.0.7.0/24" in (tmp_path / "fleet.yaml").read_text()


def test_two_fleets_of_one_segment_do_not_share_a_group(tmp_path: Path) -> None:
    fleets = [
        fleet_of(tmp_path / host, "--vehicles", "2", "--address", f"10.0.7.{{id+{host}}}") for host in ("0", "10")
    ]
    assert len({agents[0].fleet.multicast for agents in fleets}) == 2


@pytest.mark.parametrize(
    ("addresses", "why"),
    [
        (["drone-{id}.local"], "'drone-1.local' is no IPv4 address"),
        (["10.0.0.1", "10.0.0.02"], "'10.0.0.02' is no IPv4 address"),
        (["10.0.0.1", "drone-b"], "'drone-b' is no IPv4 address"),
        (["127.0.0.1:{id+7447}"], "all vehicles are on one computer"),
        (["10.0.{id}.5"], "not all addresses are in 10.0.1.0/24, that of vehicle 1"),
        (["127.0.0.1", "10.0.0.1"], "not all addresses are in 127.0.0.0/24, that of vehicle 1"),
        (["8.8.8.{id}"], "8.8.8.0/24 is no local network"),
        (["100.64.0.{id}"], "100.64.0.0/24 is no local network"),
    ],
)
def test_elsewhere_states_go_over_zenoh(
    addresses: list[str], why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    agents = fleet_of(tmp_path, "--vehicles", "2", "--address", *addresses)
    assert {agent.datagrams for agent in agents} == {None}
    assert f"states: over Zenoh, as {why}; multicast in fleet.yaml" in capsys.readouterr().out


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_vehicle_files_load_for_every_shape_and_topology(shape: str, topology: str, tmp_path: Path) -> None:
    assert len(fleet_of(tmp_path, "--vehicles", "6", "--shape", shape, "--topology", topology)) == 6


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["--origin", "47.4", "8.5"], "--origin: 47.4 8.5: expected LATITUDE LONGITUDE ALTITUDE_AMSL"),
        (["--origin", "97.4", "8.5", "1"], "latitude_deg: 97.4: expected a number <= 85.0"),
        (["--address", "10.0.0.1"], "--address: '10.0.0.1': is that of two vehicles"),
        (["--address", "a", "b"], "--address: 2 given for 3 vehicles"),
        (["--address", "a", "b", "c:99999"], "--address: 'c:99999': expected HOST or HOST:PORT"),
        (["--mavlink", "/dev/ttyACM0"], "mavlink: '/dev/ttyACM0': expected udpin:HOST:PORT"),
        (["--hover-thrust", "2"], "hover_thrust_norm: 2: expected a number <= 0.9"),
        (["--name", "My Fleet"], "name: 'My Fleet': expected at most 41"),
        (["--may-lead", "4"], "--may-lead: [4]: expected some of 2 to 3"),
    ],
)
def test_a_wrong_choice_is_named_and_nothing_is_written(
    arguments: list[str], error: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["init", str(tmp_path), *FIELD, "--vehicles", "3", *arguments]) == 2
    assert error in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_no_file_of_a_fleet_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "vehicle-2.yaml").write_text("mine")
    assert main(["init", str(tmp_path), *FIELD, "--vehicles", "2"]) == 2
    assert "vehicle-2.yaml: exists" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["vehicle-2.yaml"]


def test_indoors_the_fleet_needs_no_place_on_earth(tmp_path: Path) -> None:
    assert main(["init", str(tmp_path), "--origin", "indoor", "--vehicles", "2"]) == 0
    assert load_agent(tmp_path / "vehicle-1.yaml").fleet.origin == "indoor"
