"""Ctrl-C and its kin: the first asks to land and stop, the second stops at once; or the first does, where nothing can land."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType
from typing import Self

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopNow(BaseException):
    """The signal that stops at once. Raised wherever the main thread happens to be; no error, like KeyboardInterrupt.

    str() says in one line what is left of the work.
    """

    def __init__(self, words: str, exit_code: int) -> None:
        super().__init__(words)
        self.exit_code = exit_code


class StopRequest:
    """Watches the signals while it is used in a `with`. `number` is the first that came; `words` are StopNow's."""

    def __init__(self, words: str, at_once: bool = False) -> None:
        self._words, self._at_once = words, at_once
        self.number: signal.Signals | None = None

    @property
    def exit_code(self) -> int:
        """As shells count: 128 and the signal's number."""
        return 128 + (self.number or 0)

    def __enter__(self) -> Self:
        self._before = {number: signal.signal(number, self._asked) for number in SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _asked(self, number: int, _frame: FrameType | None) -> None:
        first = self.number is None
        if first:
            self.number = signal.Signals(number)
        if first == self._at_once:  # asked to stop at once, it has better things to do than to hear that again
            raise StopNow(self._words, self.exit_code)
