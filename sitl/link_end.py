"""The stand-in's end of one MAVLink link: bytes come in, bytes go out. No sockets, no clocks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator

from companion.mavlink.codec import MavlinkCodec, MavlinkMessage
from sitl.autopilot import Autopilot
from sitl.receiver import Receiver
from sitl.schedule import Schedule


class LinkEnd(ABC):
    """One link. What is due goes by the autopilot's own clock."""

    def __init__(self, autopilot: Autopilot, schedule: Schedule, receiver: Receiver, codec: MavlinkCodec) -> None:
        self._autopilot = autopilot
        self._codec = codec
        self.schedule = schedule
        self.receiver = receiver

    def receive(self, data: bytes) -> Iterator[bytes]:
        """The answers to what came."""
        for message in self._codec_now().decode(data):
            yield from self._encoded(self.receiver.receive(message))

    def due(self) -> Iterator[bytes]:
        """All that is to be said now."""
        yield from self.texts()
        yield from self.news()
        yield from self._encoded(self._telemetry())
        yield from self._encoded(self.receiver.logs.due())

    def texts(self) -> Iterator[bytes]:
        """The autopilot's texts, where this link listens to them."""
        if self._autopilot.texts and self._listens_to_texts():
            yield from self._encoded(self.receiver.texts(self._autopilot.texts))

    def news(self) -> Iterator[bytes]:
        """What is said when it happens, whatever the rates."""
        yield from self._encoded(self._news())

    @abstractmethod
    def heard(self) -> None:
        """Somebody has sent something here for the first time."""

    @abstractmethod
    def _listens_to_texts(self) -> bool: ...

    @abstractmethod
    def _news(self) -> Iterator[MavlinkMessage]: ...

    @abstractmethod
    def _telemetry(self) -> Iterator[MavlinkMessage]:
        """What the schedule says is due."""

    def _codec_now(self) -> MavlinkCodec:
        """A link whose signing changes has others."""
        return self._codec

    def _encoded(self, messages: Iterable[MavlinkMessage]) -> Iterator[bytes]:
        for message in messages:
            yield self._codec_now().encode(message)
