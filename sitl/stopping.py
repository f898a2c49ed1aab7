"""SIGINT, SIGTERM and SIGHUP: the first requests landing and stopping, the second stops at once (`at_once`: the first)."""

from __future__ import annotations

import signal
from types import FrameType
from typing import Self

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopNow(BaseException):
    """The signal that stops at once, raised in the main thread like KeyboardInterrupt.

    str() states in one line what remains of the work.
    """

    def __init__(self, text: str, exit_code: int) -> None:
        super().__init__(text)
        self.exit_code = exit_code


class StopRequest:
    """Handles the signals inside a `with` block. `number` is the first that came; `text` is that of StopNow."""

    def __init__(self, text: str, at_once: bool = False) -> None:
        self._text, self._at_once = text, at_once
        self.number: signal.Signals | None = None

    @property
    def exit_code(self) -> int:
        """As in shells: 128 plus the signal's number."""
        return 128 + (self.number or 0)

    def __enter__(self) -> Self:
        self._before = {number: signal.signal(number, self._received) for number in SIGNALS}
        return self

    def __exit__(self, *_exception: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _received(self, number: int, _frame: FrameType | None) -> None:
        first = self.number is None
        if first:
            self.number = signal.Signals(number)
        if first == self._at_once:  # with `at_once` later signals are ignored
            raise StopNow(self._text, self.exit_code)
