"""mavsdk on the agent's own link: it is given the received bytes, and its packets are sent beside the others.

mavsdk serves what is not on the 50 Hz path: parameters and flight logs. It opens no port itself, so that the agent and the
doctor use the same endpoints and report the same errors.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from mavsdk import Configuration, Mavsdk
from mavsdk.logging import log_subscribe

from companion.mavlink.codec import mavlink


class MavsdkBridge:
    """mavsdk as onboard computer of the vehicle's system. It sends no ground station heartbeat."""

    def __init__(self, vehicle_id: int, send: Callable[[bytes], None]) -> None:
        """`send` is called in the running loop and by `close`, for packets of any mavsdk thread."""
        log_subscribe(lambda *_: True)  # keep mavsdk's log lines off the terminal
        self._send = send
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[bytes] = deque()
        self._mavsdk = Mavsdk(Configuration.create_manual(vehicle_id, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, False))
        self._mavsdk.add_any_connection("raw://")
        self._mavsdk.subscribe_raw_bytes_to_be_sent(self._send_soon)

    def receive(self, packets: Sequence[bytes]) -> None:
        """Pass received packets to mavsdk."""
        for packet in packets:
            self._mavsdk.pass_received_raw_bytes(packet)

    async def system(self, wait_s: float) -> Any | None:
        """mavsdk's handle of the autopilot, for its plugins; None where it finds none within this time."""
        return await asyncio.to_thread(self._mavsdk.first_autopilot, wait_s)

    def close(self) -> None:
        """End mavsdk, then send what it sent last: an autopilot whose transfer is not ended would go on with it."""
        self._mavsdk.destroy()
        self._send_waiting()

    def _send_soon(self, packet: bytes) -> None:
        """In a thread of mavsdk."""
        self._waiting.append(packet)
        self._loop.call_soon_threadsafe(self._send_waiting)

    def _send_waiting(self) -> None:
        while self._waiting:
            self._send(self._waiting.popleft())
