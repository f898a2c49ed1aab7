"""What is sent after a stage of the tick has failed: level attitude, the autopilot's hold, and a last packet to the peers.

It uses only what was sent and received before. The results of the stages cannot be relied on any more.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, isfinite

from msgspec import Struct
from msgspec.structs import replace

from companion.types.autopilot import AttitudeTarget, AutopilotMode, AutopilotRequest, ModeSample, SetMode, Telemetry
from companion.types.flight import Flight, FlightPhase
from companion.types.peers import PeerPacket
from companion.types.values import ZERO3

REPEAT_REQUEST_S = 0.1
TELEMETRY_FRESH_S = 0.1  # without telemetry a pilot's change of mode would remain unseen
HAND_OVER_WITHIN_S = 0.5  # both autopilots take over within 50 ms of the request


class Response(Struct, frozen=True, gc=False):
    """What to send now. `ended`: the hand-over is complete, or the vehicle is not the agent's."""

    target: AttitudeTarget | None = None
    requests: tuple[AutopilotRequest, ...] = ()
    ended: bool = True


class FailureResponse:
    """Follows a stream of setpoints from outside, so that it can be ended when the stages cannot."""

    def __init__(self) -> None:
        self._mode: AutopilotMode | None = None
        self._telemetry_s = -inf
        self._flight = Flight()
        self._packet: PeerPacket | None = None
        self._level: AttitudeTarget | None = None
        self._failed_s: float | None = None
        self._requested_s = -inf

    def receive(self, telemetry: Iterable[Telemetry]) -> None:
        """The telemetry of a tick, before its stages."""
        for sample in telemetry:
            self._telemetry_s = sample.received_s
            if isinstance(sample, ModeSample):
                self._mode = sample.mode

    def sent(self, flight: Flight, target: AttitudeTarget | None, hover_thrust_norm: float) -> None:
        """What a tick has sent; `target` is None where there was no setpoint."""
        self._flight = flight
        if not flight.streams:
            self._level = None  # its heading is of an earlier stream
        elif target and 0.0 < hover_thrust_norm < 1.0 and isfinite(target.yaw_rad):
            self._level = AttitudeTarget(0.0, 0.0, target.yaw_rad, hover_thrust_norm)

    def publishes(self, packet: PeerPacket | None) -> None:
        """The peer packet of a tick, before it is published; None where peers must not use its position."""
        self._packet = packet

    def step(self, now_s: float) -> Response:
        """The response at this time. The first one goes out in the tick that fails, the others until the autopilot holds.

        A mode that the agent did not command is the pilot's: nothing is sent. Without a stream the autopilot flies itself: only
        a hold that is under way is requested again.
        """
        is_first = self._failed_s is None
        if self._failed_s is None:
            self._failed_s = now_s
        blind = now_s - self._telemetry_s > TELEMETRY_FRESH_S and not is_first
        flight = self._flight
        under_way = flight.streams or flight.phase is FlightPhase.RELEASE
        if not under_way or blind or now_s - self._failed_s > HAND_OVER_WITHIN_S:
            return Response()
        if self._mode is AutopilotMode.OFFBOARD:
            return Response(self._level, self._request(now_s), ended=False)
        if flight.phase is FlightPhase.ENGAGE and self._mode is AutopilotMode.HOLD:
            # The request to follow the setpoints may be under way.
            return Response(None, self._request(now_s), ended=False)
        return Response()

    def packet(self, now_s: float) -> PeerPacket | None:
        """The last peer packet for now: the vehicle is released and brakes. The age of its position has advanced."""
        last = self._packet
        if last is None:
            return None
        self._packet = replace(
            last,
            sequence=last.sequence + 1,
            phase=FlightPhase.RELEASE,
            acceleration_enu_m_s2=ZERO3,
            state_age_s=last.state_age_s + max(0.0, now_s - last.sent_s),
            sent_s=now_s,
            change=None,
            rft=None,
        )
        return self._packet

    def _request(self, now_s: float) -> tuple[AutopilotRequest, ...]:
        if now_s - self._requested_s < REPEAT_REQUEST_S:
            return ()
        self._requested_s = now_s
        return (SetMode(AutopilotMode.HOLD),)
