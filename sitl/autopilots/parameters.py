"""Parameters by name and their messages. Each make encodes the numbers on the wire in its own way."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from math import isfinite

from companion.mavlink.codec import MavlinkMessage, mavlink

REAL32: int = mavlink.MAV_PARAM_TYPE_REAL32


class StandInParameters(ABC):
    """Values by name; the type of a parameter is that of its default value."""

    def __init__(self, defaults: Mapping[str, float | int], overrides: Mapping[str, float]) -> None:
        """Raises KeyError for a parameter that does not exist."""
        self.values: dict[str, float | int] = dict(defaults)
        for name, value in overrides.items():
            self.set(name, value)

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def set(self, name: str, value: float) -> None:
        self.values[name] = int(value) if isinstance(self.values[name], int) else float(value)

    def set_from_wire(self, name: str, value: float, kind: int) -> bool:
        """PARAM_SET with its type; returns whether the value was accepted."""
        if name not in self.values:
            return False
        number = self._from_wire(name, value, kind)
        if number is None or not isfinite(number):
            return False
        self.set(name, number)
        return True

    def messages(self) -> list[MavlinkMessage]:
        """PARAM_VALUE of all, in order."""
        return [self.message(name) for name in sorted(self.values)]

    def message(self, name: str) -> MavlinkMessage:
        names = sorted(self.values)
        return mavlink.MAVLink_param_value_message(
            name.encode(), self._to_wire(name), self._kind(name), len(names), names.index(name)
        )

    def read(self, name: str) -> MavlinkMessage | None:
        """PARAM_VALUE of one parameter; None for an unknown name."""
        return self.message(name) if name in self.values else None

    def name_at(self, index: int) -> str | None:
        names = sorted(self.values)
        return names[index] if 0 <= index < len(names) else None

    @abstractmethod
    def _from_wire(self, name: str, value: float, kind: int) -> float | None:
        """The number in the float field of PARAM_SET; None if it is not acceptable."""

    @abstractmethod
    def _to_wire(self, name: str) -> float:
        """The float field of PARAM_VALUE."""

    @abstractmethod
    def _kind(self, name: str) -> int:
        """MAV_PARAM_TYPE."""
