"""Numbers that JSON does not have: NaN and infinity. msgspec writes each as null.

A message with any of them begins with the key `not_finite`: what each null stands for, in the order of the message.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

import msgspec

KEY = "not_finite"
START = b'{"' + KEY.encode() + b'":'

_encoder = msgspec.json.Encoder()
_decoder = msgspec.json.Decoder()


def encode_exact(record: dict[str, Any]) -> bytes:
    """The record as JSON. Its values are plain, and none of them is None."""
    data = _encoder.encode(record)
    if b"null" in data and (numbers := _not_finite(record)):
        return _encoder.encode({KEY: [repr(number) for number in numbers], **record})
    return data


def has_not_finite(data: bytes) -> bool:
    """Whether `decode_exact` is needed."""
    return data.startswith(START)


def decode_exact(data: bytes) -> Any:
    """The plain content of a message with numbers that are not finite. Raises ValueError, as msgspec's errors are."""
    record = _decoder.decode(data)
    stand_for = record.pop(KEY)
    if not isinstance(stand_for, list) or any(number not in ("nan", "inf", "-inf") for number in stand_for):
        raise ValueError(f"{KEY}: expected a list of nan, inf and -inf")
    numbers = [float(number) for number in reversed(stand_for)]
    restored = _restored(record, numbers)
    if numbers:
        raise ValueError(f"{KEY}: more numbers than nulls")
    return restored


def _not_finite(value: Any) -> list[float]:
    if isinstance(value, float):
        return [] if isfinite(value) else [value]
    if isinstance(value, dict):
        value = value.values()
    elif not isinstance(value, list | tuple):
        return []
    return [number for item in value for number in _not_finite(item)]


def _restored(value: Any, numbers: list[float]) -> Any:
    """The value with the last of the numbers for its first null, and so on."""
    if value is None:
        if not numbers:
            raise ValueError(f"{KEY}: fewer numbers than nulls")
        return numbers.pop()
    if isinstance(value, dict):
        return {key: _restored(item, numbers) for key, item in value.items()}
    if isinstance(value, list):
        return [_restored(item, numbers) for item in value]
    return value
