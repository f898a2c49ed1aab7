"""Python's collector of cycles, told to look seldom while something flies in virtual time."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

OBJECTS = 50_000  # made and not yet gone, before the collector looks; Python's own 700 cost an eighth of a flight


@contextmanager
def looking_seldom() -> Iterator[None]:
    """What flies makes hundreds of values a tick, none of which is part of a cycle."""
    before = gc.get_threshold()
    gc.set_threshold(OBJECTS, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)
