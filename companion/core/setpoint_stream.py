"""From a wanted acceleration to the attitude and thrust that are sent, against the wind that is found meanwhile."""

from __future__ import annotations

from collections import Counter
from math import cos, degrees, hypot, inf

from companion.core.attitude import attitude_target, limit_acceleration
from companion.core.disturbance import DisturbanceObserver, Motion
from companion.core.envelope import EnvelopeLimits, LastGate
from companion.types import ZERO3, AttitudeTarget, Vector3, VehicleState

THRUST_FRESH_S = 0.3  # PX4 tells its thrust 10 times a second where nothing else was asked


class SetpointStream:
    """One vehicle's setpoints. `rejected` counts what was decided and must not be sent.

    `largest_step_deg` is of roll and pitch together, from one setpoint to the next since the stream began; the first one is
    compared with the attitude that the vehicle had.
    """

    def __init__(self, limits: EnvelopeLimits, observer: DisturbanceObserver) -> None:
        self._limits = limits
        self._gate = LastGate(limits)
        self.observer = observer
        self.rejected: Counter[str] = Counter()
        self.largest_step_deg = 0.0
        self._position_used_s = -inf
        self._spoke_s = 0.0
        self._last_word_spoken = False  # in this silence
        self._commanded_enu_m_s2 = ZERO3  # by the last setpoint, less what it did against the disturbance
        self._sent = AttitudeTarget(0.0, 0.0, 0.0, 0.0)
        self._yaw_rad = 0.0

    def open(self, now_s: float, vehicle: VehicleState) -> None:
        """Begin a stream from what the vehicle does now."""
        self._yaw_rad = vehicle.yaw_rad
        self._spoke_s, self._commanded_enu_m_s2 = now_s, ZERO3
        current = self._as_it_flies(now_s, vehicle)
        self._sent, self.largest_step_deg = current, 0.0
        self._gate.open_at(now_s, current, self.observer.hover_thrust_norm)

    def silent_s(self, now_s: float) -> float:
        """How long since the last setpoint, or since the stream was opened."""
        return now_s - self._spoke_s

    def may_follow(self, vehicle: VehicleState) -> bool:
        """A decision needs a position that no decision was made from before."""
        return vehicle.position_time_s > self._position_used_s

    def carry_on(self, now_s: float, vehicle: VehicleState) -> AttitudeTarget | None:
        """What the vehicle does already, until the autopilot has taken the stream."""
        return self._send(now_s, vehicle, ZERO3, self._as_it_flies(now_s, vehicle))

    def follow(self, now_s: float, vehicle: VehicleState, wanted_enu_m_s2: Vector3) -> AttitudeTarget | None:
        """The acceleration as near as tilt and thrust allow, against the disturbance, through the last gate."""
        acceleration_enu_m_s2, against_enu_m_s2 = self._within_reach(wanted_enu_m_s2)
        try:
            target = attitude_target(
                against_enu_m_s2, self._yaw_rad, vehicle.roll_rad, vehicle.pitch_rad, self.observer.hover_thrust_norm
            )
        except ValueError as error:
            self._position_used_s = vehicle.position_time_s
            self.rejected[f"own command: {error}"] += 1
            return None
        return self._send(now_s, vehicle, acceleration_enu_m_s2, target)

    def last_word(self, now_s: float) -> AttitudeTarget | None:
        """Level, once in each silence, for an autopilot that goes on with the last setpoint."""
        if self._last_word_spoken:
            return None
        self._last_word_spoken = True
        self._commanded_enu_m_s2 = ZERO3
        hover_thrust_norm = self.observer.hover_thrust_norm
        level = AttitudeTarget(0.0, 0.0, self._yaw_rad, hover_thrust_norm)
        self._gate.open_at(now_s, level, hover_thrust_norm)  # no slew: no next setpoint will come closer
        return self._gate.admit(now_s, level, hover_thrust_norm)

    def flown_acceleration_enu_m_s2(self, now_s: float, for_s: float) -> Vector3:
        """What the autopilot is believed to fly: the last setpoint goes on for a while over ticks that decide nothing."""
        return ZERO3 if now_s - self._spoke_s > for_s else self._commanded_enu_m_s2

    def observe_own(self, now_s: float, vehicle: VehicleState) -> None:
        """Learn of wind and hover thrust while the autopilot takes the setpoints."""
        self._observe(now_s, vehicle, self._spoke_s, self._sent.thrust_norm)

    def observe_told(self, now_s: float, vehicle: VehicleState) -> None:
        """Learn of them while the autopilot flies by itself and tells its thrust."""
        self._observe(now_s, vehicle, vehicle.thrust_time_s, vehicle.thrust_norm)

    def _observe(self, now_s: float, vehicle: VehicleState, thrust_time_s: float, thrust_norm: float) -> None:
        if now_s - thrust_time_s > THRUST_FRESH_S:
            self.observer.pause()
            return
        attitude_rad = (vehicle.roll_rad, vehicle.pitch_rad, vehicle.yaw_rad)
        self.observer.update(Motion(vehicle.position_time_s, vehicle.velocity_enu_m_s, attitude_rad, thrust_norm))

    def _within_reach(self, wanted_enu_m_s2: Vector3) -> tuple[Vector3, Vector3]:
        """What tilt and thrust can give of it, and the acceleration that thrust must give for that against the disturbance."""
        (x, y, z), (dx, dy, dz) = wanted_enu_m_s2, self.observer.disturbance_enu_m_s2
        limits = self._limits
        x, y, z = limit_acceleration(
            (x - dx, y - dy, z - dz), limits.max_tilt_rad, limits.min_thrust_ratio, limits.max_thrust_ratio
        )
        return (x + dx, y + dy, z + dz), (x, y, z)

    def _send(
        self, now_s: float, vehicle: VehicleState, acceleration_enu_m_s2: Vector3, wanted: AttitudeTarget
    ) -> AttitudeTarget | None:
        self._position_used_s = vehicle.position_time_s
        target = self._gate.admit(now_s, wanted, self.observer.hover_thrust_norm)
        if target is None:
            self.rejected["own command: not finite"] += 1
            return None
        self._spoke_s, self._commanded_enu_m_s2 = now_s, acceleration_enu_m_s2
        self._last_word_spoken = False
        self._note_step(target)
        return target

    def _note_step(self, target: AttitudeTarget) -> None:
        step_rad = hypot(target.roll_rad - self._sent.roll_rad, target.pitch_rad - self._sent.pitch_rad)
        self.largest_step_deg, self._sent = max(self.largest_step_deg, degrees(step_rad)), target

    def _as_it_flies(self, now_s: float, vehicle: VehicleState) -> AttitudeTarget:
        """The attitude that the vehicle has, with the thrust that carries it: no step where the autopilot takes over."""
        if now_s - vehicle.thrust_time_s <= THRUST_FRESH_S:
            thrust = vehicle.thrust_norm
        else:
            share = max(0.5, cos(vehicle.roll_rad) * cos(vehicle.pitch_rad))
            thrust = self.observer.hover_thrust_norm / share
        return AttitudeTarget(vehicle.roll_rad, vehicle.pitch_rad, self._yaw_rad, thrust)
