"""mavsdk on a link that is this program's own: it gets the bytes that come, and what it says goes out beside the rest.

mavsdk serves what is not on the 50 Hz path: parameters and flight logs. It never opens a port itself, so that one description
of the endpoint, and one set of words for what is wrong with it, serve agent and doctor alike.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

from mavsdk import Configuration, Mavsdk
from mavsdk.logging import log_subscribe

from companion.mavlink.codec import mavlink


class MavsdkBridge:
    """Speaks as the onboard computer of the vehicle's own system; it sends no ground station's heartbeat."""

    def __init__(self, vehicle_id: int, send: Callable[[bytes], None]) -> None:
        """`send` is called in the running loop, whichever of mavsdk's threads has something to say."""
        log_subscribe(lambda *_: True)  # its own words on the terminal would stand between ours
        loop = asyncio.get_running_loop()
        self._mavsdk = Mavsdk(Configuration.create_manual(vehicle_id, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, False))
        self._mavsdk.add_any_connection("raw://")
        self._mavsdk.subscribe_raw_bytes_to_be_sent(lambda data: loop.call_soon_threadsafe(send, data))

    def receive(self, packets: Sequence[bytes]) -> None:
        """What came on the link."""
        for packet in packets:
            self._mavsdk.pass_received_raw_bytes(packet)

    async def system(self, wait_s: float) -> Any | None:
        """mavsdk's own handle of the autopilot, for its plugins; None where it hears none in this time."""
        return await asyncio.to_thread(self._mavsdk.first_autopilot, wait_s)

    def close(self) -> None:
        self._mavsdk.destroy()
