"""Landing detection, and the time an armed vehicle has been on the ground. Shared by all makes."""

from __future__ import annotations

from enum import Enum, auto

LANDED_AFTER_S = 0.5  # on the ground with little thrust


class Contact(Enum):
    """A change of the contact with the ground."""

    TOOK_OFF = auto()
    LANDED = auto()


class GroundContact:
    """Contact of one armed vehicle with the ground. Times are of the autopilot's clock."""

    def __init__(self) -> None:
        self.landed = True
        self.flown = False  # since it was armed
        self._armed_s = 0.0
        self._landed_s = 0.0
        self._still_since_s: float | None = None

    @property
    def flies(self) -> bool:
        """Whether it was off the ground in the last step."""
        return not self.landed and self._still_since_s is None

    def arm(self, now_s: float) -> None:
        self._armed_s = now_s
        self.flown = False

    def update(self, on_ground: bool, low_thrust: bool, now_s: float) -> Contact | None:
        """To be called once per step while armed."""
        if not on_ground:
            took_off = self.landed
            self.flown, self.landed, self._still_since_s = True, False, None
            return Contact.TOOK_OFF if took_off else None
        if self.landed:
            return None
        if not low_thrust:
            self._still_since_s = None
        elif self._still_since_s is None:
            self._still_since_s = now_s
        elif now_s - self._still_since_s >= LANDED_AFTER_S:
            self.landed, self._landed_s = True, now_s
            return Contact.LANDED
        return None

    def idle_s(self, now_s: float) -> float:
        """Time on the ground since it landed, or since it was armed; 0 in the air."""
        if not self.landed:
            return 0.0
        return now_s - (self._landed_s if self.flown else self._armed_s)
