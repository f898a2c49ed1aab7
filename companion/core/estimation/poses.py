"""Which motion-capture poses go to the autopilot.

Autopilots believe a pose. A wrong place is followed, or rejected for a second and then followed, and a wrong yaw makes them fly
off, all without a sign. So each pose is judged before it is passed on, against what the vehicle has done since the last good
one: the autopilot's own estimate rests on its inertial sensors, which a swapped or frozen body cannot deceive at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import acos, cos, degrees, dist, inf, radians, sin

from msgspec import Struct

from companion.core.message_order import Disorder, Stream, following
from companion.geometry.frames import Quaternion, euler_from_quaternion, wrap_pi
from companion.geometry.vectors import minus, plus, scaled
from companion.types.autopilot import PoseSample, VehicleState, in_air
from companion.types.peers import BodyPose
from companion.types.values import Vector3

LATE_S = 0.2  # a longer gap is noticed by the autopilots, and so is such a delay
FROZEN_S = 0.1  # ten frames at 100 Hz; no camera measures the same place twice in the air
# From the place to be expected: noise and lag of the estimate, and its drift since the last good pose
JUMP_M, JUMP_M_S = 0.4, 0.2
LARGEST_JUMP_M = 0.9  # however long poses are refused: less than the distance of two vehicles
SILENT_M_S = 0.3  # drift in a silence, in which no pose was refused
NEAR_M = 0.5  # so near to where another vehicle is, a jump is a swap
STEP_M, STEP_M_S = 0.2, 1.0  # from the pose before, moved on by the velocity, and at most NEAR_M: the same body goes on
TILT_RAD, TURN_RAD = radians(30.0), radians(30.0)  # against the autopilot's attitude
RESTARTS_S = 1.0  # without a good pose, a disarmed vehicle may have been carried elsewhere

DISORDERS = {
    Disorder.TWO_SENDERS: "two sources send poses of this vehicle",
    Disorder.OUT_OF_ORDER: "out of order",
    Disorder.LATE: f"more than {LATE_S} s late",
    Disorder.TIME: "sent in the future, by its sender's clock",
}


class _Seen(Struct, frozen=True, gc=False):
    """A pose that has arrived, in order."""

    received_s: float
    position_enu_m: Vector3
    quaternion: Quaternion
    yaw_rad: float


class _Good(Struct, frozen=True, gc=False):
    """The last pose that was passed on, and the autopilot's estimate then."""

    received_s: float
    position_enu_m: Vector3
    yaw_rad: float
    estimate_enu_m: Vector3
    estimated_yaw_rad: float


class PoseJudge:
    """Judges the poses of one vehicle as they arrive. `resets` counts places that were accepted without regard to the last."""

    def __init__(self) -> None:
        self.resets = 0
        self._stream: Stream | None = None
        self._good: _Good | None = None
        self._seen: _Seen | None = None  # the newest
        self._same_since_s = -inf  # since when all poses were the same
        self._silent_s = 0.0  # since the last good pose, without any
        self._astray = ""  # what was wrong when the poses stepped away; they are wrong until they step back

    def judge(
        self, received_s: float, pose: BodyPose, vehicle: VehicleState, others_enu_m: Mapping[int, Vector3]
    ) -> PoseSample:
        """The verdict: a PoseSample, whose fault says why it must not be passed on.

        `vehicle` is the newest state of the own vehicle, `others_enu_m` where the others are.
        """
        self._stream, disorder = following(
            self._stream, pose.session, pose.sequence, pose.sent_s, received_s, silent_s=LATE_S
        )
        if disorder is not None:
            return PoseSample(received_s, received_s, DISORDERS[disorder])
        late_s = self._stream.late_s + pose.age_s
        fault = self._fault(received_s, late_s, pose, vehicle, others_enu_m)
        return PoseSample(received_s, received_s - late_s, fault)

    def _fault(
        self,
        received_s: float,
        late_s: float,
        pose: BodyPose,
        vehicle: VehicleState,
        others_enu_m: Mapping[int, Vector3],
    ) -> str:
        try:
            roll_rad, pitch_rad, yaw_rad = euler_from_quaternion(pose.quaternion)
        except ValueError:
            return "its quaternion is no rotation"
        before, now = self._seen, _Seen(received_s, pose.position_enu_m, pose.quaternion, yaw_rad)
        self._seen = now
        self._note_silence(before, now)
        if late_s > LATE_S:
            return DISORDERS[Disorder.LATE]
        if received_s - self._same_since_s > FROZEN_S and in_air(vehicle):
            return f"frozen: the same for more than {FROZEN_S} s"
        if (tilted_rad := _tilt_off_rad(roll_rad, pitch_rad, vehicle)) > TILT_RAD:
            return f"tilted by {_degrees(tilted_rad)} against the autopilot's attitude"
        if not vehicle.armed and (self._good is None or received_s - self._good.received_s > RESTARTS_S):
            self.resets += self._good is not None
        elif fault := self._stepped(before, now, vehicle, others_enu_m):
            return fault
        self._good = _Good(received_s, pose.position_enu_m, yaw_rad, vehicle.position_enu_m, vehicle.yaw_rad)
        self._silent_s, self._astray = 0.0, ""
        return ""

    def _note_silence(self, before: _Seen | None, now: _Seen) -> None:
        if before is None or (before.position_enu_m, before.quaternion) != (now.position_enu_m, now.quaternion):
            self._same_since_s = now.received_s
        if before is not None and self._good is not None and now.received_s - before.received_s > LATE_S:
            self._silent_s += now.received_s - before.received_s

    def _stepped(
        self, before: _Seen | None, now: _Seen, vehicle: VehicleState, others_enu_m: Mapping[int, Vector3]
    ) -> str:
        """What is wrong with place or yaw. Poses that once stepped away do not become right because the estimate drifts."""
        goes_on = before is not None and _goes_on(before, now, vehicle)
        if goes_on and self._astray:
            return self._astray
        if (turned_rad := self._turned_rad(now.yaw_rad, vehicle)) > TURN_RAD:
            fault = f"turned by {_degrees(turned_rad)} against the autopilot's yaw"
        else:
            fault = self._jump(now.received_s, now.position_enu_m, vehicle, others_enu_m)
        if not goes_on and self._good is not None:  # before the first good one the estimate may not be known yet
            self._astray = fault
        return fault

    def _turned_rad(self, yaw_rad: float, vehicle: VehicleState) -> float:
        """Against the autopilot's yaw, and against its change since the last good pose: the smaller one."""
        off_rad = wrap_pi(yaw_rad - vehicle.yaw_rad)
        if (good := self._good) is None:
            return abs(off_rad)
        return min(abs(off_rad), abs(wrap_pi(off_rad - good.yaw_rad + good.estimated_yaw_rad)))

    def _jump(
        self, received_s: float, position_enu_m: Vector3, vehicle: VehicleState, others_enu_m: Mapping[int, Vector3]
    ) -> str:
        """Against the place to be expected by the estimate, by its change since the last good pose, and by its velocity.

        The estimate itself steps when vision returns, so that each of them may be wrong alone.
        """
        expected, allowed_m = [vehicle.position_enu_m], JUMP_M
        if (good := self._good) is not None:
            since_s = received_s - good.received_s
            expected.append(plus(good.position_enu_m, minus(vehicle.position_enu_m, good.estimate_enu_m)))
            expected.append(plus(good.position_enu_m, scaled(vehicle.velocity_enu_m_s, since_s)))
            allowed_m = min(JUMP_M + JUMP_M_S * since_s, LARGEST_JUMP_M) + SILENT_M_S * self._silent_s
        off_m = min(dist(position_enu_m, place) for place in expected)
        near = next((i for i, place in others_enu_m.items() if dist(position_enu_m, place) < min(NEAR_M, off_m)), None)
        if near is not None and off_m > JUMP_M:
            return f"swapped: vehicle {near} is there, {off_m:.2f} m away"
        return f"jumped by {off_m:.2f} m" if off_m > allowed_m else ""


def _goes_on(before: _Seen, now: _Seen, vehicle: VehicleState) -> bool:
    """Whether two poses show one body, about which nothing has changed between them."""
    gap_s = now.received_s - before.received_s
    expected_enu_m = plus(before.position_enu_m, scaled(vehicle.velocity_enu_m_s, gap_s))
    within_m = min(STEP_M + STEP_M_S * gap_s, NEAR_M)
    near = dist(expected_enu_m, now.position_enu_m) <= within_m
    return near and gap_s <= RESTARTS_S and abs(wrap_pi(now.yaw_rad - before.yaw_rad)) <= TURN_RAD


def _tilt_off_rad(roll_rad: float, pitch_rad: float, vehicle: VehicleState) -> float:
    """Angle between the body's vertical axes by the pose and by the autopilot, whose yaw does not count."""
    if vehicle.attitude_time_s == -inf:
        return 0.0
    ours = (sin(pitch_rad), -sin(roll_rad) * cos(pitch_rad), cos(roll_rad) * cos(pitch_rad))
    roll_rad, pitch_rad = vehicle.roll_rad, vehicle.pitch_rad
    own = (sin(pitch_rad), -sin(roll_rad) * cos(pitch_rad), cos(roll_rad) * cos(pitch_rad))
    along = sum(a * b for a, b in zip(ours, own, strict=True))
    return acos(max(-1.0, min(1.0, along)))


def _degrees(angle_rad: float) -> str:
    return f"{degrees(angle_rad):.0f} deg"
