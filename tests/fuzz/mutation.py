"""Seeded changes to values and bytes: edges of number formats, values a little off, and damaged structure."""

from __future__ import annotations

from enum import Enum
from math import inf, nan
from random import Random
from typing import Any, TypeVar

from msgspec import Struct
from msgspec.structs import replace

S = TypeVar("S", bound=Struct)

FLOATS = (
    0.0, -0.0, 5e-324, 1e-300, 1e-200, 1e-9, 1e-3, 0.5, -0.5, 1.0, -1.0, 5.0, 9.8, -9.8, 25.0, 60.0, 100.0, -100.0, 600.0,
    1000.0, 1e4, 2e4, -2e4, 1e6, 1e9, 1e15, 1e200, 1e300, -1e300, inf, -inf, nan,
)  # fmt: skip
INTS = (
    0,
    1,
    2,
    3,
    4,
    8,
    100,
    250,
    999,
    1000,
    1001,
    10**6,
    10**13,
    2**31 - 1,
    2**31,
    2**32,
    2**62,
    2**63 - 1,
    2**64 - 1,
    -1,
)
CHANGES = (1, 1, 2, 4)  # of bytes
TEXTS = ("", "main", "point", "circle", "\x1b[2J", "\u202e", "a" * 79, "x" * 5000, "../..", "nan")


def mutated(rng: Random, value: S, changes: int) -> S:
    """The struct with this many of its fields changed, each by `other`."""
    chosen = [rng.choice(value.__struct_fields__) for _ in range(changes)]
    return replace(value, **{name: other(rng, getattr(value, name)) for name in chosen})


def other(rng: Random, value: Any) -> Any:
    """Another value in place of this one, mostly of the same type."""
    match value:
        case bool():
            return not value
        case Enum():
            return rng.choice(list(type(value)))
        case float():
            return other_float(rng, value)
        case int():
            return other_int(rng, value)
        case str():
            return rng.choice(TEXTS)
        case Struct():
            return mutated(rng, value, rng.choice((1, 1, 2, 3)))
        case tuple() | list() if value:
            return _other_sequence(rng, value)
        case dict() if value:
            key = rng.choice(list(value))
            return {**value, key: other(rng, value[key])}
    return value


def other_float(rng: Random, value: float) -> float:
    """A value near this one, or an edge of the format."""
    kind = rng.random()
    if kind < 0.3:
        return value + rng.gauss(0.0, 0.3)
    if kind < 0.45:
        return value + rng.gauss(0.0, 10.0)
    if kind < 0.55:
        return value * rng.uniform(-3.0, 3.0)
    return rng.choice(FLOATS)


def other_int(rng: Random, value: int) -> int:
    """A value near this one, or an edge of the format."""
    if rng.random() < 0.5:
        return max(-(2**63), min(2**64 - 1, value + rng.choice((-1, 1, 2, 7, 50, 999, 1000, 1001, 10**6, 10**13))))
    return rng.choice(INTS)


def _other_sequence(rng: Random, value: Any) -> Any:
    items, at = list(value), rng.randrange(len(value))
    kind = rng.random()
    if kind < 0.7:
        items[at] = other(rng, items[at])
    elif kind < 0.8:
        del items[at]
    elif kind < 0.9:
        items.append(items[at])
    else:
        items = items * rng.choice((2, 30)) if len(items) < 20 else items[:1]
    return type(value)(items)


def damaged(rng: Random, data: bytes) -> bytes:
    """The bytes with one to four changes: a byte, a bit, a cut, bytes inserted, removed or repeated."""
    random, out = rng.random, bytearray(data)  # `int(n * random())` costs a quarter of `randrange(n)`
    for _ in range(CHANGES[int(len(CHANGES) * random())]):
        if not out:
            return bytes((rng.getrandbits(8),))
        at, kind = int(len(out) * random()), int(8 * random())
        if kind < 3:
            out[at] = int(256 * random())
        elif kind == 3:
            out[at] ^= 1 << int(8 * random())
        elif kind == 4:
            del out[at:]
        elif kind == 5:
            out[at:at] = rng.randbytes((1, 2, 8)[int(3 * random())])
        elif kind == 6:
            del out[at : at + (1, 1, 4, 9)[int(4 * random())]]
        else:
            out[at:at] = out[at : at + 16]
    return bytes(out)
