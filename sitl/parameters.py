"""Parameters by name, and what every autopilot tells of them; how numbers travel is each one's own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from math import isfinite

from companion.mavlink.codec import MavlinkMessage, mavlink

REAL32: int = mavlink.MAV_PARAM_TYPE_REAL32


class Parameters(ABC):
    """Values by name; the type of a parameter is that of its default."""

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
        """PARAM_SET with its type; False where it is not taken."""
        if name not in self.values:
            return False
        told = self._from_wire(name, value, kind)
        if told is None or not isfinite(told):
            return False
        self.set(name, told)
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
        """PARAM_VALUE of one; None where there is none of that name."""
        return self.message(name) if name in self.values else None

    def name_at(self, index: int) -> str | None:
        names = sorted(self.values)
        return names[index] if 0 <= index < len(names) else None

    @abstractmethod
    def _from_wire(self, name: str, value: float, kind: int) -> float | None:
        """The number that PARAM_SET's float field carries; None where it cannot be taken."""

    @abstractmethod
    def _to_wire(self, name: str) -> float:
        """What PARAM_VALUE's float field carries."""

    @abstractmethod
    def _kind(self, name: str) -> int:
        """MAV_PARAM_TYPE."""
