"""The largest epoch to accept: no single wrong number uses up all epochs, and peers accept what a vehicle was commanded."""

from __future__ import annotations

from math import inf

from companion.types.commands import MAX_EPOCHS_AHEAD

EPOCHS_PER_S = 1.0  # changes of leader that may be missed in time
COMMANDED_AHEAD, COMMANDED_WITHIN_S = 8, 8.0
RECEIVED_AHEAD = 2 * COMMANDED_AHEAD  # so many may be commanded between two packets


class EpochLimits:
    """Counts from when this vehicle last knew its leader: since then it may have missed changes."""

    def __init__(self) -> None:
        self._led_s = -inf
        self._commanded_from = (-inf, 0)  # begin of the period in which commands are counted, and the epoch then

    def led(self, now_s: float) -> None:
        """A leader of the own term is known now."""
        self._led_s = now_s

    def of_packets(self, now_s: float, epoch: int) -> int:
        """The largest epoch that a peer packet may have; `epoch` is the own one."""
        return epoch + min(RECEIVED_AHEAD + self._missed(now_s), MAX_EPOCHS_AHEAD)

    def of_command(self, now_s: float, epoch: int) -> int:
        """The largest epoch that a command may name: COMMANDED_AHEAD more within COMMANDED_WITHIN_S."""
        begun_s, from_epoch = self._commanded_from
        if now_s - begun_s > COMMANDED_WITHIN_S:
            from_epoch = epoch
            self._commanded_from = (now_s, epoch)
        return from_epoch + min(COMMANDED_AHEAD + self._missed(now_s), MAX_EPOCHS_AHEAD)

    def _missed(self, now_s: float) -> int:
        return int(min(EPOCHS_PER_S * (now_s - self._led_s), MAX_EPOCHS_AHEAD))
