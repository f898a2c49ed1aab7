"""External vision in place of GPS: the estimate of one vehicle from poses of a motion-capture system. No sockets, no clocks.

The axes of the capture frame are those of the world; where its zero is, the poses say. What PX4 and ArduCopter do differently
is `VisionData`, in `data.yaml` of each type; what their modes and arming make of it stands in their own rooms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, hypot, inf, nan, pi, radians, sin, tau
from random import Random

import msgspec

from companion.geometry.frames import enu_from_ned, euler_enu_from_ned, euler_from_quaternion, wrap_pi
from companion.geometry.vectors import minus, plus, scaled
from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.types.values import ZERO3, Vector3
from sitl.vehicle.config import AutopilotFile
from sitl.vehicle.control import AttitudeSetpoint
from sitl.vehicle.quadrotor import Quadrotor, about_vertical

FARTHEST_M = 10_000.0  # the stand-in's world is flat; what is farther is no pose
OLDEST_S = 0.2  # of a pose that is moved on to now; the stamp of an older one counts as of another clock
COASTS_S, RESTARTS_AFTER_S = 0.2, 0.45  # gaps that change nothing; and after which the estimate is reset
FOLLOWS_EVERY_S = 0.02
YAW_FOLLOWS_1_S = 1.0
TURNED_ABOUT_RAD = 0.75 * pi
REJECTED_RATIO, ACCEPTED_RATIO = 2.0, 0.1  # pos_horiz_ratio of ESTIMATOR_STATUS
FIELD_WITHIN_M, FIELD_STEPS_EVERY_S = 1.0, 1.0
ROTATION_WITHIN = 0.1  # of the square of a quaternion's length
EPSILON_S = 1e-6


class VisionData(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What an autopilot type does with external vision, as measured.

    not_before: the first sample counts from this share of `armable_after_s` on
    fix_after_s, fix_text: of the first sample
    restart_after_s: of the first sample after a loss
    renumbered_after_s: of the first sample with another `reset_counter`
    follows_rad_s, damping: how the estimate follows poses that it does not reject
    rejects_m: distance from which it rejects them; `rejects_s`, `rejects_text`: for how long, and what it says
    steps: in so many it then goes to the pose
    drift_m_s, drift_m_s2: of the dead reckoning
    frozen_m_s: drift of a flying vehicle whose poses do not change
    rejects_yaw_deg: difference from which it rejects a yaw, for `rejects_yaw_s`, turned about for `rejects_turned_about_s`
    height_is_amsl: every start sets the altitude above sea level to the height of the pose
    field_step_m, field_steps_m: with an origin that is not at the field's altitude, growth of the height every second while
        disarmed, and its end
    odometry_frames: frames of an ODOMETRY that it takes, and of its velocities; without the latter any
    sends_zeros: what it does not know it sends as zeros; otherwise it does not send it
    parameters: those that differ from flights with GPS
    """

    not_before: float = 0.0
    fix_after_s: float
    fix_text: str = ""
    restart_after_s: float
    renumbered_after_s: float = 0.0
    follows_rad_s: float
    damping: float
    rejects_m: float
    rejects_s: float
    rejects_text: str = ""
    steps: int = 1
    drift_m_s: float = 0.0
    drift_m_s2: float
    frozen_m_s: float
    rejects_yaw_deg: float
    rejects_yaw_s: float
    rejects_turned_about_s: float
    height_is_amsl: bool = False
    field_step_m: float = 0.0
    field_steps_m: float = 0.0
    odometry_frames: tuple[tuple[str, str | None], ...]
    sends_zeros: bool = False
    parameters: dict[str, int | float]

    def takes(self, odometry: MavlinkMessage) -> bool:
        """Whether it uses an ODOMETRY in these frames."""
        frames = [[name and getattr(mavlink, f"MAV_FRAME_{name}") for name in pair] for pair in self.odometry_frames]
        return any(odometry.frame_id == frame and child in (None, odometry.child_frame_id) for frame, child in frames)


@dataclass(frozen=True, slots=True)
class Pose:
    """A pose of the capture system; `stamp_s` is in the autopilot's time, if its sender knows that."""

    stamp_s: float
    position_enu_m: Vector3
    yaw_rad: float
    reset_counter: int


def pose_of(message: MavlinkMessage, stamp_us: int, yaw_ned_rad: float) -> Pose | None:
    """The pose of a VISION_POSITION_ESTIMATE or ODOMETRY; None for one that is not in this world."""
    position_enu_m = enu_from_ned((message.x, message.y, message.z))
    if not abs(yaw_ned_rad) <= tau or not all(abs(value) <= FARTHEST_M for value in position_enu_m):
        return None
    yaw_rad = euler_enu_from_ned(0.0, 0.0, yaw_ned_rad)[2]
    return Pose(stamp_us / 1e6, position_enu_m, yaw_rad, message.reset_counter)


def pose_of_odometry(message: MavlinkMessage) -> Pose | None:
    """The same of an ODOMETRY, whose quaternion must be one."""
    w, x, y, z = message.q
    is_rotation = abs(w * w + x * x + y * y + z * z - 1.0) <= ROTATION_WITHIN
    yaw_ned_rad = euler_from_quaternion((w, x, y, z))[2] if is_rotation else nan
    return pose_of(message, message.time_usec, yaw_ned_rad)


class ExternalVision:
    """The estimator of one vehicle. Its estimate is that of `quad`, which it shifts."""

    def __init__(
        self,
        data: VisionData,
        file: AutopilotFile,
        quad: Quadrotor,
        armable_after_s: float,
        reset_estimator: Callable[[Vector3], None],
        send_text: Callable[[str], None],
    ) -> None:
        """`reset_estimator` steps the estimate, and with it what the autopilot holds."""
        self._data, self._quad = data, quad
        self._reset_estimator, self._send_text = reset_estimator, send_text
        self._not_before_s = data.not_before * armable_after_s
        angle_rad = Random(f"{file.stand_in.seed} {file.id} vision").uniform(0.0, tau)
        self._drifts_to: Vector3 = (cos(angle_rad), sin(angle_rad), 0.0)
        self.fixed_s = inf  # when it had its first fix
        self.back_s = -inf  # when the first sample after the last loss came
        self.origin_s = inf  # when its origin was set
        self.position_ratio = ACCEPTED_RATIO
        self.yaw_off_rad = 0.0  # of the last sample
        self._used_s = self._sample_s = -inf
        self._is_used = False  # the present series of samples
        self._newest: Pose | None = None
        self._error_m_s = ZERO3  # of the velocity
        self._rejected_s = self._yaw_rejected_s = self._renumbered_s = inf  # since when
        self._steps_left = 0
        self._height_m = 0.0  # of the local frame's zero below that of the capture frame
        self._field_step_s = 0.0

    @property
    def fixed(self) -> bool:
        """Whether it has had a fix."""
        return self.fixed_s < inf

    def lost_s(self, now_s: float) -> float:
        """For how long it has dead-reckoned; 0 while it does not."""
        unaided_s = now_s - self._used_s
        return unaided_s if self.fixed and unaided_s > COASTS_S + EPSILON_S else 0.0

    def silent_s(self, now_s: float) -> float:
        """Age of the newest sample."""
        return now_s - self._sample_s

    def set_origin(self, origin_deg_deg_m: Vector3, now_s: float) -> None:
        """SET_GPS_GLOBAL_ORIGIN: the zero of the local frame is at this place from now on; local positions stay."""
        self._quad.name_origin(origin_deg_deg_m)
        self.origin_s = now_s

    # ------------------------------------------------------------ time

    def step(self, now_s: float, dt_s: float, armed: bool) -> None:
        """Advance to this time without a sample."""
        if lost_s := self.lost_s(now_s):
            speed_m_s = self._data.drift_m_s + self._data.drift_m_s2 * (lost_s - COASTS_S)
            self._move(scaled(self._drifts_to, speed_m_s), ZERO3, dt_s)
        wrong_m = abs(self._quad.origin[2] - self._quad.world_origin[2]) if self.origin_s < inf else 0.0
        if self._data.field_step_m and wrong_m > FIELD_WITHIN_M and not armed and now_s >= self._field_step_s:
            self._field_step_s = now_s + FIELD_STEPS_EVERY_S
            self._lift(self._data.field_step_m)

    def _lift(self, step_m: float) -> None:
        if self.fixed and self._height_m + step_m <= self._data.field_steps_m:
            self._height_m += step_m
            self._reset_estimator((0.0, 0.0, step_m))

    def true_setpoint(self, setpoint: AttitudeSetpoint) -> AttitudeSetpoint:
        """What a setpoint in the estimated frame is in the true one: the loops measure by the wrong yaw, too."""
        if not self._quad.yaw_error_rad:
            return setpoint
        return msgspec.structs.replace(
            setpoint, quaternion=about_vertical(setpoint.quaternion, -self._quad.yaw_error_rad)
        )

    # ------------------------------------------------------------ samples

    def receive(self, pose: Pose, now_s: float, boot_s: float) -> None:
        """A sample; `boot_s` is the autopilot's time."""
        if now_s < self._not_before_s:
            return
        gap_s, self._sample_s = now_s - self._sample_s, now_s
        before, self._newest = self._newest, pose
        if gap_s >= RESTARTS_AFTER_S:
            self._is_used, self.back_s = False, now_s
        if self._is_used:
            self._use(pose, before, gap_s, self._residual_m(pose, boot_s))
        else:
            waits_s = self._data.restart_after_s if self.fixed else self._data.fix_after_s
            if now_s - self.back_s < waits_s - EPSILON_S:
                return
            self._restart(pose, boot_s)
        self._used_s = now_s

    def _residual_m(self, pose: Pose, boot_s: float) -> Vector3:
        """Where the pose is now, seen from the estimate."""
        x, y, z = pose.position_enu_m
        age_s = boot_s - pose.stamp_s
        vx, vy, vz = scaled(self._quad.velocity_enu_m_s, age_s) if 0.0 < age_s <= OLDEST_S else ZERO3
        return minus((x + vx, y + vy, z + vz + self._height_m), self._quad.aided_position_local_enu_m())

    def _restart(self, pose: Pose, boot_s: float) -> None:
        """The first fix, or the first after a loss: one step to the pose."""
        if self._data.height_is_amsl and self.origin_s < inf:
            self._height_m = -self._quad.origin[2]
        if not self.fixed:
            self.fixed_s = self._sample_s
            self._turn(self._yaw_residual_rad(pose))
            if self._data.fix_text:
                self._send_text(self._data.fix_text)
        self._is_used, self._steps_left = True, 0
        self._rejected_s = self._yaw_rejected_s = self._renumbered_s = inf
        self._step(self._residual_m(pose, boot_s))

    def _use(self, pose: Pose, before: Pose | None, gap_s: float, residual_m: Vector3) -> None:
        assert before is not None  # a restart came first
        now_s = self._sample_s
        self._use_yaw(self._yaw_residual_rad(pose), gap_s)
        if pose.reset_counter != before.reset_counter:
            self._renumbered_s = now_s
        if self._renumbered_s < inf:
            if now_s - self._renumbered_s >= self._data.renumbered_after_s - EPSILON_S:
                self._renumbered_s = self._rejected_s = inf
                self._step(residual_m)
        elif self._steps_left:
            self._step(scaled(residual_m, 1.0 / self._steps_left))
            self._steps_left -= 1
        elif hypot(*residual_m) > self._data.rejects_m:
            self._reject(now_s)
        else:
            self._rejected_s, self.position_ratio = inf, ACCEPTED_RATIO
            frozen = pose.position_enu_m == before.position_enu_m and not self._quad.on_ground
            self._follow(residual_m, gap_s, frozen)

    def _reject(self, now_s: float) -> None:
        self.position_ratio = REJECTED_RATIO
        if self._rejected_s == inf:
            self._rejected_s = now_s
            if self._data.rejects_text:
                self._send_text(self._data.rejects_text)
        elif now_s - self._rejected_s >= self._data.rejects_s - EPSILON_S:
            self._rejected_s, self._steps_left = inf, self._data.steps

    def _follow(self, residual_m: Vector3, gap_s: float, frozen: bool) -> None:
        """A second-order filter. The inertial sensors alone tell the velocity of a frozen pose, and drift."""
        rate, count = self._data.follows_rad_s, max(1, round(gap_s / FOLLOWS_EVERY_S))
        dt_s = gap_s / count
        for _ in range(count):
            velocity = plus(self._error_m_s, scaled(residual_m, rate * rate * dt_s))
            if frozen:
                velocity = scaled(self._drifts_to, self._data.frozen_m_s)
            moved_m = self._move(velocity, scaled(residual_m, 2.0 * self._data.damping * rate), dt_s)
            residual_m = minus(residual_m, moved_m)

    def _move(self, velocity_m_s: Vector3, pull_m_s: Vector3, dt_s: float) -> Vector3:
        """Let the estimate go away from the truth; returns how far."""
        self._error_m_s = self._quad.drift_m_s = velocity_m_s
        moved_m = scaled(plus(velocity_m_s, pull_m_s), dt_s)
        self._quad.drift_m = plus(self._quad.drift_m, moved_m)
        return moved_m

    def _step(self, residual_m: Vector3) -> None:
        self._error_m_s = self._quad.drift_m_s = ZERO3
        self.position_ratio = ACCEPTED_RATIO
        self._reset_estimator(residual_m)

    # ------------------------------------------------------------ yaw

    def _yaw_residual_rad(self, pose: Pose) -> float:
        return wrap_pi(pose.yaw_rad - euler_from_quaternion(self._quad.quaternion)[2] - self._quad.yaw_error_rad)

    def _use_yaw(self, residual_rad: float, gap_s: float) -> None:
        """A small difference is followed. A large one is rejected for a while, then taken in."""
        self.yaw_off_rad = abs(residual_rad)
        if self.yaw_off_rad <= radians(self._data.rejects_yaw_deg):
            self._yaw_rejected_s = inf
            self._turn(residual_rad * min(1.0, YAW_FOLLOWS_1_S * gap_s))
            return
        self._yaw_rejected_s = min(self._yaw_rejected_s, self._sample_s)
        about = self.yaw_off_rad > TURNED_ABOUT_RAD
        rejects_s = self._data.rejects_turned_about_s if about else self._data.rejects_yaw_s
        if self._sample_s - self._yaw_rejected_s >= rejects_s:
            self._turn(residual_rad)

    def _turn(self, angle_rad: float) -> None:
        self._quad.yaw_error_rad = wrap_pi(self._quad.yaw_error_rad + angle_rad)
