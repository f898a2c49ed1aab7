"""Expensive work in steps: a generator that pauses after each small part of it and returns the result."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

Result = TypeVar("Result")
Steps = Generator[None, None, Result]


def whole(steps: Steps[Result]) -> Result:
    """The result of all steps at once."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: Result = end.value
            return result


def first_steps(steps: Steps[Result], most: int) -> Result:
    """The result of at most so many steps. Raises ValueError where it takes more."""
    for _ in range(most):
        try:
            next(steps)
        except StopIteration as end:
            result: Result = end.value
            return result
    raise ValueError("the check takes too long to be done at once")


def coarser(steps: Steps[Result], times: int) -> Steps[Result]:
    """The same work in steps of so many each."""
    done = 0
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: Result = end.value
            return result
        done += 1
        if done == times:
            done = 0
            yield
