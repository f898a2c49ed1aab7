"""One link of the stand-in PX4: it sends the origin on change, and texts to ground stations only."""

from __future__ import annotations

from collections.abc import Iterator

from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from sitl.autopilots.autopilot import Autopilot
from sitl.autopilots.px4.autopilot import Px4
from sitl.autopilots.px4.commands import Px4Receiver
from sitl.autopilots.px4.link import GROUND_RATES_HZ, HEARTBEAT_ONLY, ONBOARD_RATES_HZ, Px4Schedule
from sitl.autopilots.px4.messages import BUILDERS
from sitl.links.link_end import LinkEnd

GROUND_STATION_LOST_S = 5.0


class Px4LinkEnd(LinkEnd):
    """With `connected_rates_hz` it sends at its first rates only until the peer has connected."""

    def __init__(self, px4: Px4, rates_hz: dict[int, float], connected_rates_hz: dict[int, float]) -> None:
        schedule = Px4Schedule(px4, rates_hz)
        codec = MavlinkCodec(px4.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        super().__init__(px4, schedule, Px4Receiver(px4, schedule), codec)
        self._px4 = px4
        self._connected_rates_hz = connected_rates_hz
        self._sends_all = not connected_rates_hz
        self._origin_sent: int | None = None

    def peer_connected(self) -> None:
        self._sends_all = True
        if self._connected_rates_hz:
            self.schedule.reset(self._connected_rates_hz, self._px4.time_s)

    def _sends_texts(self) -> bool:
        """Only on a link with heartbeats of a ground station."""
        heartbeat_s = self.receiver.ground_station_s
        return heartbeat_s is not None and self._px4.time_s - heartbeat_s < GROUND_STATION_LOST_S

    def _changes(self) -> Iterator[MavlinkMessage]:
        """The origin, once and on every change."""
        if self._sends_all and self._origin_sent != self._px4.origin_changes:
            self._origin_sent = self._px4.origin_changes
            yield BUILDERS[mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN](self._px4)

    def _telemetry(self) -> Iterator[MavlinkMessage]:
        for message_id in self.schedule.due(self._px4.time_s):
            yield BUILDERS[message_id](self._px4)


def onboard_link(px4: Autopilot) -> LinkEnd:
    assert isinstance(px4, Px4)
    return Px4LinkEnd(px4, ONBOARD_RATES_HZ, {})


def ground_link(px4: Autopilot) -> LinkEnd:
    assert isinstance(px4, Px4)
    return Px4LinkEnd(px4, HEARTBEAT_ONLY, GROUND_RATES_HZ)
