"""Where two outputs of a tick differ, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import Enum
from typing import Any, NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from companion.types.status import Status
from companion.types.tick import Outbox

LONGEST = 100  # characters of a value that is shown
MISSING = "none"


class Difference(NamedTuple):
    """`field` is the path, like attitude_target.roll_rad; the values are as text, with all digits."""

    field: str
    recorded: str
    computed: str


def first_difference(recorded: Outbox, computed: Outbox) -> Difference | None:
    """In the order of an Outbox; None if they are equal.

    Of the rejected messages a recording has more: those refused before they came to the agent are not part of its input.
    """
    if recorded.status and computed.status and _no_more(computed.status, recorded.status):
        computed = replace(computed, status=replace(computed.status, rejected=recorded.status.rejected))
    return next(_differences("", recorded, computed), None)


def _no_more(computed: Status, recorded: Status) -> bool:
    return all(count <= recorded.rejected.get(key, 0) for key, count in computed.rejected.items())


def _differences(field: str, recorded: Any, computed: Any) -> Iterator[Difference]:
    if isinstance(recorded, Struct) and type(recorded) is type(computed):
        for name in recorded.__struct_fields__:
            inner = f"{field}.{name}".lstrip(".")
            yield from _differences(inner, getattr(recorded, name), getattr(computed, name))
    elif isinstance(recorded, tuple | list) and isinstance(computed, tuple | list) and len(recorded) == len(computed):
        for index, (one, other) in enumerate(zip(recorded, computed, strict=True)):
            yield from _differences(f"{field}[{index}]", one, other)
    elif isinstance(recorded, Mapping) and isinstance(computed, Mapping):
        for key in sorted(recorded.keys() | computed.keys()):
            yield from _differences(f"{field}.{key}", recorded.get(key), computed.get(key))
    elif repr(recorded) != repr(computed):  # of floats: the shortest digits that give the same bits
        yield Difference(field, _shown(recorded), _shown(computed))


def _shown(value: Any) -> str:
    if value is None:
        return MISSING
    text = repr(value.value if isinstance(value, Enum) else value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
