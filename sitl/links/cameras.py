"""A motion-capture system of the stand-ins as one process: `python -m sitl.links.cameras FILE`.

Stand-ins send it their true poses; it shows them to its clients with noise, latency and faults, at 100 Hz.
"""

from __future__ import annotations

import signal
import socket
import struct
import sys
import time
from collections import defaultdict
from pathlib import Path
from threading import Event

from companion.config.file import ConfigError, load
from companion.config.values import Section, VehicleId
from companion.geometry.capture_axes import CaptureAxes, CaptureAxis, UpAxis
from companion.geometry.vectors import extrapolated
from sitl.links.natnet import CapturedBody, NatNetServer
from sitl.links.ports import LOOPBACK
from sitl.vehicle.capture import BodyPlace, CaptureSystem
from sitl.vehicle.config import CaptureFault, Port
from sitl.vehicle.dynamics import ATTITUDE, POSITION, VELOCITY, State

RATE_HZ = 100.0
TRUTH = struct.Struct("<id10d")  # vehicle, monotonic time, position, velocity, quaternion
TRUTHS_AT_ONCE = 1024
TRUTH_ENDS_S = 0.5  # a stand-in has ended that has sent none for so long
SAME_AGE_DIGITS = 4


class CamerasFile(Section, frozen=True):
    """Bodies, axes, ports of this machine, and faults. Bodies are named as `body_name` says."""

    vehicles: tuple[VehicleId, ...]
    port: Port
    data_port: Port
    truth_port: Port
    up: UpAxis = "y"
    forward: CaptureAxis = "x"
    seed: int = 1
    faults: tuple[CaptureFault, ...] = ()


def body_name(vehicle_id: int) -> str:
    """Its rigid body in the camera system."""
    return f"vehicle_{vehicle_id}"


def truth_datagram(vehicle_id: int, now_s: float, state: State) -> bytes:
    """The true pose of a stand-in at this time of the monotonic clock."""
    return TRUTH.pack(vehicle_id, now_s, *state[POSITION], *state[VELOCITY], *state[ATTITUDE])


class Cameras:
    """The loop between the stand-ins and the NatNet server."""

    def __init__(self, file: CamerasFile) -> None:
        """Raises OSError for a port in use."""
        self._system = CaptureSystem(file.seed, file.faults)
        self._axes = CaptureAxes.of(file.up, file.forward)
        self._truths: dict[int, tuple[float, ...]] = {}  # by vehicle
        self._shown: dict[int, CapturedBody] = {}  # the last pose of each body
        self._start_s: float | None = None
        self._server = NatNetServer(file.port, file.data_port, {i: body_name(i) for i in file.vehicles})
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.bind((LOOPBACK, file.truth_port))
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        self._socket.close()
        self._server.close()

    def run(self, done: Event) -> None:
        """Until `done`."""
        next_s = 0.0
        while not done.wait(max(0.0, next_s - time.monotonic())):
            now_s = time.monotonic()
            self._receive()
            self._server.answer(now_s)
            self.show(now_s)
            next_s = max(next_s + 1.0 / RATE_HZ, now_s)  # late frames are left out

    def _receive(self) -> None:
        for _ in range(TRUTHS_AT_ONCE):
            try:
                data = self._socket.recv(2048)
            except BlockingIOError:
                return
            if len(data) == TRUTH.size:
                vehicle_id, *values = TRUTH.unpack(data)
                self._truths[vehicle_id] = tuple(values)

    def show(self, now_s: float) -> None:
        """One frame for each age: NatNet has one stamp for all bodies of a frame. The freshest comes last."""
        if not self._truths:
            return
        self._start_s = self._start_s or now_s
        fresh = {i: truth for i, truth in self._truths.items() if now_s - truth[0] <= TRUTH_ENDS_S}
        truths = {vehicle_id: _place(truth, now_s) for vehicle_id, truth in fresh.items()}
        frames: dict[float, list[CapturedBody]] = defaultdict(list)
        lost = dict(self._shown)
        for vehicle_id, position_m, quaternion, age_s in self._system.frame(now_s - self._start_s, truths):
            body = (vehicle_id, *self._axes.to_capture(position_m, quaternion), True)
            self._shown[vehicle_id] = body
            lost.pop(vehicle_id, None)
            frames[round(age_s, SAME_AGE_DIGITS)].append(body)
        frames[min(frames, default=0.0)] += [(*body[:3], False) for body in lost.values()]  # as Motive shows them
        for age_s in sorted(frames, reverse=True):
            self._server.send(frames[age_s], now_s, age_s)


def _place(truth: tuple[float, ...], now_s: float) -> BodyPlace:
    """Moved on to this time: the stand-in has sent it up to some milliseconds before."""
    sent_s, x, y, z, vx, vy, vz, qw, qx, qy, qz = truth
    return extrapolated((x, y, z), (vx, vy, vz), now_s - sent_s), (qw, qx, qy, qz)


def main() -> None:
    """Run the cameras of the file that is the only argument. Raises SystemExit."""
    done = Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda _number, _frame: done.set())
    try:
        cameras = Cameras(load(Path(sys.argv[1]), CamerasFile))
    except (ConfigError, OSError) as error:
        raise SystemExit(f"cameras: {error}") from error
    try:
        cameras.run(done)
    finally:
        cameras.close()


if __name__ == "__main__":
    main()
