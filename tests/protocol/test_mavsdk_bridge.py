"""mavsdk on given bytes: what it sends last leaves before the link closes."""

from __future__ import annotations

import asyncio
import time

from mavsdk.plugins.log_files import LogFiles

from companion.link.bench import MavsdkBridge
from companion.mavlink.codec import MavlinkCodec, mavlink

HEARTBEAT = mavlink.MAVLink_heartbeat_message(
    mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, 0, 0, mavlink.MAV_STATE_STANDBY, 3
)


def test_what_mavsdk_sends_while_the_loop_is_busy_is_sent_before_the_end() -> None:
    sent: list[bytes] = []

    async def ask_and_end() -> bytes:
        bridge = MavsdkBridge(1, sent.append)
        bridge.receive([MavlinkCodec(1, 1).encode(HEARTBEAT)])
        system = await bridge.system(5.0)
        await asyncio.sleep(0.2)
        sent.clear()
        plugin = LogFiles(system)  # sends LOG_REQUEST_END from a thread of mavsdk
        time.sleep(0.5)  # the loop is busy
        assert not sent
        plugin.destroy()
        bridge.close()
        return b"".join(sent)  # what follows would find the link closed

    messages = MavlinkCodec(255, 190).decode(asyncio.run(ask_and_end()))
    assert "LOG_REQUEST_END" in [message.get_type() for message in messages]
