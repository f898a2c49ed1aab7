"""One link of the stand-in ArduCopter: HEARTBEAT and texts only, until other messages are requested."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from companion.mavlink.codec import EPOCH_UNIX_S, UNITS_PER_S, MavlinkCodec, MavlinkMessage, SigningKey, mavlink
from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.commands import ArduPilotReceiver
from sitl.autopilots.ardupilot.messages import BUILDERS
from sitl.autopilots.autopilot import Autopilot
from sitl.links.link_end import LinkEnd
from sitl.links.schedule import Schedule

RATES_HZ = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0}


class ArduPilotLinkEnd(LinkEnd):
    """All links behave alike; `link_id` is that of signing."""

    def __init__(self, copter: ArduCopter, link_id: int) -> None:
        schedule = Schedule(RATES_HZ)
        super().__init__(copter, schedule, ArduPilotReceiver(copter, schedule), codec_of(copter, link_id))
        self._copter = copter
        self._link_id = link_id
        self._signing = copter.signing
        self._origin_sent = 0

    def _codec_now(self) -> MavlinkCodec:
        """With a key all packets are signed, and unsigned packets are dropped silently."""
        if self._copter.signing is not self._signing:
            self._signing = self._copter.signing
            self._codec = codec_of(self._copter, self._link_id)
        return self._codec

    def peer_connected(self) -> None:
        """No effect."""

    def _sends_texts(self) -> bool:
        return True

    def _changes(self) -> Iterator[MavlinkMessage]:
        """Origin and home once they are set."""
        if self._origin_sent != self._copter.origin_changes:
            self._origin_sent = self._copter.origin_changes
            yield from self._messages((mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, mavlink.MAVLINK_MSG_ID_HOME_POSITION))

    def _telemetry(self) -> Iterator[MavlinkMessage]:
        yield from self._messages(self.schedule.due(self._copter.time_s))

    def _messages(self, message_ids: Iterable[int]) -> Iterator[MavlinkMessage]:
        for message_id in message_ids:
            message = BUILDERS[message_id](self._copter)
            if message is not None:
                yield message


def codec_of(copter: ArduCopter, link_id: int) -> MavlinkCodec:
    """The codec of the present signing. Timestamps continue from that of SETUP_SIGNING."""
    signing = copter.signing
    if signing is None:
        return MavlinkCodec(copter.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)

    def unix_time_s() -> float:
        return EPOCH_UNIX_S + signing.stamp / UNITS_PER_S + copter.time_s - signing.set_s

    key = SigningKey(signing.key, link_id, unix_time_s)
    return MavlinkCodec(copter.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, key)


def tcp_link(copter: Autopilot) -> LinkEnd:
    return _link(copter, 0)


def onboard_link(copter: Autopilot) -> LinkEnd:
    return _link(copter, 1)


def ground_link(copter: Autopilot) -> LinkEnd:
    return _link(copter, 2)


def _link(copter: Autopilot, link_id: int) -> LinkEnd:
    assert isinstance(copter, ArduCopter)
    return ArduPilotLinkEnd(copter, link_id)
