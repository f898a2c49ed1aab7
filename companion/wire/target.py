"""TargetSample <-> bytes: a MessagePack map, for whoever likes to write a sender of one in any language."""

from __future__ import annotations

import msgspec

from companion.types import TargetSample
from companion.wire.version import DECODE_ERRORS, WireError, seal, unseal

_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(TargetSample)


def encode_target(sample: TargetSample) -> bytes:
    return seal(_encoder.encode(sample))


def decode_target(data: bytes) -> TargetSample:
    """Checks form and version only; what the numbers may be is `core/targets.py`'s. Raises WireError."""
    try:
        return _decoder.decode(unseal(data))
    except DECODE_ERRORS as error:
        raise WireError("malformed target") from error
