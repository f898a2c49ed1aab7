"""Endpoints that cannot be reached are named with the reason."""

import socket

from companion.ground.current_fleet import unreachable


def test_an_endpoint_without_a_listener_is_unreachable() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        there, refused = (f"tcp/127.0.0.1:{s.getsockname()[1]}" for s in (server, unused))
        assert unreachable([there, refused], linked=()) == {refused: "connection refused; no agent listens there"}


def test_an_unknown_host_is_named() -> None:
    assert unreachable(["tcp/no-such-host.invalid:7447"], ()) == {
        "tcp/no-such-host.invalid:7447": "unknown host no-such-host.invalid"
    }


def test_an_endpoint_over_udp_needs_a_link() -> None:
    endpoint = "udp/127.0.0.1:7447"
    assert unreachable([endpoint], linked=[endpoint]) == {}
    assert unreachable([endpoint], ())[endpoint].startswith("no link over udp to 127.0.0.1")
