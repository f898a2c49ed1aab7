"""Files of the processes of one flight: the scenario, the fleet, and one file per agent and stand-in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec
import yaml
from msgspec.structs import replace

from companion.config.fleet import FleetConfig
from companion.config.named_files import carried
from companion.config.values import MAX_DRAG_1_S, VehicleId
from companion.config.vehicle import DatagramEndpoints, RecordingSettings, VehicleConfig, ZenohEndpoints
from companion.ground.mocap.file import MocapFile
from companion.mavlink.autopilot_types import PROFILES
from companion.types.autopilot import AutopilotKind
from sitl.autopilots.autopilot import known_or
from sitl.autopilots.types import AUTOPILOT_TYPES, hover_thrust_norm
from sitl.flight.external import ReachedVehicle
from sitl.flight.scenario import Scenario
from sitl.links.cameras import CamerasFile, body_name
from sitl.links.emulated_network import NetworkFile, emulated_host
from sitl.links.ports import LOOPBACK, capture_ports, ports_of, states_group, zenoh_endpoint
from sitl.vehicle.config import AutopilotFile, Links, StandIn

ARMABLE_IN_SCENARIOS_S = 4.0


def ids_of(scenario: Scenario) -> list[VehicleId]:
    return sorted(member.id for member in scenario.fleet.vehicles)


def autopilots_of(scenario: Scenario) -> dict[int, AutopilotKind]:
    """The autopilot of every stand-in, by id."""
    return {i: scenario.stand_in_of(i).autopilot for i in ids_of(scenario)}


def autopilot_path(folder: Path, vehicle_id: int) -> Path:
    return folder / f"autopilot_{vehicle_id}.yaml"


def truth_path(folder: Path, vehicle_id: int) -> Path:
    return folder / f"truth_{vehicle_id}.csv"


def estimated_path(folder: Path, vehicle_id: int) -> Path:
    return folder / f"estimated_{vehicle_id}.csv"


def write_files(
    scenario: Scenario, folder: Path, port_offset: int, external: Mapping[int, ReachedVehicle] | None = None
) -> None:
    """scenario.yaml as flown, fleet.yaml, vehicle_N.yaml, autopilot_N.yaml for stand-ins.

    Also network.yaml for disturbed links, and what `write_cameras` writes where stand-ins have no GPS.
    """
    write_scenario(scenario, folder)
    _write_yaml(folder / "fleet.yaml", _on_this_machine(scenario, port_offset))
    captured = captured_ids(scenario) if external is None else []
    for vehicle_id in ids_of(scenario):
        reached = reached_stand_in(scenario, vehicle_id, port_offset) if external is None else external[vehicle_id]
        _write_yaml(folder / f"vehicle_{vehicle_id}.yaml", vehicle_file(scenario, reached, port_offset))
        if external is None:
            seen_by = capture_ports(port_offset).truth if vehicle_id in captured else None
            content = replace(autopilot_file(scenario, vehicle_id), truth_port=seen_by)
            _write_yaml(autopilot_path(folder, vehicle_id), content)
    if captured:
        write_cameras(scenario, folder, port_offset)
    if scenario.links.disturb_peers:
        write_network(scenario, scenario.links, folder, port_offset)


def cameras_path(folder: Path) -> Path:
    return folder / "cameras.yaml"


def mocap_path(folder: Path) -> Path:
    return folder / "mocap.yaml"


def captured_ids(scenario: Scenario) -> list[VehicleId]:
    """The vehicles that a motion-capture system sees: those of a fleet indoors whose stand-ins have no GPS."""
    if scenario.fleet.origin != "indoor":
        return []
    return [i for i in ids_of(scenario) if scenario.stand_in_of(i).positioning == "external_vision"]


def write_cameras(scenario: Scenario, folder: Path, port_offset: int) -> None:
    """cameras.yaml of the motion-capture system, and mocap.yaml of `companion mocap`, which reads it."""
    captured, ports, stand_in = captured_ids(scenario), capture_ports(port_offset), scenario.stand_in
    cameras = CamerasFile(
        vehicles=tuple(captured),
        port=ports.natnet,
        data_port=ports.data,
        truth_port=ports.truth,
        seed=stand_in.seed,
        faults=stand_in.capture_faults,
    )
    mocap = MocapFile(
        fleet="fleet.yaml",
        system="natnet",
        host=LOOPBACK,
        port=ports.natnet,
        up=cameras.up,
        forward=cameras.forward,
        bodies={body_name(i): i for i in captured},
    )
    _write_yaml(cameras_path(folder), cameras)
    _write_yaml(mocap_path(folder), mocap)


def network_path(folder: Path) -> Path:
    return folder / "network.yaml"


def write_network(scenario: Scenario, links: Links, folder: Path, port_offset: int) -> None:
    """network.yaml with these links."""
    network = NetworkFile(
        vehicles=tuple(ids_of(scenario)), links=links, seed=scenario.stand_in.seed, port_offset=port_offset
    )
    _write_yaml(network_path(folder), network)


def write_scenario(scenario: Scenario, folder: Path) -> None:
    """scenario.yaml as flown."""
    _write_yaml(folder / "scenario.yaml", scenario)


def reached_stand_in(scenario: Scenario, vehicle_id: int, port_offset: int) -> ReachedVehicle:
    """Endpoint, hover thrust and drag of a scenario's stand-in."""
    stand_in, ports = scenario.stand_in_of(vehicle_id), ports_of(vehicle_id, port_offset)
    endpoints = {  # the defaults of the autopilots' own simulations
        AutopilotKind.PX4: f"udpin:{LOOPBACK}:{ports.companion}",
        AutopilotKind.ARDUPILOT: f"tcp:{LOOPBACK}:{ports.tcp}",
    }
    return ReachedVehicle(
        id=vehicle_id,
        mavlink=endpoints[stand_in.autopilot],
        hover_thrust_norm=hover_thrust_norm(stand_in),
        drag_1_s=drag_1_s(stand_in),
    )


def known_drag_1_s(scenario: Scenario) -> float:
    """The drag in the vehicle files of a scenario whose stand-ins are alike."""
    return known_or(scenario.assumed.drag_1_s, drag_1_s(scenario.stand_in))


def drag_1_s(stand_in: StandIn) -> float:
    """What an agent may know of the drag of its vehicle."""
    airframe = stand_in.airframe
    return min(airframe.drag_n_per_m_s / airframe.mass_kg, MAX_DRAG_1_S)


def vehicle_file(scenario: Scenario, reached: ReachedVehicle, port_offset: int) -> VehicleConfig:
    """An agent's file. Only a vehicle that may lead has the reference."""
    member, assumed, vehicle_id = scenario.fleet.member(reached.id), scenario.assumed, reached.id
    assert member is not None  # a vehicle of this fleet
    return VehicleConfig(
        id=vehicle_id,
        fleet="fleet.yaml",
        mavlink=reached.mavlink,
        autopilot=reached.autopilot,
        hover_thrust_norm=known_or(assumed.hover_thrust_norm, reached.hover_thrust_norm),
        drag_1_s=known_or(assumed.drag_1_s, reached.drag_1_s),
        zenoh=_zenoh_endpoints(scenario, vehicle_id, port_offset),
        datagrams=_datagram_endpoints(scenario, vehicle_id, port_offset),
        reference=scenario.reference if member.can_lead else None,
        recording=RecordingSettings(folder="."),
    )


def _on_this_machine(scenario: Scenario, port_offset: int) -> FleetConfig:
    """The fleet with the address of each agent, and with a multicast group for datagrams on undisturbed links."""
    fleet, multicast = scenario.fleet, scenario.fleet.multicast
    members = [
        replace(member, address=f"{LOOPBACK}:{ports_of(member.id, port_offset).zenoh}") for member in fleet.vehicles
    ]
    if multicast is None and scenario.links.peer_transport == "udp" and not scenario.links.disturb_peers:
        multicast = states_group(ids_of(scenario), port_offset)
    return replace(fleet, vehicles=tuple(members), multicast=multicast)


def _zenoh_endpoints(scenario: Scenario, vehicle_id: int, port_offset: int) -> ZenohEndpoints | None:
    """None for the addresses of the fleet file; on disturbed links the agents reach each other through the emulated network."""
    if not scenario.links.disturb_peers:
        return None
    reached = _peer_addresses(scenario, vehicle_id, port_offset)
    return ZenohEndpoints(
        listen=(zenoh_endpoint(vehicle_id, port_offset),),
        connect=tuple(f"tcp/{address}" for i, address in reached.items() if i < vehicle_id),
    )


def _datagram_endpoints(scenario: Scenario, vehicle_id: int, port_offset: int) -> DatagramEndpoints | None:
    """None for the multicast of the fleet file, or for states over Zenoh; otherwise over the emulated network."""
    if scenario.links.peer_transport == "tcp" or not scenario.links.disturb_peers:
        return None
    send_to = tuple(_peer_addresses(scenario, vehicle_id, port_offset).values())
    return DatagramEndpoints(listen=f"{LOOPBACK}:{ports_of(vehicle_id, port_offset).zenoh}", send_to=send_to)


def _peer_addresses(scenario: Scenario, sending_id: int, port_offset: int) -> dict[int, str]:
    """Of all other agents by id, over the emulated network."""
    others = [i for i in ids_of(scenario) if i != sending_id]
    return {i: f"{emulated_host(i, sending_id)}:{ports_of(i, port_offset).zenoh}" for i in others}


def autopilot_file(scenario: Scenario, vehicle_id: int) -> AutopilotFile:
    """A stand-in's file. The world frame is that of the fleet.

    Where the scenario sets nothing else, its parameters are those that an agent requires and it can be armed after 4 s.
    """
    place = scenario.fleet.place
    assert place is not None  # scenario_from accepts no other
    stand_in = scenario.stand_in_of(vehicle_id)
    data = AUTOPILOT_TYPES[stand_in.autopilot].data
    hover_norm = scenario.assumed.hover_thrust_norm
    assumed = {} if hover_norm is None else {PROFILES[stand_in.autopilot].hover_parameter: hover_norm}
    ready_s = ARMABLE_IN_SCENARIOS_S if stand_in.armable_after_s is None else stand_in.armable_after_s
    return AutopilotFile(
        id=vehicle_id,
        world_origin=place,
        start_enu_m=scenario.starts_enu_m[vehicle_id],
        origin_enu_m=scenario.origins_enu_m.get(vehicle_id),
        stand_in=msgspec.structs.replace(
            stand_in, armable_after_s=ready_s, parameters=data.set_up | assumed | stand_in.parameters
        ),
    )


def _write_yaml(path: Path, content: msgspec.Struct) -> None:
    plain = carried(msgspec.to_builtins(content), path.parent)
    path.write_text(yaml.safe_dump(plain, sort_keys=False), encoding="utf-8")
