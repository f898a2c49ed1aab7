"""Ages and places -> HealthFlags. Stale is a value here, not an exception."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from companion.core.bumpless import LARGEST_JUMP_M, ORIGIN_WITHIN_S
from companion.core.envelope import EnvelopeLimits
from companion.types import HealthFlag, VehicleState

# Of a position: the peers must not heed it; the vehicle itself does not know where it is.
NOT_TO_BE_HEEDED = frozenset({HealthFlag.FRAME_CONTRADICTED, HealthFlag.POSITION_JUMPED})
PLACE_IN_DOUBT = NOT_TO_BE_HEEDED | {HealthFlag.STATE_STALE, HealthFlag.FRAME_UNKNOWN}


@dataclass(frozen=True, slots=True)
class AgeLimits:
    """How old what the agent decides on may be, in seconds."""

    state_s: float = 0.04  # two periods of 50 Hz: no fresh decision, no setpoint
    attitude_s: float = 0.1
    mode_s: float = 0.8  # PX4 tells a change at once, and what stays twice a second: up to 0.53 s apart
    armed_s: float = 3.0  # PX4 sends HEARTBEAT once a second, whatever is asked
    landed_s: float = 3.0


def health_flags(
    now_s: float, vehicle: VehicleState, leaderless: HealthFlag | None, ages: AgeLimits, envelope: EnvelopeLimits
) -> frozenset[HealthFlag]:
    """All that is wrong at `now_s`; `leaderless` is the neighbourhood's."""
    return frozenset(_raised(now_s, vehicle, leaderless, ages, envelope))


def _raised(
    now_s: float, vehicle: VehicleState, leaderless: HealthFlag | None, ages: AgeLimits, envelope: EnvelopeLimits
) -> Iterator[HealthFlag]:
    if now_s - vehicle.position_time_s > ages.state_s:
        yield HealthFlag.STATE_STALE
    if now_s - vehicle.attitude_time_s > ages.attitude_s:
        yield HealthFlag.ATTITUDE_STALE
    if now_s - vehicle.mode_time_s > ages.mode_s:
        yield HealthFlag.MODE_STALE
    if now_s - vehicle.heartbeat_time_s > ages.armed_s:
        yield HealthFlag.ARMED_STALE
    if now_s - vehicle.landed_time_s > ages.landed_s:
        yield HealthFlag.LANDED_STALE
    if not vehicle.frame_known:
        yield HealthFlag.FRAME_UNKNOWN
    if vehicle.frame_contradicted:
        yield HealthFlag.FRAME_CONTRADICTED
    if vehicle.held_back_m > LARGEST_JUMP_M and now_s - vehicle.jump_time_s > ORIGIN_WITHIN_S:
        yield HealthFlag.POSITION_JUMPED
    if leaderless is not None:
        yield leaderless
    if vehicle.position_time_s > float("-inf") and not envelope.inside_fence(vehicle.position_enu_m):
        yield HealthFlag.FENCE
