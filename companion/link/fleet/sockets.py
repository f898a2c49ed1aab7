"""What Zenoh's TCP sockets need, also below TLS, and Zenoh has no setting for.

Zenoh sets SO_LINGER to 10 s on every connection, and closes it in its one receiving thread. Where the other computer has gone
silent, its kernel acknowledges nothing any more, and close() waits all of these 10 s, in which nothing of anybody is received.
So a thread of this process looks for its connections and switches lingering off: close() returns at once, and the kernel sends
what is left.

Zenoh accepts every connection and waits for its first bytes. A thousand that say nothing take all open files of the process,
and pauses of 0.1 s after each that it gives up keep others out for minutes. So the kernel hands a connection over when it has
said something, as a participant does at once, and not when it ends. Those that have said something and never go on need room
in this process; beyond that room the oldest end.
"""

from __future__ import annotations

import contextlib
import logging
import os
import resource
import socket
import struct
import threading
import time
from array import array
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

# A silent connection is closed after zenoh_session.LEASE_MS at the earliest.
LOOK_S = 0.5
# What a connection has sent is given up when it was not acknowledged for so long: a close waits for it, and a vehicle that
# comes back is refused while its earlier connection is closing. Twice zenoh_session.LEASE_MS.
UNACKNOWLEDGED_MS = 4000
OPEN_FILES = Path("/proc/self/fd")  # Linux
# Seconds for which the kernel holds a connection that says nothing: then Zenoh gets it. Longer than a flight.
SAYS_NOTHING_S = 3600
# That the kernel holds, as far as net.core.somaxconn lets it; and handshakes that may be begun in this process, 12 kB each.
MOST_CONNECTIONS = 4096
MOST_FILES = 2 * MOST_CONNECTIONS  # more can be accepted between two looks
FEW_CONNECTIONS = 64  # handshakes in progress of an honest fleet; of more the oldest is ended, one in each look
SO_ATTACH_FILTER, SO_DETACH_FILTER = 26, 27  # Linux; missing in the socket module
# A program for the kernel: a packet with FIN, in byte 13 of the TCP header, is dropped.
NO_FIN = tuple(
    struct.pack("HBBI", *step)
    for step in ((0x30, 0, 0, 13), (0x45, 0, 1, 0x01), (0x06, 0, 0, 0), (0x06, 0, 0, 0xFFFFFFFF))
)
ANY_PORT = range(65536)
LINGER = struct.Struct("ii")  # on or off, seconds
OFF = LINGER.pack(0, 0)

_log = logging.getLogger(__name__)
_started = threading.Lock()
_ports: set[int] = set()  # where the sessions of this process listen


def keep_from_lingering() -> None:
    """From now on, until this process ends. Without /proc nothing is done."""
    if OPEN_FILES.is_dir() and _started.acquire(blocking=False):
        threading.Thread(target=_look, name="lingering", daemon=True).start()


@contextlib.contextmanager
def second_name(number: int) -> Iterator[socket.socket]:
    """The socket with this file number by another one: nothing of Zenoh is closed with it. Raises OSError for no socket."""
    copy = os.dup(number)
    try:
        opened = socket.socket(fileno=copy)
    except OSError:
        os.close(copy)
        raise
    with opened:
        yield opened


def hold_silent_connections(ports: Collection[int] = ANY_PORT) -> None:
    """Where this process listens at one of these ports now. Without /proc nothing is done.

    What a connection sends before it is handed over comes to the listener: with its FIN it would be handed over. One that is
    accepted drops FIN, too, until its handshake is complete. A FIN is sent again until it is acknowledged, so none is missed.
    RST passes: otherwise the kernel would keep a connection that its other end has reset.
    """
    if not OPEN_FILES.is_dir():
        return
    for entry in OPEN_FILES.iterdir():
        with contextlib.suppress(OSError), second_name(int(entry.name)) as listener:
            if listener.proto == socket.IPPROTO_TCP and _listens(listener) and listener.getsockname()[1] in ports:
                listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_DEFER_ACCEPT, SAYS_NOTHING_S)
                listener.listen(MOST_CONNECTIONS)
                _drop_fin(listener)
                _ports.add(listener.getsockname()[1])


def _drop_fin(listener: socket.socket) -> None:
    steps = array("B", b"".join(NO_FIN))
    described = struct.pack("HP", len(NO_FIN), steps.buffer_info()[0])
    listener.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, described)


def allow_connections() -> None:
    """Connections whose handshake was begun and does not go on take files until they end. By default a process has 1024."""
    own, highest = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST_FILES if highest == resource.RLIM_INFINITY else min(MOST_FILES, highest)
    if own != resource.RLIM_INFINITY and own < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, highest))


def _look() -> None:
    done: set[str] = set()
    while True:
        time.sleep(LOOK_S)
        try:
            sockets = open_sockets()
            done = stop_lingering(sockets, done)
            end_begun(sockets, done)
        except OSError as error:  # too many open files, for example
            _log.debug("connections that linger: %s", error)


def open_sockets() -> dict[int, str]:
    """Names of the sockets of this process, by the number of the file. Raises OSError."""
    names: dict[int, str] = {}
    for number in os.listdir(OPEN_FILES):  # noqa: PTH208 -- with paths a look takes four times as long
        with contextlib.suppress(OSError):  # it was closed meanwhile
            if (name := os.readlink(f"{OPEN_FILES}/{number}")).startswith("socket:"):  # noqa: PTH115
                names[int(number)] = name
    return names


def stop_lingering(sockets: Mapping[int, str], done: set[str]) -> set[str]:
    """Look at these sockets once. `done` and the result: those that do not linger any more, by their names."""
    still = done.intersection(sockets.values())
    for number, name in sockets.items():
        with contextlib.suppress(OSError):  # it was closed meanwhile, or is no such socket
            if name not in still and _stopped(number):
                still.add(name)
    return still


def _stopped(number: int) -> bool:
    """Whether this file is a TCP connection that lingered until now. Raises OSError."""
    with second_name(number) as connection:
        if connection.proto != socket.IPPROTO_TCP or _listens(connection):
            return False
        on, _ = LINGER.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER.size))
        if not on:
            return False
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, OFF)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNACKNOWLEDGED_MS)
        with contextlib.suppress(OSError):  # it has none where this end has connected
            connection.setsockopt(socket.SOL_SOCKET, SO_DETACH_FILTER, 0)
        return True


def end_begun(
    sockets: Mapping[int, str], done: set[str], few: int = FEW_CONNECTIONS, most: int = MOST_CONNECTIONS
) -> None:
    """End the oldest of the accepted connections that are not in `done`: one of more than `few`, all beyond `most`.

    Zenoh lets a connection linger, so that it comes into `done`, when its handshake is complete.
    """
    if len(sockets) - len(done) <= few:
        return
    begun: list[tuple[int, int]] = []  # number of the socket, which rises with time; of the file
    for number, name in sockets.items():
        with contextlib.suppress(OSError), second_name(number) as one:
            if name not in done and one.proto == socket.IPPROTO_TCP and _is_accepted(one):
                begun.append((os.fstat(number).st_ino, number))
    for inode, number in sorted(begun)[: max(len(begun) - most, int(len(begun) > few))]:
        with contextlib.suppress(OSError), second_name(number) as one:
            if os.fstat(one.fileno()).st_ino == inode:  # the file has not become another one meanwhile
                one.shutdown(socket.SHUT_RDWR)


def _is_accepted(connection: socket.socket) -> bool:
    """Whether it came to a port where a session of this process listens. Raises OSError."""
    return connection.getsockname()[1] in _ports and not _listens(connection)


def _listens(one: socket.socket) -> bool:
    return bool(one.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN))
