"""The autopilot as the agent meets it: telemetry in, setpoints and requests out, and the manners that keep both going."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NoReturn

from companion.config.vehicle import VehicleConfig
from companion.link.mavlink_link import open_link
from companion.mavlink.signing import NOT_SIGNED, OLD_STAMP, WRONG_KEY
from companion.mavlink.translator import Translator
from companion.types import (
    AttitudeTarget,
    AutopilotRequest,
    HeartbeatSample,
    ModeSample,
    PositionSample,
    Telemetry,
)

HEARTBEAT_PERIOD_S = 1.0
STREAM_CHECK_PERIOD_S = 2.0

SIGNATURE_ADVICE = {
    NOT_SIGNED: "its packets are not signed; give it the key (in MAVProxy: signing setup), or take signing out of the"
    " vehicle file: PX4 1.16 cannot sign",
    WRONG_KEY: "its packets are signed with another key; give both the same one",
    OLD_STAMP: "its signatures are older than this computer's clock; set the right time here, or wait for its GPS",
}

_log = logging.getLogger(__name__)


class AutopilotSilentError(Exception):
    """The autopilot never answered. str() is one line: file, field, endpoint, what was expected, what to do."""

    def __init__(self, file: Path, vehicle: VehicleConfig, waited_s: float, why: str) -> None:
        super().__init__(
            f'{file}: mavlink: "{vehicle.mavlink}": no HEARTBEAT of system {vehicle.id} in {waited_s:g} s; {why}'
        )


class AutopilotLink:
    """Decodes telemetry as it arrives and keeps it for the next tick. `position_arrived` is called for every position.

    `reject` is called with the reason for everything that came damaged or without sense.
    """

    def __init__(
        self,
        vehicle_id: int,
        endpoint: str,
        translator: Translator,
        position_arrived: Callable[[], None],
        reject: Callable[[str], None],
    ) -> None:
        """Opens the endpoint. Raises LinkError."""
        self._vehicle_id = vehicle_id
        self._translator = translator
        self._position_arrived = position_arrived
        self._reject = reject
        self._telemetry: list[Telemetry] = []
        self._came: Counter[type[Telemetry]] = Counter()  # since the last check of the streams
        self._heard = asyncio.Event()
        self._there = (
            asyncio.Event()
        )  # heard, or rightly signed with an old stamp: it has yet to learn the time from us
        self._pass_on: Callable[[Sequence[bytes]], None] | None = None
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

    def pass_on_to(self, listener: Callable[[Sequence[bytes]], None]) -> None:
        """Give the packets that come, as they came, to one more listener."""
        self._pass_on = listener

    def offer(self, packet: bytes) -> bool:
        """A packet of somebody else; it goes out only where it delays nothing. False: not now."""
        return self._link.offer(packet)

    def relay(self, data: bytes) -> None:
        """What another program of this vehicle's computer says, as this agent's own."""
        for packet in self._translator.relayed(data):
            self._link.send(packet)

    async def receive(self) -> None:
        """Until cancelled."""
        await self._link.run()

    async def keep_in_touch(self) -> NoReturn:
        """The companion's own heartbeat, from the autopilot's first on."""
        await self._there.wait()
        while True:
            self._link.send(self._translator.heartbeat())
            await asyncio.sleep(HEARTBEAT_PERIOD_S)

    async def keep_streams(self) -> NoReturn:
        """Ask for the telemetry rates when the autopilot is there, and again while too little of one comes.

        A request may be lost like any packet, each by itself: so every stream is watched.
        """
        await self._heard.wait()
        _log.info("heartbeat of autopilot %d, %s", self._vehicle_id, self._translator.manners.NAME)
        if self._translator.signs_alone:
            _log.warning("the autopilot signs its packets and may ignore this agent's: set signing in the vehicle file")
        slow_before: list[str] = []
        while True:
            for request in self._translator.stream_requests():
                self._link.send(request)
            while True:
                self._came.clear()
                await asyncio.sleep(STREAM_CHECK_PERIOD_S)
                slow = self._slow_streams()
                if slow != slow_before:
                    _log.info("%s", f"too few {', '.join(slow)}: asking again" if slow else "all telemetry comes")
                slow_before = slow
                if slow:
                    break

    def _slow_streams(self) -> list[str]:
        """What came too seldom since the last check."""
        self._came[ModeSample] -= self._came[HeartbeatSample]  # every HEARTBEAT brings a mode, too, asked or not
        least_hz = self._translator.manners.LEAST_HZ
        return [name for kind, (name, rate) in least_hz.items() if self._came[kind] < rate * STREAM_CHECK_PERIOD_S]

    def why_silent(self) -> str:
        """Why no HEARTBEAT was heard, and what to do about it."""
        if self._translator.refused_signature is not None:
            return SIGNATURE_ADVICE[self._translator.refused_signature]
        others = sorted(self._translator.other_systems)
        if self._translator.refused_heartbeat:
            return self._translator.refused_heartbeat
        if others:
            heard = ", ".join(str(system_id) for system_id in others)
            return f"heard system {heard} instead; correct the id here or the autopilot's (MAV_SYS_ID)"
        return self._link.problem()

    def close(self) -> None:
        self._link.close()

    def _bytes_arrived(self, data: bytes, received_s: float) -> bool:
        samples = self._translator.telemetry(data, received_s)
        self._telemetry += samples
        is_autopilots = bool(samples) or OLD_STAMP in self._translator.rejected
        if is_autopilots:
            self._there.set()
        if self._translator.rejected:
            for reason in self._translator.rejected.elements():
                self._reject(reason)
            self._translator.rejected.clear()
        for sample in samples:
            self._came[type(sample)] += 1
            if isinstance(sample, PositionSample):
                self._position_arrived()
            elif isinstance(sample, HeartbeatSample):
                self._heard.set()
        if self._pass_on and self.heard:
            self._pass_on(self._translator.packets)
        return is_autopilots
