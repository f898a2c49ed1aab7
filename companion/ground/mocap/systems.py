"""Frames of a camera system, read in a process of its own: the library motioncapture waits without end, and cannot be ended.

The process sends CaptureFrame, or a text where it cannot go on. It ends with its parent.
"""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import struct
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from importlib.util import find_spec
from multiprocessing import get_context
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, NamedTuple, Self

from companion import how_to_install
from companion.ground.mocap.bodies import CaptureFrame, SeenBody
from companion.types.errors import FailedError, UnusableError

CONNECT_WITHIN_S = 10.0  # with the start of the process
PR_SET_PDEATHSIG = 1  # linux/prctl.h
NATNET_PORT, NAT_CONNECT, NAT_SERVERINFO = 1510, 0, 1
SERVER_INFO = struct.Struct("<HH256s4s4sQH?4s")  # id, size, name, two versions, clock Hz, data port, multicast, group
ASK_AGAIN_S = 0.5
NAMES_AGAIN_S = 1.0
MAX_AGE_S = 5.0  # no frame is older; a stamp that says so is of another clock
WHAT_TO_CHECK = {
    "natnet": "that Motive streams (Streaming: enabled, local interface not loopback, rigid bodies) on UDP 1510 and 1511",
    "vicon": "that Tracker or Nexus runs and streams on TCP 801",
    "qualisys": "that QTM runs, with 6DOF data in real time on TCP 22222",
    "vrpn": "that its VRPN server runs, on port 3883",
}
WHAT_TO_CHECK["optitrack"] = WHAT_TO_CHECK["natnet"]
PORT_OPTION = {"optitrack": "port_command", "qualisys": "port"}  # of motioncapture; the others have none


class CameraSource(NamedTuple):
    """What the reading process is told: the fields of the file with these names."""

    system: str
    host: str
    port: int | None
    latency_s: float

    @property
    def package(self) -> str:
        return "natnet" if self.system == "natnet" else "motioncapture"

    def check_installed(self) -> None:
        """Raises UnusableError."""
        if find_spec(self.package) is None:
            other = "" if self.package == "natnet" else " (for amd64 and Python 3.11 to 3.13 only)"
            raise UnusableError(f"{self.package}{other} is not installed; {how_to_install('mocap')}")

    def no_answer(self, within_s: float) -> str:
        check = WHAT_TO_CHECK[self.system]
        return f"no frame from {self.host} within {within_s:g} s; check host, {check}, and the firewalls"


class CameraReader:
    """The reading process. Use it in a `with`."""

    def __init__(self, source: CameraSource, connect_within_s: float = CONNECT_WITHIN_S) -> None:
        self._source, self._connect_within_s = source, connect_within_s
        self._begin()

    def _begin(self) -> None:
        spawn = get_context("spawn")
        self._frames, into = spawn.Pipe(duplex=False)
        self._process = spawn.Process(target=_read, args=(self._source, into), daemon=True)
        self._process.start()
        into.close()

    def first(self) -> CaptureFrame:
        """The first frame. Raises FailedError where there is none in time."""
        frame = self.receive(self._connect_within_s)
        if frame is None:
            raise FailedError(self._source.no_answer(self._connect_within_s))
        return frame

    def receive(self, within_s: float) -> CaptureFrame | None:
        """The next frame. Raises FailedError where the process cannot go on."""
        if not self._frames.poll(within_s):
            return None
        try:
            received: CaptureFrame | str = self._frames.recv()
        except EOFError:
            raise FailedError(f"the process that reads {self._source.host} has ended") from None
        if isinstance(received, str):
            raise FailedError(received)
        return received

    def restart(self) -> None:
        """Connect again, in a new process."""
        self.close()
        self._begin()

    def close(self) -> None:
        """End the process at once: nothing else ends a library that waits."""
        self._process.kill()
        self._process.join()
        self._frames.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _read(source: CameraSource, frames: Connection) -> None:
    """The process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # both libraries print
    try:
        address = socket.gethostbyname(source.host)
        read = _read_natnet if source.package == "natnet" else _read_motioncapture
        read(source, address, _own_address(address), frames.send)
    except socket.gaierror:
        frames.send(f"unknown host {source.host}; check host in the file")
    except Exception as error:  # noqa: BLE001 -- of a library; the parent says it in one line
        frames.send(f"{source.package} cannot read {source.host}: {error or type(error).__name__}")


def _own_address(host: str) -> str:
    """Of the network interface towards the host."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.connect((host, NATNET_PORT))
        return str(out.getsockname()[0])


def _read_motioncapture(source: CameraSource, host: str, own: str, send: Callable[[CaptureFrame], None]) -> None:
    import motioncapture

    options = {"hostname": host, "interface_ip": own}
    if source.port and source.system in PORT_OPTION:
        options[PORT_OPTION[source.system]] = str(source.port)
    system = motioncapture.connect(source.system, options)
    while True:
        system.waitForNextFrame()
        received_s = time.monotonic()
        bodies = tuple(_seen_body(name, body) for name, body in system.rigidBodies.items())
        if bodies or source.system != "vrpn":  # which waits for no frame
            send(CaptureFrame(received_s, source.latency_s, bodies))


def _seen_body(name: str, body: Any) -> SeenBody:
    (x, y, z), rotation = body.position, body.rotation
    return SeenBody(name, (float(x), float(y), float(z)), (rotation.w, rotation.x, rotation.y, rotation.z))


def _read_natnet(source: CameraSource, host: str, own: str, send: Callable[[CaptureFrame], None]) -> None:
    from natnet import NatNetClient

    port = source.port or NATNET_PORT
    *_, clock_hz, data_port, multicast, group = ask_server(host, port)
    client = NatNetClient(host, own, socket.inet_ntoa(group), port, data_port, multicast)
    reader = _NatNetReader(clock_hz, source.latency_s, send)
    client.on_data_description_received_event.handlers.append(reader.take_names)
    client.on_data_frame_received_event.handlers.append(reader.take_frame)
    client.connect()
    client.run_async()
    while True:
        if reader.lacks_names:
            client.request_modeldef()
        time.sleep(NAMES_AGAIN_S)


def ask_server(host: str, port: int) -> tuple[Any, ...]:
    """The fields of SERVER_INFO, which the package natnet does not give. Asks until it has an answer."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.settimeout(ASK_AGAIN_S)
        while True:
            asking.sendto(struct.pack("<HH5s", NAT_CONNECT, 5, b"Ping\0"), (host, port))
            with suppress(TimeoutError):
                answer = asking.recv(65_536)
                if len(answer) >= SERVER_INFO.size and answer[0] == NAT_SERVERINFO:
                    return SERVER_INFO.unpack_from(answer)


class _NatNetReader:
    """Frames of the package natnet, with names and ages."""

    def __init__(self, clock_hz: int, latency_s: float, send: Callable[[CaptureFrame], None]) -> None:
        self._clock_hz, self._latency_s, self._send = clock_hz, latency_s, send
        self._names: dict[int, str] = {}
        self.lacks_names = True

    def take_names(self, descriptions: Any) -> None:
        self._names = {body.id_num: body.name for body in descriptions.rigid_bodies}
        self.lacks_names = False

    def take_frame(self, frame: Any) -> None:
        received_s = time.monotonic()
        bodies = []
        for body in frame.rigid_bodies:
            if body.id_num not in self._names:
                self.lacks_names = True
            elif body.tracking_valid:
                x, y, z, w = body.rot
                bodies.append(SeenBody(self._names[body.id_num], tuple(body.pos), (w, x, y, z)))
        if self._names:
            self._send(CaptureFrame(received_s, self._age_s(frame.suffix), tuple(bodies)))

    def _age_s(self, suffix: Any) -> float:
        exposed, sent = suffix.stamp_camera_mid_exposure, suffix.stamp_transmit
        if not exposed or not sent or not self._clock_hz:
            return self._latency_s
        age_s = (sent - exposed) / self._clock_hz
        return age_s if 0.0 <= age_s <= MAX_AGE_S else self._latency_s
