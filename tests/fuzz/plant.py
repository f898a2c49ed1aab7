"""A point mass with an autopilot that executes every request at once: cheap enough for a million ticks of whole agents."""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, sin

from companion.geometry.frames import geodetic_from_enu
from companion.types.autopilot import (
    Arm,
    AttitudeSample,
    AttitudeTarget,
    AutopilotKind,
    AutopilotMode,
    AutopilotRequest,
    Disarm,
    HeartbeatSample,
    HomeSample,
    LandedSample,
    LandedState,
    ModeSample,
    OriginSample,
    ParameterSample,
    PositionSample,
    RallySample,
    RequestOrigin,
    RequestParameter,
    SetMode,
    SystemSample,
    TakeOff,
    Telemetry,
)
from companion.types.values import GRAVITY_M_S2, Vector3

TICK_S = 0.02
HOVER_THRUST_NORM = 0.5
CLIMB_M_S = 3.0
SYSTEM_TICKS = 25  # period of SYS_STATUS: 2 Hz, as autopilots send it
LOSS_TICKS = 50  # without a setpoint, COM_OF_LOSS_T: then COM_OBL_RC_ACT holds
ORIGIN = (47.0, 8.0, 400.0)  # latitude, longitude, altitude
PARAMETERS: Mapping[str, int | float] = {  # of a PX4 that the audit accepts
    "COM_OF_LOSS_T": 1.0,
    "COM_OBL_RC_ACT": 5,
    "NAV_DLL_ACT": 0,
    "COM_RC_OVERRIDE": 3,
    "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 200.0,
    "GF_MAX_VER_DIST": 50.0,
    "RTL_TYPE": 0,
    "MPC_THR_HOVER": HOVER_THRUST_NORM,
}


class Plant:
    """Position and velocity in ENU, flight mode and arming of one vehicle."""

    def __init__(self, position_enu_m: Vector3) -> None:
        self.position_enu_m, self.velocity_enu_m_s = position_enu_m, (0.0, 0.0, 0.0)
        self.mode, self.armed, self.landed = AutopilotMode.HOLD, False, LandedState.ON_GROUND
        self._ground_m, self._goal_m = position_enu_m[2], position_enu_m[2]
        self._attitude = AttitudeTarget(0.0, 0.0, 0.0, HOVER_THRUST_NORM)
        self._home = _geodetic(position_enu_m)
        self._answers: list[Telemetry] = []
        self._ticks = 0
        self._silent_ticks = 0

    def telemetry(self, now_s: float) -> tuple[Telemetry, ...]:
        """All samples of one tick."""
        answers, self._answers = self._answers, []
        self._ticks += 1
        if self._ticks % SYSTEM_TICKS == 2:  # an agent disregards what was sent before its first tick
            answers.append(SystemSample(now_s, 90.0, may_arm=True))
            answers.append(HomeSample(now_s, *self._home))
            answers.append(RallySample(now_s, has_rally_points=False))
        attitude = self._attitude if self._is_followed else AttitudeTarget(0.0, 0.0, 0.0, HOVER_THRUST_NORM)
        return (
            AttitudeSample(now_s, attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad),
            ModeSample(now_s, self.mode, self.mode.value),
            HeartbeatSample(now_s, self.armed, AutopilotKind.PX4),
            LandedSample(now_s, self.landed),
            *answers,
            PositionSample(now_s, now_s, self.position_enu_m, self.velocity_enu_m_s),
        )

    def execute(self, now_s: float, requests: tuple[AutopilotRequest, ...]) -> None:
        """Do what the agent requests."""
        for request in requests:
            match request:
                case SetMode(mode):
                    self.mode = mode
                case Arm():
                    self.armed = True
                    self._home = _geodetic(self.position_enu_m)
                case Disarm():
                    self.armed = self.armed and self.landed is not LandedState.ON_GROUND
                case TakeOff(height_m):
                    self.mode, self.landed = AutopilotMode.TAKEOFF, LandedState.IN_AIR
                    self._goal_m = self.position_enu_m[2] + height_m
                case RequestOrigin():
                    self._answers.append(OriginSample(now_s, *ORIGIN))
                case RequestParameter(name) if name in PARAMETERS:
                    self._answers.append(ParameterSample(now_s, name, float(PARAMETERS[name])))

    def move(self, target: AttitudeTarget | None) -> None:
        """Advance by one tick."""
        self._attitude = target or self._attitude
        self._silent_ticks = 0 if target else self._silent_ticks + 1
        if self._is_followed and self._silent_ticks > LOSS_TICKS:
            self.mode = AutopilotMode.HOLD
        if not self.armed or self.landed is LandedState.ON_GROUND:
            self.velocity_enu_m_s = (0.0, 0.0, 0.0)
            return
        if self._is_followed:
            ax, ay, az = _acceleration(self._attitude)
            vx, vy, vz = self.velocity_enu_m_s
            self._shift((vx + ax * TICK_S, vy + ay * TICK_S, vz + az * TICK_S))
        else:
            self._shift((0.0, 0.0, self._climb_m_s()))
        if self.position_enu_m[2] <= self._ground_m and self.mode in (AutopilotMode.LAND, AutopilotMode.RETURN):
            self.landed, self.armed = LandedState.ON_GROUND, False

    @property
    def _is_followed(self) -> bool:
        return self.mode is AutopilotMode.OFFBOARD and self.armed

    def _climb_m_s(self) -> float:
        if self.mode in (AutopilotMode.LAND, AutopilotMode.RETURN):
            return -CLIMB_M_S
        if self.mode is AutopilotMode.TAKEOFF:
            if self.position_enu_m[2] < self._goal_m - 0.05:
                return CLIMB_M_S
            self.mode = AutopilotMode.HOLD
        return 0.0

    def _shift(self, velocity_enu_m_s: Vector3) -> None:
        (x, y, z), (vx, vy, vz) = self.position_enu_m, velocity_enu_m_s
        self.velocity_enu_m_s = velocity_enu_m_s
        self.position_enu_m = (x + vx * TICK_S, y + vy * TICK_S, max(self._ground_m, z + vz * TICK_S))


def _geodetic(position_enu_m: Vector3) -> tuple[float, float]:
    latitude, longitude, _ = geodetic_from_enu(position_enu_m, ORIGIN)
    return latitude, longitude


def _acceleration(target: AttitudeTarget) -> Vector3:
    """Of a point mass with this attitude and thrust, m/s^2 in ENU."""
    lift = target.thrust_norm / HOVER_THRUST_NORM * GRAVITY_M_S2
    roll, pitch, yaw = target.roll_rad, target.pitch_rad, target.yaw_rad
    x = cos(yaw) * sin(pitch) * cos(roll) + sin(yaw) * sin(roll)
    y = sin(yaw) * sin(pitch) * cos(roll) - cos(yaw) * sin(roll)
    return (lift * x, lift * y, lift * cos(pitch) * cos(roll) - GRAVITY_M_S2)
