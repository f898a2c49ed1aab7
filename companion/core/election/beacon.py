"""Leader beacons: how a vehicle knows that a leader is alive, which PrC alone does not show; and mission time.

Without a leader in reach, PrC rises by one each tick and stays at n, and p = n is also valid at the end of a chain of n. So
every packet carries a leader beacon beside the PrC: the leader's id, and a stamp that only the leader increases.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from math import cos, inf

from msgspec import Struct

from companion.types.formation import LeaderBeacon, Term

STAMPS_PER_S = 1000.0  # a leader counts its stamps in milliseconds
REMEMBERED = 0.7  # rate of the stored clock of a leader: it runs slow, so that true stamps overtake a wrong one
STAMPS_AHEAD = 300  # what beacons on ways of different length differ by at most, ms
CONFIRMED_S = 1.0  # longer than the last beacons of a dead leader are passed on
GAP_S = 0.5  # longest time between two beacons of a rival
OLDER_TERM_S = 5.0  # so long beacons of an older term are remembered: the vehicle may return to it
# What is passed on may differ from what the leader has just said itself by so much.
NEWER_S, MISSION_OFF_S, LEAST_COS = 0.02, 1.0, cos(0.3)


class _Kept(Struct, frozen=True, gc=False):
    """Newest beacon of a leader, and refused ones whose stamps rise by themselves."""

    beacon: LeaderBeacon
    received_s: float
    clock_stamp: float  # the leader's clock showed at least this at `received_s`
    rival_stamp: int = -1
    rival_since_s: float = inf
    rival_s: float = -inf


def _after(kept: _Kept, now_s: float, beacon: LeaderBeacon) -> _Kept:
    """What is kept of a leader after a beacon of it with another stamp: one from far may be older than the newest."""
    stamp, elapsed_s = beacon.stamp, now_s - kept.received_s
    if kept.beacon.stamp < stamp <= kept.clock_stamp + STAMPS_PER_S * elapsed_s + STAMPS_AHEAD:
        clock_stamp, own_stamp = kept.clock_stamp + REMEMBERED * STAMPS_PER_S * elapsed_s, float(stamp)
        return _Kept(beacon, now_s, own_stamp if own_stamp > clock_stamp else clock_stamp)
    silent_s = now_s - kept.rival_s
    # Else the same stamp, or an older one: changes nothing for a while
    if silent_s > GAP_S or stamp > kept.rival_stamp:
        follows = silent_s <= GAP_S and stamp <= kept.rival_stamp + STAMPS_PER_S * silent_s + STAMPS_AHEAD
        since_s = kept.rival_since_s if follows else now_s
        kept = _Kept(kept.beacon, kept.received_s, kept.clock_stamp, stamp, since_s, now_s)
    confirmed = kept.rival_s == now_s and now_s - max(kept.rival_since_s, kept.received_s) >= CONFIRMED_S
    return _Kept(beacon, now_s, float(stamp)) if confirmed else kept


Said = tuple[LeaderBeacon, float]
"""The beacon of a fresh leader as it said it itself, and the age of its packet in seconds."""


def _contradicts(beacon: LeaderBeacon, said: Collection[Said]) -> bool:
    """Whether a beacon that was passed on contradicts what its leader has just said itself.

    A vehicle that lies could raise the stamp, so that its words count and the leader's own beacons seem old for a second. What
    is said in another term may be newer.
    """
    for own, age_s in said:
        if own is beacon or own.leader_id != beacon.leader_id or own.epoch != beacon.epoch or own.claim != beacon.claim:
            continue
        if (
            beacon.stamp > own.stamp + STAMPS_PER_S * (age_s + NEWER_S)
            or (beacon.reference_s != 0.0 and abs(beacon.reference_s - own.reference_s) > MISSION_OFF_S)
            or cos(beacon.heading.angle_rad - own.heading.angle_rad) < LEAST_COS
        ):
            return True
    return False


class BeaconMonitor:
    """Time of the last increase of each leader's stamp, on this vehicle's own clock.

    Two followers that receive only each other pass the same stamp back and forth without making it younger: each vehicle
    accepts a stamp once. A beacon older than `max_age_s` is not passed on, so it is gone everywhere after `max_age_s` and one
    tick per hop. A stamp rises with the leader's clock, not faster. After a stamp that was wrong, and after a restart of the
    leader's computer, the true stamps are refused; they count when they have risen for CONFIRMED_S.
    """

    def __init__(self, max_age_s: float) -> None:
        self._max_age_s = max_age_s
        self._newest: dict[tuple[int, Term], _Kept] = {}  # by leader id and term

    def receive(
        self, now_s: float, beacons: Iterable[LeaderBeacon | None], term: Term, said: Collection[Said] = ()
    ) -> None:
        """Beacons that neighbours passed on. One of another term than `term`, this vehicle's own, is ignored.

        So is one that contradicts what fresh leaders have just `said` themselves. The own term may be older than before: then
        those of the newer one had no leader, and are not passed on.
        """
        newest = self._newest
        for leader in tuple(newest):
            if leader[1] != term and (leader[1] > term or now_s - newest[leader].received_s > OLDER_TERM_S):
                del newest[leader]
        epoch, rank = term
        for beacon in beacons:
            if beacon is None or beacon.epoch != epoch or -beacon.claim != rank:
                continue
            leader, stamp = (beacon.leader_id, term), beacon.stamp
            kept = newest.get(leader)
            if kept is None:
                after = _Kept(beacon, now_s, float(stamp))
            elif kept.beacon.stamp == stamp or (kept.received_s == now_s and kept.beacon.stamp > stamp):
                continue  # the same one again, or an older one from far beside a newer one
            else:
                after = _after(kept, now_s, beacon)
            if not _contradicts(beacon, said):
                newest[leader] = after

    def youngest(self, now_s: float) -> tuple[LeaderBeacon | None, float]:
        """The beacon to pass on and its age in seconds; None and infinity without one within `max_age_s`.

        The newest term comes first, and in it a leader that flies the RFT before one that does not. After a change of leader
        the last beacon of the old one counts until it is too old: that of the new leader is on its way.
        """
        alive = []
        for kept in self._newest.values():
            if now_s - kept.received_s <= self._max_age_s:
                alive.append(kept)
        if not alive:
            return None, inf
        best = alive[0]
        if len(alive) > 1:
            best = max(alive, key=lambda kept: _rank(kept.beacon, now_s - kept.received_s))
        return best.beacon, now_s - best.received_s


def _rank(beacon: LeaderBeacon, age_s: float) -> tuple[Term, bool, float, int]:
    return (beacon.term, beacon.reference_s > 0.0, -age_s, beacon.leader_id)


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
            own_zero_s = self._zero_s if self.runs else now_s - self._counted_s
            if abs(zero_s - own_zero_s) <= CORRECTION_S:
                self._rival = None
                self._zero_s = zero_s
                return self._run(now_s)
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
        """Whether to follow a beacon that is no small step away: after DIFFERS_FOR_S of beacons that agree.

        Larger steps of single beacons would add up, and a fall that does not last would restart the formation's time.
        """
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
