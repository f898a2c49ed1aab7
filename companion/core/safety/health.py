"""Ages and positions -> HealthFlags. Stale is a value here, not an exception."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, cos, inf, radians

from companion.core.estimation.corrections import LARGEST_JUMP_M, ORIGIN_WITHIN_S
from companion.core.safety.output_limits import OutputLimits
from companion.types.autopilot import VehicleState
from companion.types.flight import HealthFlag

# Positions that peers must not use; positions that the vehicle itself does not know.
POSITION_WRONG = frozenset({HealthFlag.FRAME_CONTRADICTED, HealthFlag.POSITION_JUMPED})
POSITION_IN_DOUBT = POSITION_WRONG | {HealthFlag.POSITION_STALE, HealthFlag.FRAME_UNKNOWN}


@dataclass(frozen=True, slots=True)
class AgeLimits:
    """How old what the agent decides on may be, in seconds."""

    state_s: float = 0.04  # two periods of 50 Hz: no fresh decision, no setpoint
    attitude_s: float = 0.1
    mode_s: float = 0.8  # PX4 sends a new mode at once and an unchanged one twice a second, up to 0.53 s apart
    armed_s: float = 3.0  # PX4 sends HEARTBEAT once a second, whatever is asked
    landed_s: float = 3.0


@dataclass(frozen=True, slots=True)
class HealthLimits:
    """What raises the flags of the vehicle. A battery limit of None raises none."""

    ages: AgeLimits
    envelope: OutputLimits
    low_battery_percent: float | None = None
    critical_battery_percent: float | None = None
    max_position_error_m: float = 5.0  # PX4: COM_POS_FS_EPH
    tilt_margin_rad: float = radians(10.0)  # above the commanded limit: autopilots overshoot it, and gusts add to it


def health_flags(now_s: float, vehicle: VehicleState, limits: HealthLimits) -> set[HealthFlag]:
    """The flags that the state of the own vehicle raises at `now_s`."""
    flags, ages = set(), limits.ages
    if now_s - vehicle.position_time_s > ages.state_s:
        flags.add(HealthFlag.POSITION_STALE)
    if now_s - vehicle.attitude_time_s > ages.attitude_s:
        flags.add(HealthFlag.ATTITUDE_STALE)
    if now_s - vehicle.mode_time_s > ages.mode_s:
        flags.add(HealthFlag.MODE_STALE)
    if now_s - vehicle.heartbeat_time_s > ages.armed_s:
        flags.add(HealthFlag.ARMED_STALE)
    if now_s - vehicle.landed_time_s > ages.landed_s:
        flags.add(HealthFlag.LANDED_STALE)
    if not vehicle.frame_known:
        flags.add(HealthFlag.FRAME_UNKNOWN)
    if vehicle.frame_contradicted:
        flags.add(HealthFlag.FRAME_CONTRADICTED)
    if vehicle.held_back_m > LARGEST_JUMP_M and now_s - vehicle.jump_time_s > ORIGIN_WITHIN_S:
        flags.add(HealthFlag.POSITION_JUMPED)
    if vehicle.position_time_s > -inf and not limits.envelope.fence.contains(vehicle.position_enu_m):
        flags.add(HealthFlag.OUTSIDE_FENCE)
    error = vehicle.position_error
    if not vehicle.estimator_healthy or (error and error.horizontal_m > limits.max_position_error_m):
        flags.add(HealthFlag.ESTIMATOR_BAD)
    if acos(cos(vehicle.roll_rad) * cos(vehicle.pitch_rad)) > limits.envelope.max_tilt_rad + limits.tilt_margin_rad:
        flags.add(HealthFlag.TILT_EXCEEDED)
    if _below(vehicle.battery_percent, limits.low_battery_percent):
        flags.add(HealthFlag.BATTERY_LOW)
    if _below(vehicle.battery_percent, limits.critical_battery_percent):
        flags.add(HealthFlag.BATTERY_CRITICAL)
    return flags


def _below(percent: float, limit_percent: float | None) -> bool:
    """An unknown charge (-1) is not low."""
    return limit_percent is not None and 0.0 <= percent < limit_percent
