"""The NatNet server of the stand-ins, read by two independent clients over real sockets: natnet and motioncapture."""

from __future__ import annotations

import importlib.util
from math import dist

import pytest

from camera_server import PLACES, free_ports, serving
from companion.geometry.capture_axes import CaptureAxes, CaptureAxis, UpAxis
from companion.geometry.frames import euler_from_quaternion
from companion.ground.mocap.bodies import CaptureFrame, SeenBody
from companion.ground.mocap.systems import CameraReader, CameraSource, ask_server
from companion.types.errors import FailedError
from sitl.links.natnet import CLOCK_HZ
from sitl.vehicle.config import CaptureFault

NOISE_M, NOISE_RAD = 0.02, 0.03  # ten standard deviations
WITNESSES = {"natnet": "natnet", "optitrack": "motioncapture"}


def witness(system: str, port: int) -> CameraReader:
    if importlib.util.find_spec(WITNESSES[system]) is None:
        pytest.skip(f"the package {WITNESSES[system]} is not installed: it has no wheel for this machine")
    return CameraReader(CameraSource(system, "127.0.0.1", port, latency_s=0.004))


def frame_with(cameras: CameraReader, *names: str) -> CaptureFrame:
    """The next frame with these bodies and no others."""
    frame = cameras.first()
    for _ in range(1000):
        if {body.name for body in frame.bodies} == set(names):
            return frame
        received = cameras.receive(10.0)
        assert received is not None
        frame = received
    raise AssertionError(f"the last frame has {frame.bodies}")


def complete(cameras: CameraReader) -> CaptureFrame:
    return frame_with(cameras, "vehicle_1", "vehicle_2")


def check_place(axes: CaptureAxes, body: SeenBody) -> None:
    position_enu_m, quaternion = PLACES[int(body.name.removeprefix("vehicle_"))]
    seen_enu_m, seen = axes.to_fleet(body.position_m, body.quaternion)
    assert dist(seen_enu_m, position_enu_m) < NOISE_M
    assert euler_from_quaternion(seen) == pytest.approx(euler_from_quaternion(quaternion), abs=NOISE_RAD)


@pytest.mark.parametrize("system", WITNESSES)
@pytest.mark.parametrize(("up", "forward"), [("y", "x"), ("z", "x"), ("y", "-z"), ("z", "-y")])
def test_both_witnesses_read_the_true_poses(system: str, up: UpAxis, forward: CaptureAxis) -> None:
    with serving(up, forward) as file, witness(system, file.port) as cameras:
        for body in complete(cameras).bodies:
            check_place(CaptureAxes.of(up, forward), body)


def test_natnet_frames_say_their_age_and_motioncapture_takes_that_of_the_file() -> None:
    with serving() as file:
        with witness("natnet", file.port) as cameras:
            assert 0.005 <= complete(cameras).age_s <= 0.5
        with witness("optitrack", file.port) as cameras:
            assert complete(cameras).age_s == 0.004


@pytest.mark.parametrize("system", WITNESSES)
def test_a_lost_body_is_not_shown_though_its_last_pose_is_sent(system: str) -> None:
    lost = CaptureFault(kind="lost", vehicle=2, at_s=3.0, for_s=1000.0)
    with serving("y", "x", lost) as file, witness(system, file.port) as cameras:
        complete(cameras)
        frame_with(cameras, "vehicle_1")
        for _ in range(5):
            frame = cameras.receive(10.0)
            assert frame is not None
            assert [body.name for body in frame.bodies] == ["vehicle_1"]


def test_the_server_states_its_clock_and_ports() -> None:
    with serving() as file:
        info = ask_server("127.0.0.1", file.port)
    assert info[5:8] == (CLOCK_HZ, file.data_port, False)


@pytest.mark.parametrize("system", WITNESSES)
def test_without_a_server_one_line_says_what_to_check(system: str) -> None:
    (port,) = free_ports(1)
    if importlib.util.find_spec(WITNESSES[system]) is None:
        pytest.skip(f"the package {WITNESSES[system]} is not installed: it has no wheel for this machine")
    source = CameraSource(system, "127.0.0.1", port, latency_s=0.0)
    with CameraReader(source, connect_within_s=2.0) as cameras, pytest.raises(FailedError) as raised:
        cameras.first()
    assert str(raised.value).startswith("no frame from 127.0.0.1 within ")
    assert "check host, that Motive streams" in str(raised.value)
    assert "\n" not in str(raised.value)
