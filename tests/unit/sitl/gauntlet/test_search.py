"""The search for the worst flights: its draws, its repeatability, and that it finds what random flights do not."""

from __future__ import annotations

import signal
from math import dist
from pathlib import Path
from random import Random
from unittest.mock import MagicMock

import msgspec
import pytest

from companion.types.errors import UnusableError
from sitl.flight.scenario import Scenario
from sitl.gauntlet.adversarial import reduced
from sitl.gauntlet.anything import ANYTHING, SEARCHED
from sitl.gauntlet.drawing import ANYTHING_FROM, COMBINED_FROM, Chosen, draw_flight, has_runaway
from sitl.gauntlet.faults import COMBINED
from sitl.gauntlet.flight import FlightOutcome, Job, LeastRoom
from sitl.gauntlet.minimal import TAKE_OFF_STEPS, simpler
from sitl.gauntlet.search import DRAWS, NO_PAIR, Search, read_search, score_of, write_search
from sitl.report.progress import ShareProgress
from sitl.stopping import StopRequest
from sitl.vehicle.config import Wind


def test_given_draws_come_first_and_near_ones_choose_alike() -> None:
    assert [Chosen("1", [0.25, 0.5]).random() for _ in range(2)] == [0.25, 0.25]
    chosen = Chosen("1", [0.25, 0.5, 0.999])
    assert (chosen.uniform(2.0, 6.0), chosen.choice("abcd"), chosen.randrange(10)) == (3.0, "c", 9)
    assert chosen.random() == Random("1").random()  # the draws after them follow from the seed
    assert {Chosen("1", [x]).choice("abcd") for x in (0.51, 0.6, 0.74)} == {"c"}


@pytest.mark.parametrize("family", [COMBINED, ANYTHING, "exchange", "settings_at_bounds"])
def test_the_draws_decide_the_flight(family: str) -> None:
    search = Search(seed=5, sensors=None, families=(family,))
    jobs = search.next_jobs()
    flights = [draw_flight(job.seed, job.number, job.sensors, None, job.choices) for job in jobs]
    again = [draw_flight(job.seed, job.number, job.sensors, None, job.choices) for job in search.next_jobs()]
    assert flights == again
    assert {flight.family for flight in flights} == {family}
    assert any(has_runaway(job.number) for job in jobs) is (family != ANYTHING)
    assert len({flight.scenario.fleet.separation_m for flight in flights}) > len(flights) // 2


def test_a_combined_flight_has_wind_walls_and_several_faults() -> None:
    scenarios = [draw_flight(1, COMBINED_FROM + k).scenario for k in range(40)]
    assert any(one.stand_in.wind != Wind() for one in scenarios)
    assert any(one.fleet.obstacles for one in scenarios)
    assert any(one.links.partitions and one.stand_in.position_losses for one in scenarios)


def test_any_flight_has_other_commands_places_and_faults_than_the_next() -> None:
    scenarios = [draw_flight(1, ANYTHING_FROM + k).scenario for k in range(40)]
    assert {one.fleet.law.name for one in scenarios} == {"weighted", "cooperative", "serial"}
    commands = {step.command for one in scenarios for step in one.timeline}
    assert commands >= {"hold", "land", "return", "form", "formation", "reference", "lead"}
    assert any(one.agent_ends for one in scenarios) and any(one.links.partitions for one in scenarios)
    assert any(member.slot_enu_m[2] > 1.0 for one in scenarios for member in one.fleet.vehicles)


def test_where_each_follower_has_a_part_there_is_no_runaway() -> None:
    assert has_runaway(39)
    assert draw_flight(13, 39).runaway is None


def outcome(job: Job, ratio: float) -> FlightOutcome:
    return FlightOutcome(seed=job.seed, number=job.number, family="exchange", vehicles=4, sensors="ideal", ratio=ratio)


def flown(job: Job) -> FlightOutcome:
    """Worst, 1.0, where eight of the draws are near 0.9: one in 10^5 random flights is within 0.2 of it."""
    return outcome(job, 1.0 + dist(job.choices[10:18], [0.9] * 8))


def test_the_search_comes_nearer_than_as_many_random_flights(tmp_path: Path) -> None:
    search = Search(seed=1, sensors="ideal", families=("exchange",))
    while search.generation < 40:
        jobs = search.next_jobs()
        search.take(jobs, [flown(job) for job in jobs])
        write_search(tmp_path, search)
        search = read_search(tmp_path)  # a search that was stopped goes on the same way
    random = Random(1)
    drawn = min(dist([random.random() for _ in range(8)], [0.9] * 8) for _ in range(search.flights))
    assert search.worst(1)[0].score - 1.0 < 0.5 * drawn
    assert [point.score for point in search.worst(5)] == sorted(point.score for point in search.worst(5))


def test_a_flight_with_a_violation_can_be_flown_again_when_worse_ones_were_found(tmp_path: Path) -> None:
    search = Search(seed=1, sensors="ideal", families=("exchange",))
    first = search.next_jobs()
    while search.generation < 3:
        jobs = search.next_jobs()
        found = [outcome(job, 0.9 - 0.01 * search.generation) for job in jobs]
        found[1:4] = [
            msgspec.structs.replace(outcome(jobs[1], 1.5), braked=[2]),
            msgspec.structs.replace(outcome(jobs[2], 1.5), braked=[2], liars=[3]),
            msgspec.structs.replace(outcome(jobs[3], 1.5), exception="Traceback"),
        ]
        search.take(jobs, [msgspec.structs.replace(one, violation=(one.ratio or 0.0) < 1.0) for one in found])
    write_search(tmp_path, search)
    search = read_search(tmp_path)
    assert len(search.kept) == 3 * (len(first) - 1) and search.violations == 3 * (len(first) - 2)
    assert [point.choices for point in search.kept[:3]] == [first[place].choices for place in (0, 1, 3)]


def test_a_search_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(UnusableError, match=r"^--resume: .*search.json: expected the state of a search"):
        read_search(tmp_path)
    state = msgspec.to_builtins(Search(seed=1, sensors=None, families=())) | {"schema": 9}
    (tmp_path / "search.json").write_bytes(msgspec.json.encode(state))
    with pytest.raises(UnusableError, match=r"schema: 9, expected 1$"):
        read_search(tmp_path)


def test_the_score_is_the_smallest_share_of_what_is_allowed() -> None:
    job = Job(1, 0, choices=(0.5,) * DRAWS)
    assert score_of(outcome(job, 0.9)) == 0.9
    near_wall = msgspec.structs.replace(outcome(job, 1.5), room=LeastRoom(distance_m=-0.15, time_s=3.0, vehicle=2))
    assert score_of(near_wall) == pytest.approx(0.9)
    assert score_of(msgspec.structs.replace(near_wall, sensors="default")) == pytest.approx(1.05)
    assert score_of(FlightOutcome(seed=1, number=0, family="exchange", failure="cannot be flown")) == NO_PAIR
    assert score_of(FlightOutcome(seed=1, number=0, family="exchange", vehicles=4, exception="Traceback")) == 0.0


@pytest.mark.parametrize(
    "family", [name for name in SEARCHED if name in (COMBINED, "leader_dies", "split_in_exchange")]
)
def test_each_simpler_scenario_lacks_one_thing(family: str) -> None:
    job = Search(seed=5, sensors=None, families=(family,)).next_jobs()[1]
    scenario = draw_flight(job.seed, job.number, None, None, job.choices).scenario
    count = sum(1 for _ in simpler(scenario))
    while left := list(simpler(scenario)):
        assert len(left) == count
        assert all(one != scenario for one in left)
        assert {_ends_s(one) for one in left} == {_ends_s(scenario)}
        scenario, count = left[0], count - 1
    assert len(scenario.timeline) == TAKE_OFF_STEPS
    assert scenario.links == type(scenario.links)()


def _ends_s(scenario: Scenario) -> float:
    last = scenario.timeline[-1]
    return round((last.at_s or 0.0) + last.for_s, 3)


def test_a_stop_does_not_wait_for_the_reduction_of_the_worst_flights() -> None:
    workers, stop = MagicMock(), StopRequest("stopped")
    in_progress = workers.running.return_value.__enter__.return_value
    in_progress.share_done = 0.5

    def wait(_seconds: float) -> bool:
        assert stop.number is None, "waits on after the signal"
        stop.number = signal.SIGINT
        return False

    in_progress.wait = wait
    assert reduced(workers, Search(seed=1, sensors=None, families=("joining",)), ShareProgress(True), stop) == []
