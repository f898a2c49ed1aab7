"""The guided check: bodies are moved by hand, and their motions show whether axes and names are right. No clocks."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from math import atan2, degrees, hypot
from typing import Literal, NamedTuple

from companion.geometry.capture_axes import UNIT, CaptureAxes
from companion.geometry.frames import Quaternion, euler_from_quaternion, wrap_degrees
from companion.geometry.vectors import dot, minus
from companion.ground.mocap.bodies import CaptureFrame, fleet_pose, unusable
from companion.types.values import Vector3, quoted

Motion = Literal["east", "up", "left"]
ASKED: dict[Motion, str] = {
    "east": "put its nose to the east, then move it about 1 m to the east and let it rest",
    "up": "lift it by about 1 m and hold it still, or put it onto something",
    "left": "turn it to the left by about 90 degrees, seen from above, and let it rest",
}
MOVED_M, TURNED_DEG = 0.4, 45.0
RESTS_FOR_S, RESTS_WITHIN_M, RESTS_WITHIN_DEG = 0.8, 0.03, 5.0
NEAR_AXIS = 0.94  # cosine of 20 degrees
LEVEL_DEG, NOSE_DEG = 15.0, 30.0
DIRECTIONS: dict[str, Vector3] = {
    "east": UNIT["x"], "west": UNIT["-x"], "north": UNIT["y"], "south": UNIT["-y"], "up": UNIT["z"], "down": UNIT["-z"],
}  # fmt: skip


class GuideStep(NamedTuple):
    """One body and what is asked of it."""

    name: str
    motion: Motion

    @property
    def words(self) -> str:
        return f"{self.name}: {ASKED[self.motion]}"


def steps(names: Iterable[str]) -> Iterator[GuideStep]:
    """All motions of the first body; of each other one the lift, which shows that it is this one."""
    for index, name in enumerate(names):
        yield from (GuideStep(name, motion) for motion in (("east", "up", "left") if index == 0 else ("up",)))


class MovedPose(NamedTuple):
    """Of a body, in the axes of the cameras and in the fleet frame."""

    capture_m: Vector3
    enu_m: Vector3
    euler_deg: Vector3


@dataclass(slots=True)
class BodyTrack:
    """Where a body was at the start of a step, and in the last RESTS_FOR_S."""

    start: MovedPose
    recent: deque[tuple[float, MovedPose]] = field(default_factory=deque)

    def add(self, now_s: float, pose: MovedPose) -> None:
        self.recent.append((now_s, pose))
        while len(self.recent) > 1 and self.recent[1][0] <= now_s - RESTS_FOR_S:
            self.recent.popleft()

    @property
    def moved(self) -> bool:
        """It has moved or turned, and rests again."""
        now_s, end = self.recent[-1]
        if now_s - self.recent[0][0] < RESTS_FOR_S:
            return False
        rests = all(
            hypot(*minus(pose.enu_m, end.enu_m)) <= RESTS_WITHIN_M
            and abs(wrap_degrees(pose.euler_deg[2] - end.euler_deg[2])) <= RESTS_WITHIN_DEG
            for _, pose in self.recent
        )
        far = hypot(*minus(end.enu_m, self.start.enu_m)) >= MOVED_M
        return rests and (far or abs(self.turned_deg) >= TURNED_DEG)

    @property
    def turned_deg(self) -> float:
        return wrap_degrees(self.recent[-1][1].euler_deg[2] - self.start.euler_deg[2])


class StepVerdict(NamedTuple):
    good: bool
    line: str


class StepWatch:
    """Watches all bodies until one of them has moved and rests again."""

    def __init__(self, step: GuideStep, axes: CaptureAxes, turn_deg: float) -> None:
        self._step, self._axes, self._turn_deg = step, axes, turn_deg
        self._tracks: dict[str, BodyTrack] = {}

    def take(self, frame: CaptureFrame, now_s: float) -> StepVerdict | None:
        """What was wrong or right, once a body has moved."""
        for body in frame.bodies:
            if not unusable(body):
                enu_m, quaternion = fleet_pose(self._axes, body)
                pose = MovedPose(body.position_m, enu_m, _euler_deg(quaternion))
                self._tracks.setdefault(body.name, BodyTrack(pose)).add(now_s, pose)
        moved = [name for name, track in self._tracks.items() if track.moved]
        if not moved:
            return None
        if self._step.name not in moved:
            other = quoted(moved[0])
            return StepVerdict(
                False, f"{other} moved, expected {quoted(self._step.name)}: the names in bodies are swapped"
            )
        return _judge(self._step, self._tracks[self._step.name], self._turn_deg)


def _euler_deg(quaternion: Quaternion) -> Vector3:
    roll, pitch, yaw = euler_from_quaternion(quaternion)
    return (degrees(roll), degrees(pitch), degrees(yaw))


def _judge(step: GuideStep, track: BodyTrack, turn_deg: float) -> StepVerdict:
    if step.motion == "left":
        return _judge_turn(step, track)
    end = track.recent[-1][1]
    moved = minus(end.enu_m, track.start.enu_m)
    length_m = hypot(*moved)
    if length_m < MOVED_M:
        return StepVerdict(
            False, f"{step.name} turned by {track.turned_deg:.0f} degrees; expected a move: {step.words}"
        )
    direction, share = _nearest(moved, DIRECTIONS)
    where = f"{step.name} moved {length_m:.2f} m {'' if direction in ('up', 'down') else 'to the '}{direction}"
    if share < NEAR_AXIS:
        askew_deg = degrees(atan2(moved[1], moved[0]))
        if step.motion == "east" and abs(moved[2]) < 0.3 * length_m:
            turn = wrap_degrees(turn_deg - askew_deg)
            advice = f"set turn_deg: {turn:.0f}, if the move was to the east"
        else:
            advice = "move it along one direction"
        return StepVerdict(False, f"{step.name} moved {_parts(moved)}; expected {step.motion}: {advice}")
    if direction != step.motion:
        axis, _ = _nearest(minus(end.capture_m, track.start.capture_m), UNIT)
        key = "forward" if step.motion == "east" else "up"
        advice = (
            f"set {key}: {axis}" if key == "forward" or axis in ("y", "z") else "turn the frame of the cameras over"
        )
        return StepVerdict(False, f"{where}; expected {step.motion}: {advice}")
    return _judge_attitude(end, where) if step.motion == "east" else StepVerdict(True, f"{where}: right")


def _judge_attitude(end: MovedPose, where: str) -> StepVerdict:
    """At rest, with the nose to the east."""
    roll_deg, pitch_deg, yaw_deg = end.euler_deg
    again = "make the body again in the camera system, level and with its nose along `forward`"
    if max(abs(roll_deg), abs(pitch_deg)) > LEVEL_DEG:
        tilt = f"rolled by {roll_deg:.0f} and pitched by {pitch_deg:.0f} degrees"
        return StepVerdict(False, f"{where}, but is {tilt}: {again}")
    if abs(yaw_deg) > NOSE_DEG:
        side = "left" if yaw_deg > 0.0 else "right"
        return StepVerdict(False, f"{where}, but its nose is {abs(yaw_deg):.0f} degrees to the {side} of east: {again}")
    return StepVerdict(True, f"{where}, nose {yaw_deg:+.0f} degrees from east: right")


def _judge_turn(step: GuideStep, track: BodyTrack) -> StepVerdict:
    turned_deg = track.turned_deg
    if abs(turned_deg) < TURNED_DEG:
        return StepVerdict(False, f"{step.name} moved; expected a turn: {step.words}")
    line = f"{step.name} turned by {abs(turned_deg):.0f} degrees to the {'left' if turned_deg > 0.0 else 'right'}"
    if turned_deg < 0.0:
        return StepVerdict(
            False, f"{line}; expected left: the axes of the body are not those of the frame; make it again"
        )
    return StepVerdict(True, f"{line}: right")


def _nearest(vector: Vector3, directions: dict[str, Vector3]) -> tuple[str, float]:
    """The direction, and the cosine of the angle to it."""
    name = max(directions, key=lambda direction: dot(vector, directions[direction]))
    return name, dot(vector, directions[name]) / hypot(*vector)


def _parts(moved: Vector3) -> str:
    """ "0.70 m east and 0.71 m north": the two largest parts."""
    parts = sorted(((dot(moved, axis), name) for name, axis in DIRECTIONS.items()), reverse=True)
    return " and ".join(f"{length_m:.2f} m {name}" for length_m, name in parts[:2])
