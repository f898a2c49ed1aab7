"""Which bodies of a frame are published, and what is said of the others, and when."""

from __future__ import annotations

from math import hypot, inf, nan

import pytest

from companion.geometry.capture_axes import CaptureAxes
from companion.ground.mocap.bodies import BodyWatch, CaptureFrame, SeenBody
from companion.types.peers import BodyPose
from companion.wire.messages import decode_pose, encode

LEVEL = (1.0, 0.0, 0.0, 0.0)
PERIOD_S = 0.01


def seen(name: str, position_m=(1.0, 2.0, 3.0), quaternion=LEVEL) -> SeenBody:
    return SeenBody(name, position_m, quaternion)


class Room:
    """A watch of cf1 and cf2 with frames at 100 Hz; all that it publishes and says."""

    def __init__(self, rate_hz: float | None = None) -> None:
        self.watch = BodyWatch(CaptureAxes.of("z", "x"), {"cf1": 1, "cf2": 2}, rate_hz, 0.0)
        self.now_s = 0.0
        self.published: list = []
        self.said: list[tuple[float, str]] = []

    def run(self, seconds: float, *bodies: SeenBody, late_s: float = 0.0) -> list[str]:
        """Frames with these bodies; what was said meanwhile."""
        before = len(self.said)
        for _ in range(round(seconds / PERIOD_S)):
            self.now_s += PERIOD_S
            frame = CaptureFrame(self.now_s - late_s, 0.008, bodies)
            self.published += self.watch.take(frame, self.now_s)
            self.said += [(self.now_s, line) for line in self.watch.lines(self.now_s)]
        return [line for _, line in self.said[before:]]


def test_all_bodies_of_the_file_are_published_with_their_age():
    room = Room()
    assert not room.run(1.0, seen("cf1"), seen("cf2"), late_s=0.002)
    assert [pose.vehicle_id for pose in room.published] == [1, 2] * 100
    assert {pose.position_enu_m for pose in room.published} == {(1.0, 2.0, 3.0)}
    assert room.published[-1].age_s == pytest.approx(0.010)
    assert room.watch.summary(room.now_s) == "2 of 2 bodies tracked, 100 poses/s each, 10 ms old, 0 refused"


def test_an_unknown_body_is_named_once_and_again_every_ten_seconds_while_it_lasts():
    room = Room()
    lines = room.run(25.0, seen("cf1"), seen("cf2"), seen("cf9"))
    assert lines == ["'cf9': not in bodies of the file, so not published; add it, or switch it off"] * 3
    assert [at_s for at_s, _ in room.said] == pytest.approx([0.01, 10.01, 20.01], abs=0.02)
    assert {pose.vehicle_id for pose in room.published} == {1, 2}
    room.run(11.0, seen("cf1"), seen("cf2"))
    assert not room.run(20.0, seen("cf1"), seen("cf2"))


def test_a_body_that_is_never_tracked_is_named():
    lines = Room().run(0.5, seen("cf1"))
    assert lines == ["'cf2' (vehicle 2): not tracked for 0.2 s, since the start; is that its name?"]


def test_a_body_that_is_lost_is_not_published_and_named_with_since_when():
    room = Room()
    room.run(1.0, seen("cf1"), seen("cf2"))
    assert not room.run(0.19, seen("cf1"))
    lines = room.run(15.0, seen("cf1"))
    assert lines == ["'cf2' (vehicle 2): not tracked for 0.2 s", "'cf2' (vehicle 2): not tracked for 10.2 s"]
    assert sum(pose.vehicle_id == 2 for pose in room.published) == 100
    assert room.watch.tracked(room.now_s) == ["cf1"]
    assert room.run(1.0, seen("cf1"), seen("cf2")) == ["'cf2' (vehicle 2): tracked again"]


@pytest.mark.parametrize(
    ("position_m", "quaternion", "reason"),
    [
        ((nan, 0.0, 0.0), LEVEL, "not finite"),
        ((0.0, inf, 0.0), LEVEL, "not finite"),
        ((0.0, 0.0, 0.0), (nan, 0.0, 0.0, 0.0), "not finite"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), "its quaternion has the norm 0.000, expected 1"),
        ((0.0, 0.0, 0.0), (1.0, 0.0, 0.3, 0.0), "its quaternion has the norm 1.044, expected 1"),
        ((1500.0, 0.0, 0.0), LEVEL, "1500 m from zero, expected metres"),
    ],
)
def test_what_is_no_pose_is_counted_named_and_not_published(position_m, quaternion, reason: str):
    room = Room()
    lines = room.run(0.1, seen("cf1", position_m, quaternion), seen("cf2"))
    assert lines == [f"'cf1' (vehicle 1): {reason}; not published, 1 so far"]
    assert {pose.vehicle_id for pose in room.published} == {2}
    assert room.watch.summary(room.now_s).endswith("10 refused")


def test_a_largest_rate():
    room = Room(rate_hz=20.0)
    room.run(5.0, seen("cf1"), seen("cf2"))
    assert 98 <= sum(pose.vehicle_id == 1 for pose in room.published) <= 102


def test_what_is_published_can_be_decoded_though_cameras_send_32_bit_numbers():
    room = Room()
    room.run(
        PERIOD_S, seen("cf1", quaternion=(1.0000001, 0.0, 1e-9, 0.0)), seen("cf2", quaternion=(0.7, -0.72, 0.0, 0.0))
    )
    for pose in room.published:
        assert hypot(*pose.quaternion) == pytest.approx(1.0)
        sent = BodyPose(1, 1, 0.0, pose.position_enu_m, pose.quaternion, pose.age_s)
        assert decode_pose(encode(sent)) == sent
