"""From a wanted acceleration to the attitude and thrust that are sent, against the wind that is found meanwhile."""

from __future__ import annotations

from collections import Counter
from math import cos, degrees, hypot, inf

from companion.core.control.attitude import attitude_target, limit_acceleration
from companion.core.estimation.wind import DisturbanceObserver
from companion.core.safety.output_limits import OutputLimiter, OutputLimits
from companion.types.autopilot import AttitudeTarget, VehicleState
from companion.types.notices import Code
from companion.types.rejections import counted
from companion.types.values import ZERO3, Vector3

THRUST_FRESH_S = 0.3  # PX4 sends its thrust 10 times a second by default


class SetpointStream:
    """One vehicle's setpoints. `rejected` counts what was decided and must not be sent.

    `largest_step_deg` is of roll and pitch together, from one setpoint to the next since the stream began; the first one is
    compared with the attitude that the vehicle had.
    """

    def __init__(self, limits: OutputLimits, observer: DisturbanceObserver) -> None:
        self._limits = limits
        self._gate = OutputLimiter(limits)
        self.observer = observer
        self.rejected: Counter[str] = Counter()
        self.largest_step_deg = 0.0
        self._position_used_s = -inf
        self.sent_s = 0.0  # of the last setpoint, or when the stream was opened
        self._final_level_sent = False  # in this silence
        self._commanded_enu_m_s2 = ZERO3  # by the last setpoint, less what it did against the disturbance
        self.sent = AttitudeTarget(0.0, 0.0, 0.0, 0.0)  # the last setpoint
        self._yaw_rad = 0.0

    def open(self, now_s: float, vehicle: VehicleState) -> None:
        """Begin a stream from what the vehicle does now."""
        self._yaw_rad = vehicle.yaw_rad
        self.sent_s, self._commanded_enu_m_s2 = now_s, ZERO3
        current = self._as_it_flies(now_s, vehicle)
        self.sent, self.largest_step_deg = current, 0.0
        self._gate.open_at(now_s, current, self.observer.hover_thrust_norm)

    def may_follow(self, vehicle: VehicleState) -> bool:
        """A decision needs a position that no decision was made from before."""
        return vehicle.position_time_s > self._position_used_s

    def carry_on(self, now_s: float, vehicle: VehicleState) -> AttitudeTarget | None:
        """What the vehicle does already, until the autopilot has taken the stream."""
        return self._send(now_s, vehicle, ZERO3, self._as_it_flies(now_s, vehicle))

    def follow(self, now_s: float, vehicle: VehicleState, wanted_enu_m_s2: Vector3) -> AttitudeTarget | None:
        """The attitude for this acceleration, as near as tilt and thrust allow, against the estimated disturbance."""
        (x, y, z), (dx, dy, dz), limits = wanted_enu_m_s2, self.observer.disturbance_enu_m_s2, self._limits
        x, y, z = limit_acceleration(
            (x - dx, y - dy, z - dz), limits.max_tilt_rad, limits.min_thrust_ratio, limits.max_thrust_ratio
        )
        try:
            target = attitude_target(
                (x, y, z), self._yaw_rad, vehicle.roll_rad, vehicle.pitch_rad, self.observer.hover_thrust_norm
            )
        except ValueError:
            self._position_used_s = vehicle.position_time_s
            self.rejected = counted(self.rejected, Code.SETPOINT_IMPOSSIBLE)
            return None
        return self._send(now_s, vehicle, (x + dx, y + dy, z + dz), target)

    def final_level_setpoint(self, now_s: float) -> AttitudeTarget | None:
        """Level, once in each silence, for an autopilot that goes on with the last setpoint."""
        if self._final_level_sent:
            return None
        self._final_level_sent = True
        self._commanded_enu_m_s2 = ZERO3
        hover_thrust_norm = self.observer.hover_thrust_norm
        level = AttitudeTarget(0.0, 0.0, self._yaw_rad, hover_thrust_norm)
        self._gate.open_at(now_s, level, hover_thrust_norm)  # no slew: no next setpoint will come closer
        return self._gate.admit(now_s, level, hover_thrust_norm)

    def flown_acceleration_enu_m_s2(self, now_s: float, for_s: float) -> Vector3:
        """What the autopilot is believed to fly: the last setpoint goes on for a while over ticks that decide nothing."""
        return ZERO3 if now_s - self.sent_s > for_s else self._commanded_enu_m_s2

    def _send(
        self, now_s: float, vehicle: VehicleState, acceleration_enu_m_s2: Vector3, wanted: AttitudeTarget
    ) -> AttitudeTarget | None:
        self._position_used_s = vehicle.position_time_s
        target = self._gate.admit(now_s, wanted, self.observer.hover_thrust_norm)
        if target is None:
            self.rejected = counted(self.rejected, Code.SETPOINT_IMPOSSIBLE)
            return None
        sent = self.sent
        step_deg = degrees(hypot(target.roll_rad - sent.roll_rad, target.pitch_rad - sent.pitch_rad))
        if step_deg > self.largest_step_deg:
            self.largest_step_deg = step_deg
        self.sent, self.sent_s, self._commanded_enu_m_s2 = target, now_s, acceleration_enu_m_s2
        self._final_level_sent = False
        return target

    def _as_it_flies(self, now_s: float, vehicle: VehicleState) -> AttitudeTarget:
        """The attitude that the vehicle has, with the thrust that carries it: no step where the autopilot takes over."""
        if now_s - vehicle.thrust_time_s <= THRUST_FRESH_S:
            thrust = vehicle.thrust_norm
        else:
            share = max(0.5, cos(vehicle.roll_rad) * cos(vehicle.pitch_rad))
            thrust = self.observer.hover_thrust_norm / share
        return AttitudeTarget(vehicle.roll_rad, vehicle.pitch_rad, self._yaw_rad, thrust)
