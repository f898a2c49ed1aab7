"""What the autopilot tells of the own vehicle, and what it is asked for so that it tells it."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from companion.core.preflight import Preflight
from companion.core.vehicle_state import VehicleTracker
from companion.types import AutopilotRequest, RequestOrigin, Telemetry, VehicleState

ORIGIN_REPEAT_S = 1.0
ORIGIN_REFRESH_S = 5.0  # PX4 tells a changed origin once, and that one datagram may be lost
ORIGIN_SOON_S = 0.1  # when the position jumped: a new origin may be why


class Senses:
    """One vehicle's. `tracker` has its state, `preflight` its fitness."""

    def __init__(self, tracker: VehicleTracker, preflight: Preflight) -> None:
        self.tracker = tracker
        self.preflight = preflight
        self._origin_asked_s = -inf

    def hear(self, now_s: float, telemetry: Sequence[Telemetry], is_heeded: bool) -> VehicleState:
        """Once a tick. `is_heeded`: a position that jumps is followed slowly, by this vehicle and by its peers."""
        if not is_heeded:
            self.tracker.take_as_told()
        vehicle = self.tracker.fold(telemetry)
        self.preflight.hear(now_s, telemetry, vehicle.autopilot)
        return vehicle

    def ask_origin(self, now_s: float, vehicle: VehicleState) -> tuple[AutopilotRequest, ...]:
        """Whenever it is time."""
        if vehicle.autopilot is None:
            return ()
        period_s = ORIGIN_REPEAT_S if vehicle.altitude_amsl_m is None else ORIGIN_REFRESH_S
        if now_s - vehicle.jump_time_s < ORIGIN_REPEAT_S:
            period_s = ORIGIN_SOON_S
        if now_s - self._origin_asked_s < period_s:
            return ()
        self._origin_asked_s = now_s
        return (RequestOrigin(),)
