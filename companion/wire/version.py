"""The first byte of every message is the wire version; what follows is MessagePack.

A receiver can so tell another version from damage, whatever the rest of that version looks like.
"""

from __future__ import annotations

import msgspec

WIRE_VERSION = 5

# All that msgspec raises for bytes it cannot take: text that is not UTF-8 and deep nesting have errors of their own.
DECODE_ERRORS = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)


class WireError(Exception):
    """Bytes that are no message of ours. str() is a short reason that is counted and reported."""


def seal(payload: bytes) -> bytes:
    """Put the version byte before a payload."""
    return bytes((WIRE_VERSION,)) + payload


def unseal(data: bytes) -> memoryview:
    """The payload of a message of this version. Raises WireError."""
    if not data:
        raise WireError("empty message")
    if data[0] != WIRE_VERSION:
        raise WireError(f"wire version {data[0]}, expected {WIRE_VERSION}")
    return memoryview(data)[1:]
