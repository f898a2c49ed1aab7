"""One link of the stand-in with PX4's manners: it tells of its origin by itself, and its texts to ground stations alone."""

from __future__ import annotations

from collections.abc import Iterator

from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from sitl.autopilot import Autopilot
from sitl.link_end import LinkEnd
from sitl.px4 import Px4
from sitl.px4_commands import Px4Receiver
from sitl.px4_link import GROUND_RATES_HZ, HEARTBEAT_ONLY, ONBOARD_RATES_HZ, Px4Schedule
from sitl.px4_messages import BUILDERS

GROUND_STATION_FORGOTTEN_S = 5.0


class Px4LinkEnd(LinkEnd):
    """Where `heard_rates_hz` are given, it says no more than its first rates until somebody was heard."""

    def __init__(self, px4: Px4, rates_hz: dict[int, float], heard_rates_hz: dict[int, float]) -> None:
        schedule = Px4Schedule(px4, rates_hz)
        codec = MavlinkCodec(px4.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        super().__init__(px4, schedule, Px4Receiver(px4, schedule), codec)
        self._px4 = px4
        self._heard_rates_hz = heard_rates_hz
        self._speaks_fully = not heard_rates_hz
        self._origin_told: int | None = None

    def heard(self) -> None:
        self._speaks_fully = True
        if self._heard_rates_hz:
            self.schedule.reset(self._heard_rates_hz, self._px4.time_s)

    def _listens_to_texts(self) -> bool:
        """Only where a ground station's heartbeat comes from."""
        heard_s = self.receiver.ground_station_s
        return heard_s is not None and self._px4.time_s - heard_s < GROUND_STATION_FORGOTTEN_S

    def _news(self) -> Iterator[MavlinkMessage]:
        """The origin, once and on every change."""
        if self._speaks_fully and self._origin_told != self._px4.origin_changes:
            self._origin_told = self._px4.origin_changes
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
