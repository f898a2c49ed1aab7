"""TargetSample <-> bytes: a MessagePack map, so that a sender is easily written in any language."""

from __future__ import annotations

import msgspec

from companion.types.notices import Code
from companion.types.peers import TargetSample
from companion.wire.version import unsealed

_target_decoder = msgspec.msgpack.Decoder(TargetSample)


def decode_target(data: bytes) -> TargetSample:
    """The target sample of a message. Checks only form and version; `Targets` checks the values. Raises WireError."""
    return unsealed(_target_decoder, data, Code.TARGET_MALFORMED, "target sample")
