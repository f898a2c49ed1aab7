"""A living leader is heard through any number of hops; a dead one's word dies everywhere, whatever circulates."""

from itertools import pairwise

import pytest

from companion.core.leader_word import LeaderWatch
from companion.types import LeaderWord

TICK_S = 0.02


class Chain:
    """A leader and followers in a line, each hearing its neighbours' words of the tick before."""

    def __init__(self, followers: int, max_age_s: float = 0.5) -> None:
        self.watches = [LeaderWatch(max_age_s) for _ in range(followers)]
        self.words: list[LeaderWord | None] = [None] * (followers + 1)  # the leader's first
        self.now_s = 1000.0

    def tick(self, leader_lives: bool) -> None:
        self.now_s += TICK_S
        heard = [None, *self.words, None]
        self.words[0] = LeaderWord(1, 0, int(self.now_s * 1000)) if leader_lives else None
        for index, watch in enumerate(self.watches, start=1):
            watch.hear(self.now_s, (heard[index], heard[index + 2]), (0, 0))
            self.words[index] = watch.youngest(self.now_s)[0]

    def ages_s(self) -> list[float]:
        return [watch.youngest(self.now_s)[1] for watch in self.watches]


def test_a_living_leader_is_heard_at_the_end_of_a_long_chain() -> None:
    chain = Chain(followers=15)
    for _ in range(100):
        chain.tick(leader_lives=True)
    assert max(chain.ages_s()) == 0.0


@pytest.mark.parametrize("max_age_s", [0.1, 0.5, 3.0, 10.0])
@pytest.mark.parametrize("followers", [1, 2, 3, 15])
def test_a_dead_leaders_word_dies_among_followers_that_hear_only_each_other(followers: int, max_age_s: float) -> None:
    chain = Chain(followers, max_age_s)
    for _ in range(100):
        chain.tick(leader_lives=True)
    died_s = chain.now_s
    while any(chain.words):
        chain.tick(leader_lives=False)
        assert chain.now_s < died_s + max_age_s + (followers + 2) * TICK_S
    for _ in range(2000):
        chain.tick(leader_lives=False)
        assert not any(chain.words)


def test_ages_only_grow_between_new_stamps() -> None:
    watch = LeaderWatch(0.5)
    watch.hear(0.0, [LeaderWord(1, 0, 100)], (0, 0))
    ages = []
    for tick in range(1, 20):
        watch.hear(tick * TICK_S, [LeaderWord(1, 0, 100), LeaderWord(1, 0, 80)], (0, 0))
        ages.append(watch.youngest(tick * TICK_S)[1])
    assert all(a < b for a, b in pairwise(ages))


def test_a_new_epoch_counts_from_anew() -> None:
    watch = LeaderWatch(0.5)
    watch.hear(0.0, [LeaderWord(1, 0, 100)], (0, 0))
    watch.hear(0.1, [LeaderWord(1, 1, 5)], (0, 0))
    assert watch.youngest(0.1) == (LeaderWord(1, 1, 5), 0.0)


def test_a_restarted_leader_is_believed_after_its_old_word_is_long_gone() -> None:
    watch = LeaderWatch(0.5)
    watch.hear(0.0, [LeaderWord(1, 0, 10**9)], (0, 0))
    watch.hear(1.0, [LeaderWord(1, 0, 20)], (0, 0))
    assert watch.youngest(1.0)[0] is None
    watch.hear(12.0, [LeaderWord(1, 0, 11020)], (0, 0))
    assert watch.youngest(12.0) == (LeaderWord(1, 0, 11020), 0.0)


def test_of_two_leaders_the_younger_word_is_passed_on() -> None:
    watch = LeaderWatch(0.5)
    watch.hear(0.0, [LeaderWord(1, 0, 100), None], (0, 0))
    watch.hear(0.1, [LeaderWord(2, 0, 7)], (0, 0))
    assert watch.youngest(0.1)[0] == LeaderWord(2, 0, 7)


def test_words_of_older_epochs_are_not_heeded() -> None:
    watch = LeaderWatch(0.5)
    watch.hear(0.0, [LeaderWord(1, 0, 100)], (1, 0))
    assert watch.youngest(0.0) == (None, float("inf"))


def test_at_a_change_the_old_leader_s_last_word_counts_until_the_new_one_s_comes_or_it_is_too_old() -> None:
    watch = LeaderWatch(0.5)
    watch.hear(0.0, [LeaderWord(1, 0, 100)], (0, 0))
    watch.hear(0.02, [LeaderWord(1, 0, 120)], (1, 0))  # the change: from now on nothing old is heeded
    assert watch.youngest(0.02) == (LeaderWord(1, 0, 100), 0.02)
    assert watch.youngest(0.52)[0] is None
    watch.hear(0.1, [LeaderWord(2, 1, 7)], (1, 0))
    assert watch.youngest(0.3)[0] == LeaderWord(2, 1, 7)


def test_the_newest_epoch_comes_before_a_younger_word() -> None:
    watch = LeaderWatch(0.5)
    watch.hear(0.0, [LeaderWord(2, 1, 7)], (0, 0))
    watch.hear(0.1, [LeaderWord(1, 0, 100)], (0, 0))
    assert watch.youngest(0.1)[0] == LeaderWord(2, 1, 7)


def test_a_leader_whose_time_runs_comes_before_one_in_hold() -> None:
    watch = LeaderWatch(0.5)
    watch.hear(0.0, [LeaderWord(1, 1, 100, 12.0)], (0, 0))
    watch.hear(0.1, [LeaderWord(2, 1, 7, 0.0)], (0, 0))
    assert watch.youngest(0.5)[0] == LeaderWord(1, 1, 100, 12.0)
    assert watch.youngest(0.6)[0] == LeaderWord(2, 1, 7, 0.0)
