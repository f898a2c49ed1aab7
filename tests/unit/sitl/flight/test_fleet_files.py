"""Files of the agents and stand-ins of a flight."""

from pathlib import Path

import msgspec
import pytest
import yaml
from msgspec.structs import replace

from common import ROOT
from companion.config.file import ConfigError, load
from companion.config.vehicle import load_agent
from companion.ground.mocap.file import load_mocap
from companion.types.flight import Role
from sitl.flight.files import (
    autopilot_file,
    cameras_path,
    captured_ids,
    ids_of,
    mocap_path,
    network_path,
    reached_stand_in,
    vehicle_file,
    write_cameras,
    write_files,
)
from sitl.flight.scenario import Scenario, load_scenario
from sitl.links.cameras import CamerasFile, body_name
from sitl.links.emulated_network import NetworkFile
from sitl.links.ports import ports_of
from sitl.vehicle.config import AutopilotFile, CaptureFault

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"


@pytest.fixture
def scenario(tmp_path: Path) -> Scenario:
    scenario = load_scenario(PLATOON, ["stand_in.sensors=default", "stand_in.airframe.hover_thrust_norm=0.4"])
    write_files(scenario, tmp_path, 50)
    return scenario


def test_vehicle_files_load_and_share_the_fleet(scenario: Scenario, tmp_path: Path) -> None:
    configs = [load_agent(tmp_path / f"vehicle_{vehicle_id}.yaml") for vehicle_id in (1, 2, 3, 4)]
    for config in configs:
        addresses = [member.address for member in config.fleet.vehicles]
        assert addresses == [f"127.0.0.1:{ports_of(i, 50).zenoh}" for i in (1, 2, 3, 4)]
        members = tuple(replace(member, address=None) for member in config.fleet.vehicles)
        assert replace(config.fleet, vehicles=members, multicast=None) == scenario.fleet
    assert len({config.fleet.formation_hash() for config in configs}) == 1
    assert all(config.vehicle.hover_thrust_norm == 0.4 for config in configs)


def test_only_the_leader_holds_the_reference(scenario: Scenario, tmp_path: Path) -> None:
    for vehicle_id in (1, 2, 3, 4):
        config = load_agent(tmp_path / f"vehicle_{vehicle_id}.yaml")
        leads = config.member.role is Role.LEADER
        assert config.vehicle.reference == (scenario.reference if leads else None)


def test_every_pair_of_agents_has_one_connection(scenario: Scenario, tmp_path: Path) -> None:
    zenoh = {i: load_agent(tmp_path / f"vehicle_{i}.yaml").zenoh for i in scenario.starts_enu_m}
    for i, own in zenoh.items():
        assert own.listen == (f"tcp/127.0.0.1:{ports_of(i, 50).zenoh}",)
        for j, other in zenoh.items():
            if i < j:
                assert (own.listen[0] in other.connect) != (other.listen[0] in own.connect)


def test_states_are_datagrams_to_a_group_of_the_fleet(scenario: Scenario, tmp_path: Path) -> None:
    """Its port is one of those that the fleet has reserved."""
    for i in ids_of(scenario):
        datagrams = load_agent(tmp_path / f"vehicle_{i}.yaml").datagrams
        assert datagrams is not None
        port = ports_of(1, 50).zenoh
        assert (datagrams.listen, datagrams.send_to) == (f"127.0.0.1:{port}", (f"239.255.77.1:{port}",))


@pytest.mark.parametrize(
    ("overrides", "multicast"),
    [(["links.peer_transport=tcp"], None), (["fleet.multicast=239.255.77.9:7446"], "239.255.77.9:7446")],
)
def test_a_transport_that_a_scenario_names_is_kept(overrides: list[str], multicast: str | None, tmp_path: Path) -> None:
    write_files(load_scenario(PLATOON, overrides), tmp_path, 50)
    agent = load_agent(tmp_path / "vehicle_3.yaml")
    assert (agent.fleet.multicast, agent.vehicle.datagrams) == (multicast, None)


def test_two_ways_for_the_states_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"links\.peer_transport: tcp, but fleet\.multicast"):
        load_scenario(PLATOON, ["links.peer_transport=tcp", "fleet.multicast=239.255.77.9:7446"])


@pytest.mark.parametrize("multicast", [(), ("fleet.multicast=239.255.77.9:7446",)])
def test_disturbed_links_lead_over_the_emulated_network(tmp_path: Path, multicast: tuple[str, ...]) -> None:
    """Also those of a fleet with multicast, which would pass it by."""
    scenario = load_scenario(PLATOON, ["links.peer_loss=0.1", "stand_in.seed=3", *multicast])
    write_files(scenario, tmp_path, 50)
    vehicle = load_agent(tmp_path / "vehicle_3.yaml").vehicle
    port_1, port_2, port_4 = (ports_of(i, 50).zenoh for i in (1, 2, 4))
    assert vehicle.zenoh is not None
    assert vehicle.zenoh.connect == (f"tcp/127.1.1.3:{port_1}", f"tcp/127.1.2.3:{port_2}")
    assert vehicle.datagrams is not None
    assert vehicle.datagrams.listen == f"127.0.0.1:{ports_of(3, 50).zenoh}"
    assert vehicle.datagrams.send_to == (f"127.1.1.3:{port_1}", f"127.1.2.3:{port_2}", f"127.1.4.3:{port_4}")
    network = load(network_path(tmp_path), NetworkFile)
    assert (network.vehicles, network.seed, network.port_offset) == ((1, 2, 3, 4), 3, 50)
    assert network.links == scenario.links


def test_a_fleet_indoors_has_cameras_with_its_faults_and_the_file_that_reads_them(
    scenario: Scenario, tmp_path: Path
) -> None:
    lost = CaptureFault(kind="lost", vehicle=2, at_s=30.0, for_s=2.0)
    stand_ins = replace(scenario.stand_in, positioning="external_vision", capture_faults=(lost,), seed=7)
    outdoors = replace(scenario, stand_in=stand_ins)
    indoors = replace(outdoors, fleet=replace(scenario.fleet, origin="indoor"))
    assert (captured_ids(scenario), captured_ids(outdoors), captured_ids(indoors)) == ([], [], [1, 2, 3, 4])
    write_cameras(indoors, tmp_path, 50)
    (tmp_path / "fleet.yaml").write_text(yaml.safe_dump(msgspec.to_builtins(indoors.fleet)), encoding="utf-8")
    cameras, (mocap, fleet, _) = load(cameras_path(tmp_path), CamerasFile), load_mocap(mocap_path(tmp_path))
    assert (cameras.vehicles, cameras.faults, cameras.seed) == ((1, 2, 3, 4), (lost,), 7)
    assert (mocap.port, mocap.bodies[body_name(3)], mocap.up) == (cameras.port, 3, cameras.up)
    assert fleet == indoors.fleet


@pytest.mark.usefixtures("scenario")
def test_other_fleets_have_no_cameras(tmp_path: Path) -> None:
    assert not cameras_path(tmp_path).exists()
    assert load(tmp_path / "autopilot_1.yaml", AutopilotFile).truth_port is None


def test_undisturbed_links_need_no_network(scenario: Scenario, tmp_path: Path) -> None:
    assert not network_path(tmp_path).exists()
    assert not scenario.links.disturb_peers


def test_autopilot_files_hold_the_starts_of_the_scenario(scenario: Scenario, tmp_path: Path) -> None:
    for vehicle_id, start_enu_m in scenario.starts_enu_m.items():
        file = load(tmp_path / f"autopilot_{vehicle_id}.yaml", AutopilotFile)
        assert (file.id, file.start_enu_m) == (vehicle_id, start_enu_m)
        assert file.stand_in == msgspec.structs.replace(
            scenario.stand_in_of(vehicle_id), armable_after_s=4.0, parameters={"COM_OBL_RC_ACT": 5.0}
        )
        assert file.world_origin == scenario.fleet.origin


def test_stand_ins_of_arducopter_use_tcp_and_thrust_and_arm_early() -> None:
    scenario = load_scenario(PLATOON, ["stand_in.autopilot=ardupilot"])
    file = vehicle_file(scenario, reached_stand_in(scenario, 2, 100), 100)
    assert (file.mavlink, file.hover_thrust_norm) == ("tcp:127.0.0.1:5870", 0.365)
    stand_in = autopilot_file(scenario, 2).stand_in
    assert (stand_in.armable_after_s, stand_in.parameters) == (4.0, {"GUID_OPTIONS": 8.0, "GUID_TIMEOUT": 1.0})
    given = load_scenario(
        PLATOON,
        ["stand_in.autopilot=ardupilot", "stand_in.armable_after_s=42", "stand_in.parameters={GUID_OPTIONS: 0}"],
    )
    assert given.stand_in.armable_after_s == 42.0
    assert autopilot_file(given, 1).stand_in.parameters == {"GUID_OPTIONS": 0.0, "GUID_TIMEOUT": 1.0}


def test_unknown_parameters_of_the_autopilot_are_refused() -> None:
    load_scenario(PLATOON, ["stand_in.autopilot=ardupilot", "stand_in.parameters={FS_GCS_ENABLE: 1}"])
    with pytest.raises(ConfigError, match="GUID_TIMEOUT"):
        load_scenario(PLATOON, ["stand_in.autopilot=ardupilot", "stand_in.parameters={GUID_TIMEOUTS: 1}"])
    with pytest.raises(ConfigError, match="px4"):
        load_scenario(PLATOON, ["stand_in.parameters={FS_GCS_ENABLE: 1}"])
