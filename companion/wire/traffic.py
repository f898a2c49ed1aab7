"""TrafficSample <-> bytes: a MessagePack map, so that a receiver of ADS-B is easily connected in any language."""

from __future__ import annotations

import msgspec

from companion.types.notices import Code
from companion.types.peers import TrafficSample
from companion.wire.version import unsealed

_traffic_decoder = msgspec.msgpack.Decoder(TrafficSample)


def decode_traffic(data: bytes) -> TrafficSample:
    """The traffic sample of a message, every number within its bounds. Raises WireError."""
    return unsealed(_traffic_decoder, data, Code.TRAFFIC_MALFORMED, "traffic sample")
