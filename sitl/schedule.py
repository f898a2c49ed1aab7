"""Which messages go out on one MAVLink link of the stand-in, how often, on the autopilot's own clock."""

from __future__ import annotations

from math import inf

EPSILON_S = 1e-6


class Schedule:
    """Rates of one link. They outlive a reconnection of the peer."""

    def __init__(self, rates_hz: dict[int, float]) -> None:
        self.reset(rates_hz, 0.0)

    def reset(self, rates_hz: dict[int, float], now_s: float) -> None:
        """Other defaults: a ground link may say more once somebody was heard there."""
        self._defaults = rates_hz
        self._period_s = {message_id: 1.0 / rate_hz for message_id, rate_hz in rates_hz.items() if rate_hz > 0.0}
        self._due_s = dict.fromkeys(self._period_s, now_s)
        self._next_s = now_s

    def set_rate(self, message_id: int, rate_hz: float, now_s: float) -> None:
        """From one period after now; 0 is off."""
        self._due_s.pop(message_id, None)
        self._period_s.pop(message_id, None)
        if rate_hz > 0.0:
            self._period_s[message_id] = 1.0 / rate_hz
            self._due_s[message_id] = now_s + self._period_s[message_id]
        self._next_s = min(self._due_s.values(), default=inf)

    def postpone(self, message_id: int) -> None:
        """What is due has nothing to say: it is asked again a period later."""
        self._due_s[message_id] += self._period_s[message_id]

    def default_hz(self, message_id: int) -> float:
        return self._defaults.get(message_id, 0.0)

    def interval_us(self, message_id: int) -> int:
        """As MESSAGE_INTERVAL tells it: -1 off."""
        return round(self._period_s[message_id] * 1e6) if message_id in self._period_s else -1

    def due(self, now_s: float) -> list[int]:
        """What is to be sent now. Evenly spaced: a late step does not shift what follows."""
        if now_s < self._next_s - EPSILON_S:
            return []
        ready = [message_id for message_id, due_s in self._due_s.items() if now_s >= due_s - EPSILON_S]
        ready = self._told(ready)
        for message_id in ready:
            period_s = self._period_s[message_id]
            next_s = self._due_s[message_id] + period_s
            self._due_s[message_id] = next_s if next_s > now_s else now_s + period_s
        self._next_s = min(self._due_s.values(), default=inf)
        return ready

    def _told(self, ready: list[int]) -> list[int]:
        """Those of the messages that are due which have something to say; the others stay due."""
        return ready
