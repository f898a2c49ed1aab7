"""Rejected input: counted by code, with one text for each code."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from companion.types.generated.codes import TEXTS, Code

MAX_DETAILED = 100  # keys of a counter from which on details are left out: a stranger could cause a new one each time


def rejection_key(code: Code, detail: int | None = None) -> str:
    """Key of a counter: the code, followed by a peer id or a foreign wire version where there is one."""
    return code.value if detail is None else f"{code.value} {detail}"


def rejection_text(key: str) -> str:
    """The text for a counter's key; "" for a code of another release."""
    return TEXTS.get(key.partition(" ")[0], "")


def sum_counts(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    """The sums of several counts by key."""
    total: dict[str, int] = {}
    for count in counts:
        for key, number in count.items():
            total[key] = total.get(key, 0) + number
    return total


def count_rejection(rejected: Counter[str], key: str) -> Counter[str]:
    """A new count with one more of `key`. The old one may be part of a result already, so it is not modified."""
    if key not in rejected and len(rejected) >= MAX_DETAILED:
        key = key.partition(" ")[0]  # without the detail
    return Counter({**rejected, key: rejected[key] + 1})
