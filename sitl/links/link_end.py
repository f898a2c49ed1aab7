"""A stand-in's end of one MAVLink link: bytes in, bytes out. No sockets, no clocks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from itertools import chain

from companion.mavlink.codec import MavlinkCodec, MavlinkMessage
from sitl.autopilots.autopilot import Autopilot
from sitl.links.receiver import Receiver
from sitl.links.schedule import Schedule


class LinkEnd(ABC):
    """One link. Messages are due by the autopilot's clock."""

    def __init__(self, autopilot: Autopilot, schedule: Schedule, receiver: Receiver, codec: MavlinkCodec) -> None:
        self._autopilot = autopilot
        self._codec = codec
        self.schedule = schedule
        self.receiver = receiver

    @property
    def system_id(self) -> int:
        """Of the autopilot."""
        return self._autopilot.system_id

    def receive(self, data: bytes) -> Iterator[bytes]:
        """Answers to received bytes."""
        for message in self._codec_now().decode(data):
            yield from self._encoded(self.receiver.receive(message))

    def due(self) -> Iterator[bytes]:
        """All packets that are due now."""
        yield from self.texts()
        yield from self._encoded(chain(self._changes(), self._telemetry(), self.receiver.logs.due()))

    def texts(self) -> Iterator[bytes]:
        """STATUSTEXT of the autopilot's texts, if this link sends them."""
        if self._autopilot.texts and self._sends_texts():
            yield from self._encoded(self.receiver.texts(self._autopilot.texts))

    def changes(self) -> Iterator[bytes]:
        """Messages that are sent on change, independently of the rates."""
        yield from self._encoded(self._changes())

    @abstractmethod
    def peer_connected(self) -> None:
        """The first packet of a peer has come."""

    @abstractmethod
    def _sends_texts(self) -> bool: ...

    @abstractmethod
    def _changes(self) -> Iterator[MavlinkMessage]: ...

    @abstractmethod
    def _telemetry(self) -> Iterator[MavlinkMessage]:
        """Messages that are due by the schedule."""

    def _codec_now(self) -> MavlinkCodec:
        """The codec of the present signing."""
        return self._codec

    def _encoded(self, messages: Iterable[MavlinkMessage]) -> Iterator[bytes]:
        for message in messages:
            yield self._codec_now().encode(message)
