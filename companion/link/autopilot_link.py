"""The autopilot as the agent meets it: telemetry in, setpoints and requests out, and the manners that keep both going."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable
from typing import NoReturn

from companion.link.mavlink_link import open_link
from companion.mavlink import px4
from companion.mavlink.translator import Translator
from companion.types import AttitudeTarget, AutopilotRequest, HeartbeatSample, PositionSample, Telemetry

HEARTBEAT_PERIOD_S = 1.0
STREAM_CHECK_PERIOD_S = 2.0
ENOUGH_POSITIONS_HZ = 40.0

_log = logging.getLogger(__name__)


class AutopilotLink:
    """Decodes telemetry as it arrives and keeps it for the next tick. `position_arrived` is called for every position."""

    def __init__(
        self, vehicle_id: int, endpoint: str, translator: Translator, position_arrived: Callable[[], None]
    ) -> None:
        """Opens the endpoint. Raises LinkError."""
        self._vehicle_id = vehicle_id
        self._translator = translator
        self._position_arrived = position_arrived
        self._telemetry: list[Telemetry] = []
        self._positions = 0
        self._heard = asyncio.Event()
        self._link = open_link(endpoint, self._bytes_arrived)

    @property
    def heard(self) -> bool:
        """Has its HEARTBEAT ever come?"""
        return self._heard.is_set()

    def drain(self) -> tuple[Telemetry, ...]:
        """All that came since the last call."""
        telemetry = tuple(self._telemetry)
        self._telemetry.clear()
        return telemetry

    def command(self, target: AttitudeTarget, now_s: float) -> None:
        """Send a setpoint, once."""
        self._link.send(self._translator.attitude_target(target, now_s))

    def request(self, requests: Iterable[AutopilotRequest]) -> None:
        for request in requests:
            self._link.send(self._translator.request(request))

    async def receive(self) -> None:
        """Until cancelled."""
        await self._link.run()

    async def keep_in_touch(self) -> NoReturn:
        """The companion's own heartbeat, from the autopilot's first on."""
        await self._heard.wait()
        _log.info("heartbeat of autopilot %d", self._vehicle_id)
        while True:
            self._link.send(self._translator.heartbeat())
            await asyncio.sleep(HEARTBEAT_PERIOD_S)

    async def keep_streams(self) -> NoReturn:
        """Ask for the telemetry rates when the autopilot is there, and again while too few positions come."""
        await self._heard.wait()
        is_enough = True
        while True:
            for request in self._translator.stream_requests():
                self._link.send(request)
            while True:
                self._positions = 0
                await asyncio.sleep(STREAM_CHECK_PERIOD_S)
                rate_hz = self._positions / STREAM_CHECK_PERIOD_S
                was_enough, is_enough = is_enough, rate_hz >= ENOUGH_POSITIONS_HZ
                if is_enough is not was_enough:
                    _log.info("positions come at %.0f Hz%s", rate_hz, "" if is_enough else ", asking for 50 Hz again")
                if not is_enough:
                    break

    def why_silent(self) -> str:
        """Why no HEARTBEAT was heard, and what to do about it."""
        others = sorted(self._translator.other_systems)
        if self._translator.unsupported_autopilot is not None:
            other = self._translator.unsupported_autopilot
            return f"its HEARTBEAT says MAV_AUTOPILOT {other}, expected {px4.MAV_AUTOPILOT} ({px4.NAME})"
        if others:
            heard = ", ".join(str(system_id) for system_id in others)
            return f"heard system {heard} instead; correct the id here or the autopilot's (MAV_SYS_ID)"
        return self._link.problem()

    def close(self) -> None:
        self._link.close()

    def _bytes_arrived(self, data: bytes, received_s: float) -> bool:
        samples = self._translator.telemetry(data, received_s)
        self._telemetry += samples
        for sample in samples:
            if isinstance(sample, PositionSample):
                self._positions += 1
                self._position_arrived()
            elif isinstance(sample, HeartbeatSample):
                self._heard.set()
        return bool(samples)
