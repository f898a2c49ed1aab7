"""Connections that linger when they are closed, and those that say nothing, over real sockets of this process."""

import resource
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import pytest

from common import until
from companion.link.fleet.sockets import (
    OPEN_FILES,
    end_begun,
    hold_silent_connections,
    open_sockets,
    second_name,
    stop_lingering,
)
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
    done = stop_lingering(open_sockets(), set())
    assert not lingers(one)
    assert name(one) in done
    assert name(other) not in done
    other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGERS)
    assert stop_lingering(open_sockets(), done) == {name(one), name(other)}
    assert not lingers(other)
    gone = name(one)
    one.close()
    assert gone not in stop_lingering(open_sockets(), done)


def test_what_is_no_connection_is_left_alone(stack: ExitStack) -> None:
    datagrams = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    pair = [stack.enter_context(end) for end in socket.socketpair()]
    for one in (datagrams, *pair):
        one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGERS)
    stop_lingering(open_sockets(), set())
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


@pytest.fixture
def listener(stack: ExitStack) -> socket.socket:
    """That accepts connections as those of a session do."""
    one = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
    hold_silent_connections([one.getsockname()[1]])
    one.settimeout(20.0)
    return one


def test_the_end_of_a_silent_connection_hands_it_not_over(stack: ExitStack, listener: socket.socket) -> None:
    for _ in range(50):
        socket.create_connection(listener.getsockname()).close()
    speaking = stack.enter_context(socket.create_connection(listener.getsockname()))
    speaking.sendall(b"x")
    accepted, address = listener.accept()
    stack.enter_context(accepted)
    assert address == speaking.getsockname()


def test_the_end_of_a_connection_whose_handshake_is_complete_arrives(stack: ExitStack, listener: socket.socket) -> None:
    other = stack.enter_context(socket.create_connection(listener.getsockname()))
    other.sendall(b"x")
    accepted = stack.enter_context(listener.accept()[0])
    accepted.settimeout(20.0)
    accepted.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGERS)  # as Zenoh does it then
    stop_lingering(open_sockets(), set())
    other.close()
    assert (accepted.recv(1), accepted.recv(1)) == (b"x", b"")


def test_a_handshake_that_is_begun_does_not_break_off(stack: ExitStack, listener: socket.socket) -> None:
    other = stack.enter_context(socket.create_connection(listener.getsockname()))
    other.sendall(b"x")
    accepted = stack.enter_context(listener.accept()[0])
    stop_lingering(open_sockets(), set())
    other.close()
    accepted.settimeout(0.2)
    assert accepted.recv(1) == b"x"
    with pytest.raises(TimeoutError):
        accepted.recv(1)


@pytest.mark.parametrize(("few", "most", "ended"), [(6, 6, 0), (3, 6, 1), (3, 4, 2), (1, 0, 6)])
def test_of_too_many_handshakes_that_were_begun_the_oldest_end(
    stack: ExitStack, listener: socket.socket, few: int, most: int, ended: int
) -> None:
    other = stack.enter_context(socket.create_server(("127.0.0.1", 0)))  # that no session has opened
    made = []
    for _ in range(6):
        made.append(stack.enter_context(socket.create_connection(listener.getsockname())))
        made[-1].sendall(b"x")
        stack.enter_context(listener.accept()[0])
    beside = stack.enter_context(socket.create_connection(other.getsockname()))
    end_begun(open_sockets(), set(), few, most)
    for number, one in enumerate(made):
        one.settimeout(20.0 if number < ended else 0.0)
        if number < ended:
            assert one.recv(1) == b""
        else:
            with pytest.raises(BlockingIOError):
                one.recv(1)
    beside.sendall(b"x")
    assert stack.enter_context(other.accept()[0]).recv(1) == b"x"


def test_a_session_may_have_many_files(stack: ExitStack) -> None:
    own, highest = resource.getrlimit(resource.RLIMIT_NOFILE)
    stack.callback(resource.setrlimit, resource.RLIMIT_NOFILE, (own, highest))
    resource.setrlimit(resource.RLIMIT_NOFILE, (512, highest))
    stack.enter_context(closing(open_session((f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}",), ())))
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == (min(8192, highest), highest)
    resource.setrlimit(resource.RLIMIT_NOFILE, (highest, highest))
    stack.enter_context(closing(open_session((f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}",), ())))
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == (highest, highest)


def test_nothing_stays_open_that_was_looked_at(tmp_path: Path) -> None:
    with (tmp_path / "file").open("w"):
        before = len(list(OPEN_FILES.iterdir()))
        hold_silent_connections()
        stop_lingering(open_sockets(), set())
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
