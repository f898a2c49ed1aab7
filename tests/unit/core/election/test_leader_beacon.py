"""Leader beacons: a living leader is known over any number of hops; a dead leader's beacon expires everywhere."""

from itertools import pairwise

import pytest
from msgspec.structs import replace

from companion.core.election.beacon import BeaconMonitor
from companion.types.formation import Heading, LeaderBeacon

TICK_S = 0.02


class Chain:
    """A leader and followers in a line. Each receives its neighbours' beacons of the last tick."""

    def __init__(self, followers: int, max_age_s: float = 0.5) -> None:
        self.watches = [BeaconMonitor(max_age_s) for _ in range(followers)]
        self.beacons: list[LeaderBeacon | None] = [None] * (followers + 1)  # the leader's own first
        self.now_s = 1000.0

    def tick(self, leader_lives: bool) -> None:
        self.now_s += TICK_S
        received = [None, *self.beacons, None]
        self.beacons[0] = LeaderBeacon(1, 0, int(self.now_s * 1000)) if leader_lives else None
        for index, watch in enumerate(self.watches, start=1):
            watch.receive(self.now_s, (received[index], received[index + 2]), (0, 0))
            self.beacons[index] = watch.youngest(self.now_s)[0]

    def ages_s(self) -> list[float]:
        return [watch.youngest(self.now_s)[1] for watch in self.watches]


def test_a_living_leader_is_known_at_the_end_of_a_long_chain() -> None:
    chain = Chain(followers=15)
    for _ in range(100):
        chain.tick(leader_lives=True)
    assert max(chain.ages_s()) == 0.0


@pytest.mark.parametrize("max_age_s", [0.1, 0.5, 3.0, 10.0])
@pytest.mark.parametrize("followers", [1, 2, 3, 15])
def test_a_dead_leader_s_beacon_expires_among_followers_alone(followers: int, max_age_s: float) -> None:
    chain = Chain(followers, max_age_s)
    for _ in range(100):
        chain.tick(leader_lives=True)
    died_s = chain.now_s
    while any(chain.beacons):
        chain.tick(leader_lives=False)
        assert chain.now_s < died_s + max_age_s + (followers + 2) * TICK_S
    for _ in range(2000):
        chain.tick(leader_lives=False)
        assert not any(chain.beacons)


def test_the_age_grows_until_a_new_stamp_arrives() -> None:
    watch = BeaconMonitor(0.5)
    watch.receive(0.0, [LeaderBeacon(1, 0, 100)], (0, 0))
    ages = []
    for tick in range(1, 20):
        watch.receive(tick * TICK_S, [LeaderBeacon(1, 0, 100), LeaderBeacon(1, 0, 80)], (0, 0))
        ages.append(watch.youngest(tick * TICK_S)[1])
    assert all(a < b for a, b in pairwise(ages))


def test_a_new_epoch_begins_with_smaller_stamps() -> None:
    watch = BeaconMonitor(0.5)
    watch.receive(0.0, [LeaderBeacon(1, 0, 100)], (0, 0))
    watch.receive(0.1, [LeaderBeacon(1, 1, 5)], (1, 0))
    assert watch.youngest(0.1) == (LeaderBeacon(1, 1, 5), 0.0)


def received(watch: BeaconMonitor, stamps: list[int], begin_s: float, period_s: float = TICK_S) -> float:
    """Beacons with these stamps, one each period; returns when the last one came."""
    for tick, stamp in enumerate(stamps):
        watch.receive(begin_s + tick * period_s, [LeaderBeacon(1, 0, stamp)], (0, 0))
    return begin_s + (len(stamps) - 1) * period_s


@pytest.mark.parametrize("wrong", [10**9, 2**62, 5_000_000, 20_400])
def test_a_wrong_stamp_counts_for_one_beacon_at_most(wrong: int) -> None:
    """Of a leader that is known already: the wrong one is ignored, or the true ones follow it at once."""
    watch = BeaconMonitor(0.25)
    end_s = received(watch, list(range(0, 20_000, 20)), 0.0)
    watch.receive(end_s + 0.01, [LeaderBeacon(1, 0, wrong)], (0, 0))
    for tick in range(1, 20):
        now_s = end_s + tick * TICK_S
        watch.receive(now_s, [LeaderBeacon(1, 0, 19_980 + tick * 20)], (0, 0))
        assert watch.youngest(now_s)[1] <= 0.05
    assert watch.youngest(now_s)[0] == LeaderBeacon(1, 0, 20_360)


@pytest.mark.parametrize("wrong", [10**9, 2**62])
def test_true_stamps_count_again_after_a_wrong_first_one(wrong: int) -> None:
    watch = BeaconMonitor(0.25)
    watch.receive(0.0, [LeaderBeacon(1, 0, wrong)], (0, 0))
    received(watch, list(range(20, 1500, 20)), 0.02)
    assert watch.youngest(1.48)[0] == LeaderBeacon(1, 0, 1480)


def test_a_restarted_leader_is_accepted_when_its_stamps_rise() -> None:
    watch = BeaconMonitor(0.5)
    received(watch, list(range(10**9, 10**9 + 1000, 20)), 0.0)
    end_s = received(watch, list(range(0, 940, 20)), 2.0)
    assert watch.youngest(end_s)[0] is None
    end_s = received(watch, list(range(940, 1100, 20)), end_s + TICK_S)
    assert watch.youngest(end_s) == (LeaderBeacon(1, 0, 1080), 0.0)


def test_an_older_beacon_beside_a_newer_one_begins_no_rival() -> None:
    watch = BeaconMonitor(0.5)
    watch.receive(10.0, [LeaderBeacon(1, 0, 20_000), LeaderBeacon(1, 0, 19_980)], (0, 0))
    restarted = list(range(3000, 4040, 20))
    end_s = received(watch, restarted[:-2], 10.1)
    assert watch.youngest(end_s)[0] is None
    end_s = received(watch, restarted[-2:], end_s + TICK_S)
    assert watch.youngest(end_s) == (LeaderBeacon(1, 0, restarted[-1]), 0.0)


def test_what_contradicts_the_leaders_own_word_is_not_passed_on() -> None:
    watch, own = BeaconMonitor(0.5), LeaderBeacon(1, 0, 1000, reference_s=5.0)
    for wrong in (
        replace(own, stamp=1100),
        replace(own, stamp=1001, reference_s=9.0),
        replace(own, stamp=1001, heading=Heading(0.4)),
    ):
        watch.receive(10.0, [own, wrong, wrong], (0, 0), [(own, 0.05)])
        assert watch.youngest(10.0)[0] == own
    later = replace(own, stamp=1050, reference_s=5.05, heading=Heading(0.2))
    watch.receive(10.02, [later], (0, 0), [(own, 0.05)])
    assert watch.youngest(10.02)[0] == later


def test_old_stamps_in_circulation_never_count() -> None:
    watch = BeaconMonitor(0.25)
    end_s = received(watch, list(range(0, 2000, 20)), 0.0)
    for tick in range(1, 500):
        now_s = end_s + tick * TICK_S
        watch.receive(now_s, [LeaderBeacon(1, 0, 1900 + 20 * (tick % 4))], (0, 0))
        assert watch.youngest(now_s)[0] is None or now_s - end_s <= 0.26


def test_the_younger_beacon_of_two_leaders_is_passed_on() -> None:
    watch = BeaconMonitor(0.5)
    watch.receive(0.0, [LeaderBeacon(1, 0, 100), None], (0, 0))
    watch.receive(0.1, [LeaderBeacon(2, 0, 7)], (0, 0))
    assert watch.youngest(0.1)[0] == LeaderBeacon(2, 0, 7)


def test_beacons_of_older_epochs_are_ignored() -> None:
    watch = BeaconMonitor(0.5)
    watch.receive(0.0, [LeaderBeacon(1, 0, 100)], (1, 0))
    assert watch.youngest(0.0) == (None, float("inf"))


def test_the_old_leader_s_last_beacon_counts_until_it_is_stale_or_the_new_one_arrives() -> None:
    watch = BeaconMonitor(0.5)
    watch.receive(0.0, [LeaderBeacon(1, 0, 100)], (0, 0))
    watch.receive(0.02, [LeaderBeacon(1, 0, 120)], (1, 0))  # the change: from now on older terms are ignored
    assert watch.youngest(0.02) == (LeaderBeacon(1, 0, 100), 0.02)
    assert watch.youngest(0.52)[0] is None
    watch.receive(0.1, [LeaderBeacon(2, 1, 7)], (1, 0))
    assert watch.youngest(0.3)[0] == LeaderBeacon(2, 1, 7)


def test_the_newest_epoch_comes_before_a_younger_beacon() -> None:
    watch = BeaconMonitor(0.5)
    watch.receive(0.0, [LeaderBeacon(1, 0, 100)], (0, 0))
    watch.receive(0.1, [LeaderBeacon(2, 1, 7)], (1, 0))
    assert watch.youngest(0.15)[0] == LeaderBeacon(2, 1, 7)


def test_a_newer_term_counts_only_with_the_own_term() -> None:
    watch = BeaconMonitor(0.5)
    watch.receive(0.0, [LeaderBeacon(2, 1, 7)], (0, 0))
    assert watch.youngest(0.0)[0] is None


def test_a_leader_with_running_time_comes_before_one_in_hold() -> None:
    watch = BeaconMonitor(0.5)
    watch.receive(0.0, [LeaderBeacon(1, 1, 100, 12.0)], (1, 0))
    watch.receive(0.1, [LeaderBeacon(2, 1, 7, 0.0)], (1, 0))
    assert watch.youngest(0.5)[0] == LeaderBeacon(1, 1, 100, 12.0)
    assert watch.youngest(0.6)[0] == LeaderBeacon(2, 1, 7, 0.0)
