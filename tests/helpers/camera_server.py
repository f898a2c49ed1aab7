"""The motion-capture system of the stand-ins on free ports of this machine, with two vehicles at rest."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from math import radians

from companion.geometry.capture_axes import CaptureAxis, UpAxis
from companion.geometry.frames import Quaternion, quaternion_from_euler
from companion.types.values import Vector3
from sitl.links.cameras import Cameras, CamerasFile, truth_datagram
from sitl.vehicle.config import CaptureFault
from sitl.vehicle.dynamics import State, at_rest

PLACES: dict[int, tuple[Vector3, Quaternion]] = {
    1: ((1.0, 2.0, 3.0), quaternion_from_euler(0.0, 0.0, radians(30.0))),
    2: ((-4.0, 0.5, 1.0), quaternion_from_euler(0.0, radians(10.0), radians(-100.0))),
}


def free_ports(count: int) -> list[int]:
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    try:
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]
    finally:
        for one in sockets:
            one.close()


@contextmanager
def serving(up: UpAxis = "y", forward: CaptureAxis = "x", *faults: CaptureFault) -> Iterator[CamerasFile]:
    """The cameras, with truths of two vehicles at rest."""
    port, data_port, truth_port = free_ports(3)
    file = CamerasFile((1, 2), port, data_port, truth_port, up, forward, faults=faults)
    done = threading.Event()
    cameras = Cameras(file)
    states: dict[int, State] = {vehicle_id: at_rest(*place) for vehicle_id, place in PLACES.items()}

    def send_truths() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not done.wait(0.01):
                for vehicle_id, state in states.items():
                    out.sendto(truth_datagram(vehicle_id, time.monotonic(), state), ("127.0.0.1", truth_port))

    threads = [threading.Thread(target=send_truths), threading.Thread(target=cameras.run, args=(done,))]
    for thread in threads:
        thread.start()
    try:
        yield file
    finally:
        done.set()
        for thread in threads:
            thread.join()
        cameras.close()
