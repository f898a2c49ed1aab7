"""Whether a vehicle has landed, and for how long it has stood there armed: what every autopilot goes by on the ground."""

from __future__ import annotations

from enum import Enum, auto

LANDED_AFTER_S = 0.5  # on the ground with little thrust


class Contact(Enum):
    """What has just happened."""

    TOOK_OFF = auto()
    LANDED = auto()


class GroundContact:
    """One armed vehicle and the ground. Times are the autopilot's own."""

    def __init__(self) -> None:
        self.landed = True
        self.flown = False  # since it was armed
        self._armed_s = 0.0
        self._landed_s = 0.0
        self._still_since_s: float | None = None

    @property
    def flies(self) -> bool:
        """At the last look, without a touch of the ground."""
        return not self.landed and self._still_since_s is None

    def arm(self, now_s: float) -> None:
        self._armed_s = now_s
        self.flown = False

    def watch(self, stands: bool, little_thrust: bool, now_s: float) -> Contact | None:
        """Look once a step while armed."""
        if not stands:
            took_off = self.landed
            self.flown, self.landed, self._still_since_s = True, False, None
            return Contact.TOOK_OFF if took_off else None
        if self.landed:
            return None
        if not little_thrust:
            self._still_since_s = None
        elif self._still_since_s is None:
            self._still_since_s = now_s
        elif now_s - self._still_since_s >= LANDED_AFTER_S:
            self.landed, self._landed_s = True, now_s
            return Contact.LANDED
        return None

    def idle_s(self, now_s: float) -> float:
        """How long it has stood there since it landed, or since it was armed; 0 in the air."""
        if not self.landed:
            return 0.0
        return now_s - (self._landed_s if self.flown else self._armed_s)
