"""One entry of the table of explanations."""

from __future__ import annotations

from msgspec import Struct


class Explanation(Struct, frozen=True):
    """What an operator sees, why it happens, and what to do."""

    symptom: str
    cause: str
    remedy: str
