"""Which bodies of a frame are published as which vehicles, and what is wrong with the others. No sockets, no clocks."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Mapping
from math import hypot, isfinite
from typing import NamedTuple

from companion.geometry.capture_axes import CaptureAxes
from companion.geometry.frames import Quaternion
from companion.types.values import Vector3, quoted

AGAIN_S = 10.0  # what lasts is said again after this time
LOST_AFTER_S = 0.2  # shorter gaps are normal
FARTHEST_M = 1000.0
NORM_WITHIN = 0.01


class SeenBody(NamedTuple):
    """A tracked body in the axes of the capture system; `quaternion` is w, x, y, z."""

    name: str
    position_m: Vector3
    quaternion: Quaternion


class CaptureFrame(NamedTuple):
    """The tracked bodies of one frame. `received_s` is of the monotonic clock, `age_s` its age at that time."""

    received_s: float
    age_s: float
    bodies: tuple[SeenBody, ...]


class VehiclePose(NamedTuple):
    """A pose in the fleet frame, to be published."""

    vehicle_id: int
    position_enu_m: Vector3
    quaternion: Quaternion
    age_s: float


def unusable(body: SeenBody) -> str:
    """Why the pose of a body cannot be one; "" for a pose."""
    if not all(map(isfinite, (*body.position_m, *body.quaternion))):
        return "not finite"
    if abs(hypot(*body.quaternion) - 1.0) > NORM_WITHIN:
        return f"its quaternion has the norm {hypot(*body.quaternion):.3f}, expected 1"
    if hypot(*body.position_m) > FARTHEST_M:
        return f"{hypot(*body.position_m):.0f} m from zero, expected metres"
    return ""


def fleet_pose(axes: CaptureAxes, body: SeenBody) -> tuple[Vector3, Quaternion]:
    """The pose of a usable body in the fleet frame; the quaternion has the norm 1."""
    position_enu_m, quaternion = axes.to_fleet(body.position_m, body.quaternion)
    norm = hypot(*quaternion)
    w, x, y, z = (max(-1.0, min(1.0, value / norm)) for value in quaternion)
    return position_enu_m, (w, x, y, z)


class BodyWatch:
    """Chooses what is published, and says once, and every AGAIN_S, what is not."""

    def __init__(self, axes: CaptureAxes, bodies: Mapping[str, int], rate_hz: float | None, start_s: float) -> None:
        self._axes, self._bodies = axes, bodies
        self._period_s = 1.0 / rate_hz if rate_hz else 0.0
        self._start_s = start_s
        self._tracked_s: dict[str, float] = {}  # when last
        self._due_s = dict.fromkeys(bodies, start_s)
        self._unknown_s: dict[str, float] = {}
        self._refused = Counter[str]()
        self._reasons: dict[str, str] = {}  # of bodies refused since `lines` asked
        self._said_s: dict[tuple[str, str], float] = {}
        self._sent: deque[tuple[float, float]] = deque()  # of the last second: when, and with which age

    def take(self, frame: CaptureFrame, now_s: float) -> list[VehiclePose]:
        """The poses of this frame that are to be published now."""
        poses = []
        for body in frame.bodies:
            if body.name not in self._bodies:
                self._unknown_s[body.name] = now_s
            elif reason := unusable(body):
                self._refused[body.name] += 1
                self._reasons[body.name] = reason
            else:
                self._tracked_s[body.name] = now_s
                if now_s >= self._due_s[body.name]:
                    self._due_s[body.name] = max(self._due_s[body.name] + self._period_s, now_s)
                    age_s = frame.age_s + now_s - frame.received_s
                    poses.append(VehiclePose(self._bodies[body.name], *fleet_pose(self._axes, body), age_s))
        self._sent.extend((now_s, pose.age_s) for pose in poses)
        return poses

    def lines(self, now_s: float) -> list[str]:
        """What is to be said now. To be asked a few times a second, while frames arrive."""
        return [*self._unknown(now_s), *self._unusable(now_s), *self._untracked(now_s)]

    def tracked(self, now_s: float) -> list[str]:
        """Names of the bodies of the file that are tracked."""
        return [name for name in self._bodies if now_s - self._tracked_s.get(name, -1e9) <= LOST_AFTER_S]

    def state(self, now_s: float) -> object:
        """Differs where a summary is worth a line: rates and ages always vary."""
        return self.tracked(now_s), self._refused.total()

    def summary(self, now_s: float) -> str:
        """Bodies, rate, age and refused poses of the last second."""
        while self._sent and self._sent[0][0] <= now_s - 1.0:
            self._sent.popleft()
        tracked, sent = len(self.tracked(now_s)), len(self._sent)
        age_ms = 1000.0 * sum(age_s for _, age_s in self._sent) / max(sent, 1)
        return (
            f"{tracked} of {len(self._bodies)} bodies tracked, {sent / max(tracked, 1):.0f} poses/s each,"
            f" {age_ms:.0f} ms old, {self._refused.total()} refused"
        )

    def _unknown(self, now_s: float) -> Iterator[str]:
        for name, seen_s in list(self._unknown_s.items()):
            if now_s - seen_s > AGAIN_S:
                del self._unknown_s[name]
            elif self._is_due("unknown", name, now_s):
                yield f"{quoted(name)}: not in bodies of the file, so not published; add it, or switch it off"

    def _unusable(self, now_s: float) -> Iterator[str]:
        for name, reason in list(self._reasons.items()):
            if self._is_due("unusable", name, now_s):
                yield f"{self._named(name)}: {reason}; not published, {self._refused[name]} so far"
                del self._reasons[name]

    def _untracked(self, now_s: float) -> Iterator[str]:
        for name in self._bodies:
            since_s = self._tracked_s.get(name, self._start_s)
            if now_s - since_s <= LOST_AFTER_S:
                if self._said_s.pop(("untracked", name), None) is not None:
                    yield f"{self._named(name)}: tracked again"
            elif self._is_due("untracked", name, now_s):
                never = "" if name in self._tracked_s else ", since the start; is that its name?"
                yield f"{self._named(name)}: not tracked for {now_s - since_s:.1f} s{never}"

    def _named(self, name: str) -> str:
        return f"{quoted(name)} (vehicle {self._bodies[name]})"

    def _is_due(self, what: str, name: str, now_s: float) -> bool:
        due = now_s - self._said_s.get((what, name), -1e9) >= AGAIN_S
        if due:
            self._said_s[what, name] = now_s
        return due
