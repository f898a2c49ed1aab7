"""Mission time: how far into the RFT the fleet is. Every vehicle counts it, so that a new leader continues the RFT.

Mission time is not the RFT: a follower counts it without knowing the trajectory.
"""

from __future__ import annotations

from companion.types.formation import LeaderBeacon

# On average a packet waits half a tick until it is read; without this each change of leader would lose as much.
WAITED_S = 0.01
CORRECTION_S = 0.1  # followed at once: what packets' delays change by
DIFFERS_FOR_S = 0.5  # longer than any one beacon counts: then another mission time is true
FALLS_BACK_S = 1.0  # a larger step back than any correction: mission time restarted


class MissionClock:
    """Mission time in seconds, on this vehicle's own clock. It runs while a leader is in formation and stops otherwise.

    A beacon with reference_s = 0 means that its leader's time is stopped. The fleet waits near the position of R at that time.
    If mission time ran on or restarted, R would jump for the next leader, so it continues from where it stopped. It restarts
    only after landing.
    """

    def __init__(self) -> None:
        self._zero_s = 0.0  # when the RFT began
        self._counted_s = 0.0
        self._rival: tuple[float, float] | None = None  # another begin of the RFT, and since when it is reported
        self.runs = False
        self.on_ground = True  # set in each tick

    @property
    def has_run(self) -> bool:
        """Whether mission time is known: not before formation, nor after a restart of the agent in flight."""
        return self._counted_s > 0.0

    def update(self, now_s: float, in_formation: bool, beacon: LeaderBeacon | None, beacon_age_s: float) -> float:
        """Mission time of a follower, from its leader's beacon. Without one, running time continues in formation."""
        if beacon is None or beacon.reference_s == 0.0:
            self._rival = None
            runs_on = beacon is None and in_formation
        else:
            zero_s = now_s - (beacon.reference_s + beacon_age_s + WAITED_S)
            if self._is_believed(now_s, zero_s):
                self._zero_s = zero_s
                return self._run(now_s)
            runs_on = True
        return self._run(now_s) if self.runs and runs_on else self._stop(now_s)

    def lead(self, now_s: float, in_formation: bool, other: LeaderBeacon | None, other_age_s: float) -> float:
        """Mission time of a leader. It enters formation at the time of another leader, else at its own stopped time.

        In formation `other` is a leader with precedence: of two that entered at once, one after a landing, both count one time.
        """
        if in_formation and (other is None or self._agrees(now_s, other, other_age_s)):
            self._rival = None
            return self._run(now_s)
        return self.update(now_s, in_formation, other, other_age_s)

    def _agrees(self, now_s: float, other: LeaderBeacon, other_age_s: float) -> bool:
        return other.reference_s == 0.0 or abs(other.reference_s + other_age_s - (now_s - self._zero_s)) < FALLS_BACK_S

    def _is_believed(self, now_s: float, zero_s: float) -> bool:
        """Whether to follow a beacon: at once in small steps, else after DIFFERS_FOR_S of beacons that agree.

        Larger steps of single beacons would add up, and a fall that does not last would restart the formation's time.
        """
        own_zero_s = self._zero_s if self.runs else now_s - self._counted_s
        if abs(zero_s - own_zero_s) <= CORRECTION_S:
            self._rival = None
            return True
        if self._rival is None or abs(zero_s - self._rival[0]) > FALLS_BACK_S:
            self._rival = (zero_s, now_s)
        if now_s - self._rival[1] < DIFFERS_FOR_S:
            return False
        self._rival = None
        return True

    def _run(self, now_s: float) -> float:
        self._counted_s, self.runs = now_s - self._zero_s, True
        return self._counted_s

    def _stop(self, now_s: float) -> float:
        if self.on_ground:
            self._counted_s = 0.0  # the next flight begins the RFT again
        self._zero_s, self.runs = now_s - self._counted_s, False
        return self._counted_s
