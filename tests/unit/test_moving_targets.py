"""What a scenario's fleet may follow, and the reference as leaders told it."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from companion.config.reference import PointReference, WaypointsReference
from companion.types import FlightPhase, FlownSlot, LandedState, LeaderWord, Role, Status, Vector3
from companion.wire.ground import Percentiles, StatusReport, Timing
from sitl.moving_targets import MovingTarget, MovingTargets
from sitl.watch import FlightWatch

NOTHING = Percentiles(0.0, 0.0, 0.0)
LEADING = Status(
    1, 1, "pair", 1, "weighted", FlightPhase.FORMATION, "OFFBOARD", True, LandedState.IN_AIR, (0.0, 0.0, 2.0), (0.0, 0.0, 0.0),
    0.01, 0.5, (0.0, 0.0, 0.0), Role.LEADER, 0, 1, LeaderWord(1, 0, 1, 10.0), 0.0, (), FlownSlot((0.0, 0.0, 0.0)),
    (0.0, 0.0, 2.0), (), {}, "",
)  # fmt: skip


def test_each_tells_of_itself_ten_times_a_second_in_its_time() -> None:
    walker = MovingTarget(
        name="walker", path=WaypointsReference(((0.0, 0.0, 0.0), (10.0, 0.0, 0.0))), begins_s=1.0, ends_s=3.0
    )
    tree = MovingTarget(name="tree", path=PointReference((1.0, 2.0, 3.0)))
    told: list[tuple[str, Vector3, Vector3]] = []
    targets = MovingTargets([walker, tree], lambda *word: told.append(word), began_s=100.0)
    for tick in range(251):
        targets.go_on(100.0 + tick * 0.02)
    trees = [word for word in told if word[0] == "tree"]
    assert len(trees) == pytest.approx(50, abs=2)
    assert set(trees) == {("tree", (0.0, 0.0, 0.0), (1.0, 2.0, 3.0))}
    walks = [word for word in told if word[0] == "walker"]
    assert len(walks) == pytest.approx(20, abs=2)
    assert walks[0][2] == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    x_m = [x for _, _, (x, _, _) in walks]
    assert x_m == sorted(x_m)
    position, velocity, _ = walker.path.curve()(2.0)
    assert walks[-1][2] == pytest.approx(position, abs=0.11)
    assert walks[-1][1] == pytest.approx(velocity, abs=0.11)


def watched(*said: tuple[float, float]) -> FlightWatch:
    """What a watch has heard of a leader that said (how far into the RFT it is, x of r)."""
    watch = FlightWatch([1], [1], 0.0)
    for number, (reference_s, x) in enumerate(said):
        status = replace(LEADING, leader_word=LeaderWord(1, 0, number, reference_s), reference_enu_m=(x, 0.0, 2.0))
        watch.hear(StatusReport(status, Timing(50.0, 1, 0, NOTHING, NOTHING, 5.0, 49.0)), 50.0 + number)
    return watch


def test_the_told_reference_is_by_the_fleet_s_time_and_stands_before_and_after() -> None:
    reference = watched((10.0, 1.0), (10.1, 2.0), (10.2, 4.0)).told_reference()
    for reference_s, x in ((0.0, 1.0), (10.0, 1.0), (10.05, 1.5), (10.15, 3.0), (10.2, 4.0), (99.0, 4.0)):
        assert reference(reference_s).position_enu_m == pytest.approx((x, 0.0, 2.0))


def test_of_two_leaders_words_of_one_time_the_later_counts_and_a_new_flight_begins_anew() -> None:
    watch = watched((10.0, 1.0), (10.1, 2.0), (10.09, 2.5), (10.2, 4.0))
    assert [x for _, (x, _, _) in watch.reference] == [1.0, 2.5, 4.0]
    assert [x for _, (x, _, _) in watched((10.0, 1.0), (10.1, 2.0), (0.1, 7.0)).reference] == [7.0]
