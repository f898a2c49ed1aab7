"""Check of the ports of a fleet before its processes start."""

import socket

import pytest

from companion.types.autopilot import AutopilotKind
from sitl.links.free_ports import PortInUseError, reserved_ports
from sitl.links.ports import ports_of


def check_ports(ids: list[int], kind: AutopilotKind, offset: int) -> None:
    """Reserve the ports of these vehicles for a moment. Raises PortInUseError."""
    with reserved_ports(dict.fromkeys(ids, kind), offset):
        pass


def test_a_check_of_free_ports_leaves_them_free() -> None:
    check_ports([1, 2], AutopilotKind.PX4, 2300)
    check_ports([1, 2], AutopilotKind.PX4, 2300)


def test_a_port_in_use_is_named() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", ports_of(2, 2300).companion))
        with pytest.raises(PortInUseError, match=r"^UDP port 16841, wanted by agent 2 .* --port-offset 2400$"):
            check_ports([1, 2], AutopilotKind.PX4, 2300)


@pytest.mark.parametrize("link", ["true_position", "true_source"])
def test_the_ports_of_true_positions_are_checked(link: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", getattr(ports_of(2, 2300), link)))
        with pytest.raises(PortInUseError, match=r"^UDP port 217[15]1, wanted by the true position of vehicle 2"):
            check_ports([1, 2], AutopilotKind.PX4, 2300)


@pytest.mark.parametrize(
    ("ids", "offset", "message"),
    [
        ([11], 0, r"^port 14550 is wanted by agent 11 towards its autopilot and by a ground station; .* 100,"),
        ([1], 10, r"^port 14550 is wanted by agent 1 towards its autopilot and by a ground station; .* 110,"),
        (
            [1, 41],
            2300,
            r"^port 16880 is wanted by agent 41 towards its autopilot and by autopilot 1 towards its agent;",
        ),
    ],
)
def test_a_port_with_two_uses_is_refused_in_one_line(ids: list[int], offset: int, message: str) -> None:
    with pytest.raises(PortInUseError, match=message) as caught:
        check_ports(ids, AutopilotKind.PX4, offset)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("link", ["tcp", "tcp_agent", "tcp_true_position"])
def test_the_tcp_ports_of_an_arducopter_are_checked(link: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as other:
        other.bind(("127.0.0.1", getattr(ports_of(2, 2300), link)))
        other.listen()
        with pytest.raises(PortInUseError, match=r"^TCP port 807[023], wanted by autopilot 2"):
            check_ports([1, 2], AutopilotKind.ARDUPILOT, 2300)
        check_ports([1, 2], AutopilotKind.PX4, 2300)
