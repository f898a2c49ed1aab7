"""What a path of the network between two agents does to packets: delay, jitter, loss, duplicates, partitions. No clocks."""

from __future__ import annotations

from random import Random

from sitl.vehicle.config import Links


class Path:
    """One directed path. Its random numbers depend on (seed, sender, receiver) alone."""

    def __init__(self, sender: int, receiver: int, links: Links, seed: int) -> None:
        self.sender, self.receiver, self.links = sender, receiver, links
        self._random = Random(f"{seed} {sender} {receiver} network")

    def is_cut(self, now_s: float) -> bool:
        """Whether a partition separates sender and receiver at this time of the flight."""
        return any(partition.separates(self.sender, self.receiver, now_s) for partition in self.links.partitions)

    def loses(self) -> bool:
        """Whether the next packet is lost."""
        return self.links.peer_loss > 0.0 and self._random.random() < self.links.peer_loss

    def delay_s(self) -> float:
        """Delay of the next packet."""
        jitter_s = self.links.peer_jitter_s
        return self.links.peer_delay_s + (jitter_s * self._random.random() if jitter_s else 0.0)

    def arrivals_s(self, now_s: float) -> tuple[float, ...]:
        """Arrival times of a datagram sent now: one, none if it is lost, two if it is duplicated."""
        links = self.links
        if not (links.peer_loss or links.peer_jitter_s or links.peer_duplicates or links.partitions):
            return (now_s + links.peer_delay_s,)
        if self.loses() or self.is_cut(now_s):
            return ()
        arrives_s = now_s + self.delay_s()
        duplicates = self.links.peer_duplicates
        if duplicates and self._random.random() < duplicates:
            return arrives_s, now_s + self.delay_s()
        return (arrives_s,)
