"""Switching topologies: random starts, topologies of flights, and the results of the command."""

from itertools import permutations
from math import dist
from pathlib import Path

import numpy as np
import pytest

from companion.config.fleet import RangeNeighbours
from companion.types.values import Vector3
from sitl.cli.main import main
from sitl.report.folder import table_text
from sitl.switching.figure import save_switching
from sitl.switching.starts import APART_M, Start, random_start
from sitl.switching.summary import COLUMNS, cells, limits_text, summarize
from sitl.switching.topology import BoolArray, Spectra, Topology, losses, mutual, without_beacon
from tests.helpers.laws import weighted


def graph(n: int, *edges: tuple[int, int]) -> BoolArray:
    matrix = np.zeros((n, n), dtype=np.bool_)
    for a, b in edges:
        matrix[a - 1, b - 1] = matrix[b - 1, a - 1] = True
    return matrix


def test_a_start_is_connected_and_keeps_distances() -> None:
    for seed in range(20):
        starts = random_start(6, 3.0, seed).starts_enu_m
        apart = [dist(a, b) for i, a in starts.items() for j, b in starts.items() if i < j]
        assert min(apart) >= APART_M
        reached = {1}
        for _ in starts:
            reached |= {j for i in reached for j in starts if dist(starts[i], starts[j]) <= 3.0}
        assert reached == set(starts)


def test_a_start_is_the_same_for_the_same_seed() -> None:
    assert random_start(5, 3.0, 7) == random_start(5, 3.0, 7)
    assert random_start(5, 3.0, 7) != random_start(5, 3.0, 8)


def test_an_impossible_start_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.switching.starts.DRAWS", 100)
    with pytest.raises(ValueError, match=r"no start of 40 vehicles with a range of 0\.5 m"):
        random_start(40, 0.5, 1)


def test_a_start_becomes_a_scenario_with_neighbours_by_range() -> None:
    start = random_start(6, 3.0, 1)
    scenario = start.scenario("average_26", RangeNeighbours(range_m=3.0, hysteresis_m=0.3))
    assert scenario.fleet.law.name == "average_26"
    assert scenario.fleet.neighbours == RangeNeighbours(range_m=3.0, hysteresis_m=0.3)
    assert dist(scenario.reference.point_enu_m[:2], start.starts_enu_m[1][:2]) >= 2.0


def test_slots_minimise_the_squared_distances() -> None:
    for seed in range(5):
        start = random_start(5, 3.0, seed)
        members = start.scenario("weighted", RangeNeighbours(range_m=3.0)).fleet.vehicles
        slots = {member.id: member.slot_enu_m for member in members}
        assert slots[1] == (0.0, 0.0, 0.0)

        def squares(of: tuple[int, ...], start: Start = start, slots: dict[int, Vector3] = slots) -> float:
            goals = [[a + b for a, b in zip(start.goal_enu_m[:2], slots[i][:2], strict=True)] for i in of]
            return sum(dist(start.starts_enu_m[i][:2], goal) ** 2 for i, goal in zip(range(2, 6), goals, strict=True))

        assert squares((2, 3, 4, 5)) == pytest.approx(min(squares(of) for of in permutations((2, 3, 4, 5))))


@pytest.mark.parametrize("range_m", ["2", "1.5"])
def test_an_impossible_start_is_one_line_before_any_flight(
    range_m: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sitl.switching.command.fly_all", lambda *_: pytest.fail("something flew"))
    monkeypatch.setattr("sitl.switching.starts.DRAWS", 300)
    out = tmp_path / "not" / "made"
    arguments = ["switching", "--starts", "9", "--range", range_m, "--quiet", "--out", str(out)]
    monkeypatch.setattr("sys.argv", ["sitl", *arguments])
    with pytest.raises(SystemExit, match="2"):
        main()
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert f"no start of 6 vehicles with a range of {range_m} m is connected" in printed.err
    assert not printed.out
    assert not out.exists()


def test_a_vehicle_without_leader_beacon_for_too_long_would_hand_over() -> None:
    uses = np.zeros((20, 3, 3), dtype=np.bool_)
    uses[:, 1, 0] = uses[:, 2, 1] = True  # the beacon passes 1 -> 2 -> 3
    assert without_beacon(uses, 0.1, 0.5) == 0
    uses[5:10, 2, 1] = False
    assert without_beacon(uses, 0.1, 0.5) == 0
    uses[5:11, 2, 1] = False
    assert without_beacon(uses, 0.1, 0.5) == 1
    uses[5:11, 1, 0] = False
    uses[:, 0, 1] = uses[:, 1, 2] = uses[:, 2, 1] = True  # 2 and 3 use each other, which brings no beacon
    assert without_beacon(uses, 0.1, 0.5) == 2


def test_lambda_min_of_the_papers_graph_and_of_a_disconnected_one() -> None:
    spectra = Spectra(weighted(), 4)
    assert spectra.lambda_min(graph(4, (1, 2), (1, 3), (2, 3), (2, 4), (3, 4))) == pytest.approx(0.1979, abs=5e-5)
    assert spectra.lambda_min(graph(4, (1, 2), (3, 4))) is None


def test_an_edge_needs_both_directions_and_is_lost_once() -> None:
    one_sided = np.zeros((3, 2, 2), dtype=np.bool_)
    one_sided[:, 0, 1] = True
    assert losses(mutual(one_sided)) == 0
    edges = np.stack([graph(3, (1, 2), (2, 3)), graph(3, (1, 2)), graph(3, (1, 2), (2, 3)), graph(3)])
    assert losses(edges) == 3


def topology(law: str, cut_off_s: float | None, edges_lost: int = 0, closest_m: float = 1.0) -> Topology:
    return Topology(
        law=law,
        seed=1,
        hysteresis_m=0.0,
        edges_lost=edges_lost,
        lambda_min=0.2,
        cut_off_s=cut_off_s,
        connected_at_the_end=cut_off_s is None,
        would_hand_over=0 if cut_off_s is None else 2,
        final_error_m=0.1,
        closest_m=closest_m,
    )


def test_the_summary_counts_each_law_separately(tmp_path: Path) -> None:
    flown = [
        topology("weighted", None, 4),
        topology("weighted", 2.0, closest_m=0.2),
        topology("average_22", 1.0, closest_m=0.1),
    ]
    laws = {summary.law: summary for summary in summarize(flown)}
    assert (laws["weighted"].starts, laws["weighted"].connected, laws["weighted"].edges_lost_mean) == (2, 1, 2.0)
    assert (laws["average_22"].connected, laws["average_22"].cut_off_median_s) == (0, 1.0)
    assert (laws["weighted"].would_hand_over, laws["weighted"].vehicles_that_would, laws["weighted"].came_close) == (
        1,
        2,
        1,
    )
    assert laws["weighted"].closest_median_m == 0.6
    table = table_text(COLUMNS, map(cells, summarize(flown)))
    assert "50.0 %" in table
    assert max(len(line) for line in table.splitlines()) <= 120
    text = limits_text(summarize(flown), 6)
    assert "In 2 of 3 flights at least one agent" in text
    assert "(4 of 18 vehicles)" in text
    assert "In 2 flights two vehicles came within 0.3 m" in text
    save_switching(tmp_path / "s.png", flown, 30.0, "three starts")
    assert (tmp_path / "s.png").read_bytes().startswith(b"\x89PNG")
