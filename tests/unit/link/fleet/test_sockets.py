"""Connections that linger when they are closed, and those that say nothing, over real sockets of this process."""

import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import pytest

from common import until
from companion.link.fleet.sockets import OPEN_FILES, hold_silent_connections, second_name, stop_lingering
from companion.link.fleet.zenoh_session import open_session
from processes import free_port

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")

LINGERS = struct.pack("ii", 1, 10)


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def connection(stack: ExitStack) -> socket.socket:
    listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
    client = stack.enter_context(socket.create_connection(listener.getsockname()))
    stack.enter_context(listener.accept()[0])
    return client


def lingers(one: socket.socket) -> bool:
    on, _ = struct.unpack("ii", one.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))
    return bool(on)


def name(one: socket.socket) -> str:
    return str((OPEN_FILES / str(one.fileno())).readlink())


def test_a_connection_that_lingers_does_so_no_longer_and_is_looked_at_once(stack: ExitStack) -> None:
    one, other = connection(stack), connection(stack)
    one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGERS)
    done = stop_lingering(set())
    assert not lingers(one)
    assert name(one) in done
    assert name(other) not in done
    other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGERS)
    assert stop_lingering(done) == {name(one), name(other)}
    assert not lingers(other)
    gone = name(one)
    one.close()
    assert gone not in stop_lingering(done)


def test_what_is_no_connection_is_left_alone(stack: ExitStack) -> None:
    datagrams = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    pair = [stack.enter_context(end) for end in socket.socketpair()]
    for one in (datagrams, *pair):
        one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGERS)
    stop_lingering(set())
    assert all(lingers(one) for one in (datagrams, *pair))


def test_no_connection_of_a_session_lingers(stack: ExitStack) -> None:
    """Both ends, which Zenoh lets linger for 10 s."""
    endpoint = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    first = stack.enter_context(closing(open_session((endpoint,), ())))
    stack.enter_context(closing(open_session((), (endpoint,))))
    until(lambda: first.info.links())
    until(lambda: not any(of_connections(lingers)), each=lambda: time.sleep(0.1))


def test_a_session_takes_no_connection_that_says_nothing(stack: ExitStack) -> None:
    port = free_port(socket.SOCK_STREAM)
    session = stack.enter_context(closing(open_session((f"tcp/127.0.0.1:{port}",), ())))
    for _ in range(200):
        stack.enter_context(socket.create_connection(("127.0.0.1", port)))
    stack.enter_context(closing(open_session((), (f"tcp/127.0.0.1:{port}",))))
    until(lambda: session.info.links())
    assert of_connections(lambda one: one.getsockname()[1] == port and not listens(one)).count(True) == 1


def test_nothing_stays_open_that_was_looked_at(tmp_path: Path) -> None:
    with (tmp_path / "file").open("w"):
        before = len(list(OPEN_FILES.iterdir()))
        hold_silent_connections()
        stop_lingering(set())
        until(lambda: len(list(OPEN_FILES.iterdir())) <= before)


def listens(one: socket.socket) -> bool:
    return bool(one.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN))


def of_connections(ask: Callable[[socket.socket], bool]) -> list[bool]:
    """The answers for the TCP sockets of this process, each by a second name."""
    answers = []
    for entry in list(OPEN_FILES.iterdir()):
        with suppress(OSError), second_name(int(entry.name)) as one:
            if one.proto == socket.IPPROTO_TCP:
                answers.append(ask(one))
    return answers
