"""Perception: telemetry -> the vehicle's state and fitness, and requests for what telemetry does not bring by itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf

from msgspec import Struct

from companion.core.estimation.vehicle_state import VehicleTracker
from companion.core.safety.preflight import Fitness, Preflight
from companion.types.autopilot import VehicleState
from companion.types.flight import COOPERATING, Flight
from companion.types.notices import Notice
from companion.types.requests import AutopilotRequest, RequestOrigin
from companion.types.telemetry import Telemetry

ORIGIN_REPEAT_S = 1.0
ORIGIN_REFRESH_S = 5.0  # PX4 sends a changed origin once, and that one datagram may be lost
ORIGIN_SOON_S = 0.1  # when the position jumped: a new origin may be why


class Perception(Struct, frozen=True, gc=False):
    """The own vehicle in this tick. `rejected` counts samples by reason."""

    vehicle: VehicleState
    fitness: Fitness
    rejected: Mapping[str, int]
    requests: tuple[AutopilotRequest, ...] = ()
    events: tuple[Notice, ...] = ()


class PerceptionStage:
    """Tracks the vehicle's state and its preflight checks."""

    def __init__(self, tracker: VehicleTracker, preflight: Preflight) -> None:
        self._tracker = tracker
        self._preflight = preflight
        self._origin_asked_s = -inf

    def step(self, now_s: float, telemetry: Sequence[Telemetry], before: Flight) -> Perception:
        """`before` is the flight of the last tick: only while it cooperates does a position that jumps follow slowly."""
        tracker, preflight = self._tracker, self._preflight
        if before.phase not in COOPERATING:
            tracker.accept_next_position()
        vehicle, resets = tracker.fold(telemetry)
        findings = preflight.update(now_s, telemetry, vehicle.autopilot)
        requests = self._origin_requests(now_s, vehicle)
        return Perception(vehicle, preflight.fitness, tracker.rejected, requests, findings + resets)

    def parameter_requests(self, now_s: float, flight: Flight) -> tuple[AutopilotRequest, ...]:
        """The parameters to read next. None while setpoints stream: those read before count for the whole formation."""
        return () if flight.streams else self._preflight.ask(now_s)

    def _origin_requests(self, now_s: float, vehicle: VehicleState) -> tuple[AutopilotRequest, ...]:
        if vehicle.autopilot is None:
            return ()
        period_s = ORIGIN_REPEAT_S if vehicle.altitude_amsl_m is None else ORIGIN_REFRESH_S
        if now_s - vehicle.jump_time_s < ORIGIN_REPEAT_S:
            period_s = ORIGIN_SOON_S
        if now_s - self._origin_asked_s < period_s:
            return ()
        self._origin_asked_s = now_s
        return (RequestOrigin(),)
