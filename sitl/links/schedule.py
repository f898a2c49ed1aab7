"""Message rates of one MAVLink link of a stand-in, on the autopilot's clock."""

from __future__ import annotations

from math import inf

EPSILON_S = 1e-6


class Schedule:
    """Rates of one link. They persist when the peer reconnects."""

    def __init__(self, rates_hz: dict[int, float]) -> None:
        self.reset(rates_hz, 0.0)

    def reset(self, rates_hz: dict[int, float], now_s: float) -> None:
        """Set other default rates: PX4's ground link sends more after its peer has connected."""
        self._defaults = rates_hz
        self._period_s = {message_id: 1.0 / rate_hz for message_id, rate_hz in rates_hz.items() if rate_hz > 0.0}
        self._due_s = dict.fromkeys(self._period_s, now_s)
        self._next_s = now_s

    def set_rate(self, message_id: int, rate_hz: float, now_s: float) -> None:
        """Set a rate; the first message is due one period from now. 0 is off."""
        self._due_s.pop(message_id, None)
        self._period_s.pop(message_id, None)
        if rate_hz > 0.0:
            self._period_s[message_id] = 1.0 / rate_hz
            self._due_s[message_id] = now_s + self._period_s[message_id]
        self._next_s = min(self._due_s.values(), default=inf)

    def postpone(self, message_id: int) -> None:
        """Skip a message that is due; it is due again one period later."""
        self._due_s[message_id] += self._period_s[message_id]

    def default_hz(self, message_id: int) -> float:
        return self._defaults.get(message_id, 0.0)

    def interval_us(self, message_id: int) -> int:
        """Interval as in MESSAGE_INTERVAL: -1 is off."""
        return round(self._period_s[message_id] * 1e6) if message_id in self._period_s else -1

    def due(self, now_s: float) -> list[int]:
        """Messages to be sent now. They are evenly spaced: a late step does not shift the following ones."""
        if now_s < self._next_s - EPSILON_S:
            return []
        ready = [message_id for message_id, due_s in self._due_s.items() if now_s >= due_s - EPSILON_S]
        ready = self._without_old_news(ready)
        for message_id in ready:
            period_s = self._period_s[message_id]
            next_s = self._due_s[message_id] + period_s
            self._due_s[message_id] = next_s if next_s > now_s else now_s + period_s
        self._next_s = min(self._due_s.values(), default=inf)
        return ready

    def _without_old_news(self, ready: list[int]) -> list[int]:
        """The due messages that are sent; the others remain due."""
        return ready
