"""`companion mocap`: its two loops, from the frames to the publisher and to the guided check."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NoReturn, Protocol

from companion.config.file import ConfigError
from companion.config.vehicle import ground_endpoints
from companion.geometry.frames import Quaternion
from companion.ground.current_fleet import select, simulation_endpoints
from companion.ground.mocap.bodies import BodyWatch, CaptureFrame
from companion.ground.mocap.file import MocapFile, load_mocap
from companion.ground.mocap.guide import StepWatch, steps
from companion.ground.mocap.systems import CONNECT_WITHIN_S, CameraReader, CameraSource
from companion.ground.publishers import PosePublisher
from companion.link.fleet.identity import load
from companion.security.names import ParticipantRole
from companion.types.errors import EXIT_DONE, EXIT_FAILED, FailedError
from companion.types.values import Vector3

LOOK_S = 0.05
SILENT_AFTER_S, AFTER_FAILURE_S = 0.5, 1.0
SUMMARY_S, SUMMARY_AGAIN_S = 1.0, 10.0
STEP_WITHIN_S = 120.0


def run_mocap(path: Path, connect: tuple[str, ...], identity: Path | None, environment: Mapping[str, str]) -> NoReturn:
    """Publishes until KeyboardInterrupt. Raises ConfigError, and FailedError where the camera system does not answer."""
    file, fleet, fleet_path = load_mocap(path)
    source = _source(file)
    selection = select(fleet_path, connect, identity, environment)
    own = load(selection.identity) if selection.identity else None
    if own is not None and (own.role, own.fleet) != (ParticipantRole.MOCAP, fleet.name):
        expected = f"expected one of role mocap of fleet {fleet.name}, as companion provision makes it"
        raise ConfigError(own.certificate_file, "", f"{own.common_name} of fleet {own.fleet}; {expected}")
    endpoints = selection.connect or ground_endpoints(fleet, own is not None)
    endpoints = endpoints or simulation_endpoints([member.id for member in fleet.vehicles])
    with CameraReader(source) as cameras, PosePublisher(fleet.name, endpoints, identity=own) as publisher:
        watch = BodyWatch(file.axes, file.bodies, file.rate_hz, cameras.first().received_s)
        relay = Relay(cameras, watch, publisher, file.host, _print, time.monotonic, time.sleep)
        while True:
            relay.step()


class Frames(Protocol):
    """What a relay uses of `CameraReader`."""

    def receive(self, within_s: float) -> CaptureFrame | None: ...

    def restart(self) -> None: ...


class Poses(Protocol):
    """What a relay uses of a PosePublisher."""

    def publish(
        self, vehicle_id: int, position_enu_m: Vector3, quaternion: Quaternion, age_s: float = 0.0, /
    ) -> None: ...


class Relay:
    """Frames of the cameras as poses of the fleet, and what is to be said of them. A silent system is connected again."""

    def __init__(
        self,
        cameras: Frames,
        watch: BodyWatch,
        poses: Poses,
        host: str,
        say: Callable[[str], None],
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self._cameras, self._watch, self._poses = cameras, watch, poses
        self._host, self._say, self._clock, self._sleep = host, say, clock, sleep
        self._frame_s = self._connected_s = self._looked_s = self._summary_s = clock()
        self._said: object = None  # the state that was summed up last
        self._silent = False

    def step(self) -> None:
        """One frame, or LOOK_S without one."""
        try:
            frame = self._cameras.receive(LOOK_S)
        except FailedError as error:
            self._connect_again(str(error))
            self._silent = True
            self._sleep(AFTER_FAILURE_S)
            return
        now_s = self._clock()
        if frame is None:
            self._wait(now_s)
            return
        if self._silent:
            self._say(f"frames from {self._host} again, after {now_s - self._frame_s:.1f} s")
        self._frame_s = self._connected_s = now_s
        self._silent = False
        for pose in self._watch.take(frame, now_s):
            self._poses.publish(*pose)
        if now_s - self._looked_s >= LOOK_S:
            self._looked_s = now_s
            self._look(now_s)

    def _wait(self, now_s: float) -> None:
        silent_s = now_s - self._frame_s
        if silent_s >= SILENT_AFTER_S and not self._silent:
            self._silent = True
            self._say(f"no frame from {self._host} for {silent_s:.1f} s: no poses are published; waiting for it")
        if now_s - self._connected_s >= CONNECT_WITHIN_S:
            self._connect_again(f"no frame from {self._host} for {silent_s:.0f} s; connecting again")

    def _connect_again(self, why: str) -> None:
        self._say(why)
        self._cameras.restart()
        self._connected_s = self._clock()

    def _look(self, now_s: float) -> None:
        for line in self._watch.lines(now_s):
            self._say(line)
        since_s = now_s - self._summary_s
        if since_s < SUMMARY_S:
            return
        state = self._watch.state(now_s)
        if state != self._said or since_s >= SUMMARY_AGAIN_S:
            self._say(self._watch.summary(now_s))
            self._said, self._summary_s = state, now_s


def check_mocap(path: Path) -> int:
    """The guided check. Raises ConfigError, and FailedError where the camera system does not answer."""
    file, _, _ = load_mocap(path)
    good = True
    with CameraReader(_source(file)) as cameras:
        cameras.first()
        for step in steps(file.bodies):
            _print(f"{step.words} ...")
            watch, end_s = StepWatch(step, file.axes, file.turn_deg), time.monotonic() + STEP_WITHIN_S
            verdict = None
            while verdict is None and time.monotonic() < end_s:
                frame = cameras.receive(LOOK_S)
                verdict = watch.take(frame, frame.received_s) if frame else None
            good = good and verdict is not None and verdict.good
            _print(f"  {verdict.line}" if verdict else f"  nothing moved and came to rest within {STEP_WITHIN_S:g} s")
    _print("axes and names are right" if good else f"correct {path}, and check again")
    return EXIT_DONE if good else EXIT_FAILED


def _source(file: MocapFile) -> CameraSource:
    source = CameraSource(file.system, file.host, file.port, file.latency_s)
    source.check_installed()
    return source


def _print(line: str) -> None:
    print(line, flush=True)
