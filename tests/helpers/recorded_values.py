"""Hypothesis strategies for everything that a tick can have: any floats, and what wire and types permit else."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, Union, get_args, get_origin

import msgspec
from hypothesis import strategies as st
from msgspec import Struct
from msgspec.structs import fields

from companion.types.autopilot import AutopilotRequest
from companion.types.tick import Inbox, Outbox

REQUESTS = get_args(AutopilotRequest)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=12) | st.sampled_from(
    ["null", '"not_finite":', "é\n"]
)
FLOATS = st.floats() | st.sampled_from([0.0, -0.0, 1.0, 0.1])


def inboxes() -> st.SearchStrategy[Inbox]:
    return _values(Inbox)


def outboxes() -> st.SearchStrategy[Outbox]:
    return _values(Outbox)


@cache
def _values(type_: Any) -> st.SearchStrategy[Any]:
    origin, parts = get_origin(type_), get_args(type_)
    if origin is Annotated:
        return _bounded(parts[0], parts[1])
    if origin is Union or type_.__class__.__name__ == "UnionType":
        return st.one_of(*map(_values, parts))
    if origin is list or (origin is tuple and parts[-1] is Ellipsis):
        items = st.sampled_from(REQUESTS) if parts[0] is type else _values(parts[0])
        made = st.lists(items, max_size=3)
        return made if origin is list else made.map(tuple)
    if origin is tuple:
        return st.tuples(*map(_values, parts))
    if origin is dict:
        return st.dictionaries(_values(parts[0]), _values(parts[1]), max_size=3)
    if isinstance(type_, type) and issubclass(type_, Struct):
        return st.builds(type_, *(_values(field.type) for field in fields(type_)))
    plain = {float: FLOATS, str: TEXTS, int: st.integers(-(2**63), 2**64 - 1)}
    return plain[type_] if type_ in plain else st.from_type(type_)


def _bounded(type_: Any, bounds: msgspec.Meta) -> st.SearchStrategy[Any]:
    if type_ is int:
        return st.integers(bounds.ge, bounds.le)
    return _values(type_)
