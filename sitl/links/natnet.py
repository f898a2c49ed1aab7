"""A server of NatNet 3.1 on loopback, the protocol of OptiTrack's Motive: bytes and sockets. By unicast.

Frames go to the socket of each client that keeps itself alive, as the package natnet does, and to the data port of each
host, where the library motioncapture listens.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress

from companion.geometry.frames import Quaternion
from companion.types.values import Vector3
from sitl.links.ports import LOOPBACK

CONNECT, SERVER_INFO, MODEL_REQUEST, MODELS, FRAME, KEEP_ALIVE = 0, 1, 4, 5, 7, 10
NATNET_VERSION, MOTIVE_VERSION = bytes((3, 1, 0, 0)), bytes((2, 3, 0, 0))
CLOCK_HZ = 10_000_000
CLIENT_LEFT_S = 10.0  # without keeping alive
RIGID_BODY = 1  # kind of a description
NO_PARENT, TRACKED, MARKER_ERROR_M = -1, 1, 0.0002
EXPOSURE_TO_RECEIVED = 0.5  # share of the age that the cameras take
REQUESTS_AT_ONCE = 256

CapturedBody = tuple[int, Vector3, Quaternion, bool]
"""Number of the body, position and quaternion (w, x, y, z) in the axes of the cameras, and whether it is tracked."""


def message(kind: int, content: bytes) -> bytes:
    """With its header."""
    return struct.pack("<HH", kind, len(content)) + content


def server_info(data_port: int) -> bytes:
    """The answer to CONNECT."""
    versions = MOTIVE_VERSION + NATNET_VERSION
    return message(
        SERVER_INFO, struct.pack("<256s8sQH?4s", b"stand-in", versions, CLOCK_HZ, data_port, False, bytes(4))
    )


def models(names: Mapping[int, str]) -> bytes:
    """The names of the rigid bodies, by number."""
    bodies = (
        struct.pack("<i", RIGID_BODY)
        + name.encode()
        + b"\0"
        + struct.pack("<ii", number, NO_PARENT)
        + bytes(16)  # no offset, no markers
        for number, name in names.items()
    )
    return message(MODELS, struct.pack("<i", len(names)) + b"".join(bodies))


def frame(number: int, bodies: Sequence[CapturedBody], now_s: float, age_s: float) -> bytes:
    """A frame of mocap data that leaves now, exposed `age_s` ago."""
    content = struct.pack("<4i", number, 0, 0, len(bodies))  # no marker sets, no other markers
    for body, position_m, (w, x, y, z), tracked in bodies:
        content += struct.pack("<i7f", body, *position_m, x, y, z, w)
        content += struct.pack("<fh", MARKER_ERROR_M, TRACKED if tracked else 0)
    content += bytes(16)  # no skeletons, labelled markers, force plates, devices
    exposed = round((now_s - age_s) * CLOCK_HZ)
    received = round((now_s - age_s * EXPOSURE_TO_RECEIVED) * CLOCK_HZ)
    content += struct.pack("<8xd3Q6x", now_s, exposed, received, round(now_s * CLOCK_HZ))  # no timecode, no flags
    return message(FRAME, content)


class NatNetServer:
    """Its sockets. `answer` is called often, `send` for each frame."""

    def __init__(self, port: int, data_port: int, names: Mapping[int, str]) -> None:
        """Raises OSError for a port in use."""
        self._data_port, self._answers = data_port, {CONNECT: server_info(data_port), MODEL_REQUEST: models(names)}
        self._asked_s: dict[tuple[str, int], float] = {}  # clients that ask for frames, and when last
        self._hosts: set[str] = set()
        self._number = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.bind((LOOPBACK, port))
        except OSError:
            self._socket.close()
            raise

    def close(self) -> None:
        self._socket.close()

    def answer(self, now_s: float) -> None:
        """What clients have asked."""
        for request, client in self._requests():
            if request == KEEP_ALIVE:
                self._asked_s[client] = now_s
            self._hosts.add(client[0])
            if reply := self._answers.get(request):
                self._send(reply, client)

    def send(self, bodies: Sequence[CapturedBody], now_s: float, age_s: float) -> None:
        """One frame to all clients."""
        self._number += 1
        data = frame(self._number, bodies, now_s, age_s)
        self._asked_s = {client: at_s for client, at_s in self._asked_s.items() if now_s - at_s <= CLIENT_LEFT_S}
        for client in (*self._asked_s, *((host, self._data_port) for host in self._hosts)):
            self._send(data, client)

    def _send(self, data: bytes, client: tuple[str, int]) -> None:
        with suppress(OSError):  # a full buffer loses it
            self._socket.sendto(data, client)

    def _requests(self) -> Iterator[tuple[int, tuple[str, int]]]:
        for _ in range(REQUESTS_AT_ONCE):
            try:
                data, client = self._socket.recvfrom(2048)
            except BlockingIOError:
                return
            if len(data) >= 2:
                yield data[0] | data[1] << 8, client
