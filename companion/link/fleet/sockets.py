"""What Zenoh's TCP sockets need, also below TLS, and Zenoh has no setting for.

Zenoh sets SO_LINGER to 10 s on every connection, and closes it in its one receiving thread. Where the other computer has gone
silent, its kernel acknowledges nothing any more, and close() waits all of these 10 s, in which nothing of anybody is received.
So a thread of this process looks for its connections and switches lingering off: close() returns at once, and the kernel sends
what is left.

Zenoh accepts every connection and waits for its first bytes. A thousand that say nothing take all open files of the process,
and pauses of 0.1 s after each that it gives up keep others out for minutes. So the kernel hands a connection over when it has
said something, as a participant does at once.
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path

# A silent connection is closed after zenoh_session.LEASE_MS at the earliest.
LOOK_S = 0.5
# What a connection has sent is given up when it was not acknowledged for so long: a close waits for it, and a vehicle that
# comes back is refused while its earlier connection is closing. Twice zenoh_session.LEASE_MS.
UNACKNOWLEDGED_MS = 4000
OPEN_FILES = Path("/proc/self/fd")  # Linux
# Seconds for which the kernel holds a connection that says nothing: then Zenoh gets it. Longer than a flight.
SAYS_NOTHING_S = 3600
WAITING = 4096  # connections that the kernel holds, as far as net.core.somaxconn lets it
LINGER = struct.Struct("ii")  # on or off, seconds
OFF = LINGER.pack(0, 0)

_log = logging.getLogger(__name__)
_started = threading.Lock()


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


def hold_silent_connections() -> None:
    """At all sockets on which this process accepts connections now. Without /proc nothing is done."""
    if not OPEN_FILES.is_dir():
        return
    for entry in OPEN_FILES.iterdir():
        with contextlib.suppress(OSError), second_name(int(entry.name)) as listener:
            if listener.proto == socket.IPPROTO_TCP and listener.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_DEFER_ACCEPT, SAYS_NOTHING_S)
                listener.listen(WAITING)


def _look() -> None:
    done: set[str] = set()
    while True:
        time.sleep(LOOK_S)
        try:
            done = stop_lingering(done)
        except OSError as error:  # too many open files, for example
            _log.debug("connections that linger: %s", error)


def stop_lingering(done: set[str]) -> set[str]:
    """Look at all sockets of this process once. `done` and the result: those that do not linger any more, by their names.

    Raises OSError.
    """
    still: set[str] = set()
    for entry in OPEN_FILES.iterdir():
        try:
            name = str(entry.readlink())
            if name in done or (name.startswith("socket:") and _stopped(int(entry.name))):
                still.add(name)
        except OSError:
            continue  # it was closed meanwhile, or is no such socket
    return still


def _stopped(number: int) -> bool:
    """Whether this file is a TCP connection that lingered until now. Raises OSError."""
    with second_name(number) as connection:
        if connection.proto != socket.IPPROTO_TCP:
            return False
        on, _ = LINGER.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER.size))
        if not on:
            return False
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, OFF)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNACKNOWLEDGED_MS)
        return True
