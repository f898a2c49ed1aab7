"""The vehicle file as it goes to its board, as text."""

from pathlib import Path

import pytest
import yaml

from companion.security.fleet_folder import BoardFileError, board_vehicle_file
from secured_fleet import fleet_files

BLOCK = """\
# tcp/10.0.0.1:7447 is the first vehicle
id: 3   # tcp/ here
mavlink: tcp:10.0.0.9:5760
zenoh:
  # tcp/10.0.0.3:7447 before
  listen: [tcp/0.0.0.0:7447]   # all of tcp/
  connect:
    - "tcp/10.0.0.1:7447#iface=wlan0"
    - 'tcp/10.0.0.2:7447'
    - udp/10.0.0.4:7447
    - ws/tcp/10.0.0.4:7447

datagrams: {listen: "tcp/0:1"}
"""
CHANGED = """\
# tcp/10.0.0.1:7447 is the first vehicle
id: 3   # tcp/ here
mavlink: tcp:10.0.0.9:5760
zenoh:
  # tcp/10.0.0.3:7447 before
  listen: [tls/0.0.0.0:7447]   # all of tcp/
  connect:
    - "tls/10.0.0.1:7447#iface=wlan0"
    - 'tls/10.0.0.2:7447'
    - udp/10.0.0.4:7447
    - ws/tcp/10.0.0.4:7447

datagrams: {listen: "tcp/0:1"}
identity: identity           # key and certificate; from here on only admitted participants connect
"""


def test_only_endpoints_change_and_the_identity_comes_last() -> None:
    assert board_vehicle_file(BLOCK) == CHANGED


def test_a_second_time_changes_nothing() -> None:
    assert board_vehicle_file(CHANGED) == CHANGED


@pytest.mark.parametrize(
    ("text", "changed"),
    [
        ("id: 1\nidentity: old/folder  # mine\nzenoh: {}\n", "id: 1\nidentity: identity  # mine\nzenoh: {}\n"),
        ("identity: x", "identity: identity"),
        ("identity: x\r\nid: 1\r\n", "identity: identity\r\nid: 1\r\n"),
        (
            "identity: identity\nzenoh: {listen: [tcp/a:1, tcp/b:2]} # tcp/\n",
            "identity: identity\nzenoh: {listen: [tls/a:1, tls/b:2]} # tcp/\n",
        ),
    ],
)
def test_an_identity_is_replaced_where_it_is(text: str, changed: str) -> None:
    assert board_vehicle_file(text) == changed


def test_a_last_line_without_its_end_gets_one() -> None:
    assert board_vehicle_file("id: 1").splitlines()[0] == "id: 1"


@pytest.mark.parametrize(
    "text",
    ["{id: 1, zenoh: {listen: [tcp/a:1]}}", "identity:\n  folder: x\n", "id: 1\n...\n", "- id", "a: [", ""],
)
def test_what_cannot_be_changed_line_by_line_is_refused(text: str) -> None:
    with pytest.raises(BoardFileError):
        board_vehicle_file(text)


def test_the_files_of_init_change_in_nothing_else(tmp_path: Path) -> None:
    folder = fleet_files(tmp_path / "field", vehicles=3)
    for path in folder.glob("vehicle-*.yaml"):
        before = yaml.safe_load(path.read_text())
        after = yaml.safe_load(board_vehicle_file(path.read_text()))
        assert after == before | {"identity": "identity"}
