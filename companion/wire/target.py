"""TargetSample <-> bytes: a MessagePack map, so that a sender is easily written in any language."""

from __future__ import annotations

import msgspec

from companion.types.notices import Code
from companion.types.peers import TargetSample
from companion.wire.version import seal, unsealed

_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(TargetSample)


def encode_target(sample: TargetSample) -> bytes:
    """The message for a target sample."""
    return seal(_encoder.encode(sample))


def decode_target(data: bytes) -> TargetSample:
    """The target sample of a message. Checks only form and version; `Targets` checks the values. Raises WireError."""
    return unsealed(_decoder, data, Code.TARGET_MALFORMED, "target sample")
