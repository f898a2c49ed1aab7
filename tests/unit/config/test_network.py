"""Addresses in the fleet file, and what reaches beyond this machine without an identity."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.config.file import ConfigError
from companion.config.vehicle import AgentConfig, load_agent

FLEET = """\
name: net
origin: indoor
vehicles:
  - {{id: 1, role: leader, slot_enu_m: [0.0, 0.0, 0.0], address: "{host}:7001"}}
  - {{id: 2, role: follower, slot_enu_m: [-3.0, 0.0, 0.0], address: "{host}:7002"}}
  - {{id: 3, role: follower, slot_enu_m: [-6.0, 0.0, 0.0], address: "{host}:7003"}}
neighbours: {{kind: edges, edges: [[1, 2], [2, 3]]}}
"""
VEHICLE = "id: 2\nfleet: fleet.yaml\nmavlink: udpin:127.0.0.1:14540\nhover_thrust_norm: 0.5\n"
NEEDED = "could command the vehicle; expected an identity"


def agent(folder: Path, host: str = "10.0.0.9", fleet: str = "", vehicle: str = "") -> AgentConfig:
    (folder / "fleet.yaml").write_text(FLEET.format(host=host) + fleet)
    (folder / "vehicle-2.yaml").write_text(VEHICLE + vehicle)
    return load_agent(folder / "vehicle-2.yaml")


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "127.1.2.3"])
def test_on_this_machine_no_identity_is_needed(tmp_path: Path, host: str) -> None:
    zenoh = agent(tmp_path, host).zenoh
    assert (zenoh.listen, zenoh.connect) == ((f"tcp/{host}:7002",), (f"tcp/{host}:7001",))


@pytest.mark.parametrize(
    "host", ["10.0.0.9", "drone.local", "0.0.0.0", "127.0.0.1.example.org", "localhost.example.org"]
)
def test_in_a_network_an_identity_is_needed(tmp_path: Path, host: str) -> None:
    with pytest.raises(ConfigError, match=NEEDED):
        agent(tmp_path, host)


def test_security_none_is_the_word_of_the_fleet(tmp_path: Path) -> None:
    zenoh = agent(tmp_path, fleet="security: none\n").zenoh
    assert (zenoh.listen, zenoh.connect) == (("tcp/0.0.0.0:7002",), ("tcp/10.0.0.9:7001",))


@pytest.mark.parametrize(("transport", "protocol"), [("tcp", "tls"), ("quic", "quic")])
def test_with_an_identity_links_are_encrypted(tmp_path: Path, transport: str, protocol: str) -> None:
    zenoh = agent(tmp_path, fleet=f"transport: {transport}\n", vehicle="identity: identity\n").zenoh
    assert (zenoh.listen, zenoh.connect) == ((f"{protocol}/0.0.0.0:7002",), (f"{protocol}/10.0.0.9:7001",))


def test_quic_needs_an_identity_also_on_this_machine(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="transport quic needs the certificate"):
        agent(tmp_path, "127.0.0.1", fleet="transport: quic\n")


@pytest.mark.parametrize(
    "section",
    [
        'zenoh: {listen: ["tcp/0.0.0.0:7447"]}\n',
        'zenoh: {connect: ["tcp/10.0.0.9:7447#iface=eth0"]}\n',
        'datagrams: {listen: "0.0.0.0:7447", send_to: ["127.0.0.1:7448"]}\n',
        'datagrams: {listen: "127.0.0.1:7447", send_to: ["10.0.0.255:7447"]}\n',
        'datagrams: {listen: "10.0.0.9:7447", send_to: ["239.255.77.1:7447"]}\n',
        'datagrams: {listen: "127.0.0.1:7447", send_to: ["239.255.77.1.example.org:7447"]}\n',
    ],
)
def test_endpoints_of_the_vehicle_file_count_too(tmp_path: Path, section: str) -> None:
    with pytest.raises(ConfigError, match=NEEDED):
        agent(tmp_path, "127.0.0.1", vehicle=section)


@pytest.mark.parametrize(
    "address",
    ["10.0.0.9", "10.0.0.9:7001/x", "a b:1", "tcp/10.0.0.9:7447", "'[fd00::9]:7447'", "'[::1]:7447'", "'fd00::9:7447'"],
)
def test_an_address_is_a_host_and_a_port(tmp_path: Path, address: str) -> None:
    agent(tmp_path, "127.0.0.1")
    with pytest.raises(ConfigError, match=r"vehicles\[0\]\.address: .*expected HOST:PORT"):
        (tmp_path / "fleet.yaml").write_text(FLEET.format(host="127.0.0.1").replace("127.0.0.1:7001", address))
        load_agent(tmp_path / "vehicle-2.yaml")


def test_multicast_goes_out_where_the_vehicle_has_its_address(tmp_path: Path) -> None:
    loaded = agent(tmp_path, fleet="multicast: 239.255.77.1:7446\n", vehicle="identity: identity\n")
    assert loaded.datagrams is not None
    assert (loaded.datagrams.listen, loaded.datagrams.send_to) == ("10.0.0.9:7446", ("239.255.77.1:7446",))
    with pytest.raises(ConfigError, match=NEEDED):
        agent(tmp_path, fleet="multicast: 239.255.77.1:7446\n")


def test_multicast_on_loopback_stays_on_this_machine(tmp_path: Path) -> None:
    loaded = agent(tmp_path, "127.0.0.1", fleet="multicast: 239.255.77.1:7446\n")
    assert loaded.datagrams is not None
    assert (loaded.datagrams.listen, loaded.datagrams.send_to) == ("127.0.0.1:7446", ("239.255.77.1:7446",))


@pytest.mark.parametrize("group", ["10.0.0.9:7446", "fleet.local:7446", "255.255.255.255:7446"])
def test_multicast_names_a_group(tmp_path: Path, group: str) -> None:
    with pytest.raises(ConfigError, match=r"multicast: .*no multicast group; expected one from 224\.0\.0\.0"):
        agent(tmp_path, fleet=f"multicast: {group}\n", vehicle="identity: identity\n")
