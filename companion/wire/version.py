"""Wire version: the first byte of every message. MessagePack follows.

So a receiver can distinguish another version from a damaged message, whatever the format of that version.
"""

from __future__ import annotations

import re
from typing import TypeVar

import msgspec

from companion.types.notices import Code
from companion.types.rejections import rejection_key

WIRE_VERSION = 8

T = TypeVar("T")

# All that msgspec raises for malformed bytes: invalid UTF-8 and deep nesting have their own errors.
DECODE_ERRORS = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)
_PLACE = re.compile(r" - at `(\$[\w.\[\]]{1,60})`$")


class WireError(Exception):
    """A message that cannot be decoded. `str()` is the reason; `key` is the counter of such rejections."""

    def __init__(self, code: Code, text: str, detail: int | None = None) -> None:
        super().__init__(text)
        self.code = code
        self.key = rejection_key(code, detail)


def seal(payload: bytes) -> bytes:
    """The payload with the version byte before it."""
    return bytes((WIRE_VERSION,)) + payload


def unseal(data: bytes) -> memoryview:
    """The payload of a message of this version. Raises WireError."""
    if not data:
        raise WireError(Code.MESSAGE_EMPTY, "empty message")
    if data[0] != WIRE_VERSION:
        raise WireError(Code.WIRE_VERSION_DIFFERS, f"wire version {data[0]}, expected {WIRE_VERSION}", data[0])
    return memoryview(data)[1:]


def unsealed(decoder: msgspec.msgpack.Decoder[T], data: bytes, code: Code, what: str) -> T:
    """The decoded message, with all values within the bounds of their types.

    Raises WireError of this code. It names the place of the wrong value, never the value: that may be any text.
    """
    try:
        return decoder.decode(unseal(data))
    except DECODE_ERRORS as error:
        place = _PLACE.search(str(error))
        raise WireError(code, f"malformed {what}" + (f" at {place[1]}" if place else "")) from error
