"""What `companion analyze` says of neighbours two hops ahead, and of the limit that no law can beat."""

from __future__ import annotations

import json

import pytest

from common import ROOT
from companion.analysis.margins import StringGains
from companion.analysis.response import TICK_S
from companion.cli.main import main
from companion.tools.second_edges import second_edges
from companion.tools.subject import load_subject

CHAIN = ROOT / "config" / "scenarios" / "chain_16.yaml"
TREE = {1: [2, 3], 2: [1, 4], 3: [1, 4], 4: [2, 3, 5], 5: [4]}


def gains(to_last: float) -> StringGains:
    return StringGains(to_last, 1.0, to_last, 1.0)


def test_each_vehicle_gets_one_edge_to_a_vehicle_two_hops_ahead() -> None:
    asked = []

    def gains_of(graph: object) -> StringGains:
        asked.append(graph)
        return gains(1.1)

    found = second_edges(TREE, {1}, gains(1.2), gains_of)
    assert found is not None
    assert (found.edges, found.to_last, found.to_last_with) == ([(1, 4), (2, 5)], 1.2, 1.1)
    assert asked == [{1: [2, 3, 4], 2: [1, 4, 5], 3: [1, 4], 4: [1, 2, 3, 5], 5: [2, 4]}]


@pytest.mark.parametrize(("before", "after"), [(1.0, 0.9), (1.2, 1.2), (1.2, None)])
def test_none_where_nothing_grows_or_they_do_not_help(before: float, after: float | None) -> None:
    assert second_edges(TREE, {1}, gains(before), lambda _: gains(after) if after else None) is None


def test_of_a_chain(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyze", str(CHAIN)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "with neighbours two hops ahead as well the string gain, leader to last, is 1.04 instead of 1.08" in printed
    assert "[1, 3], [2, 4], [3, 5]" in printed
    assert main(["analyze", str(CHAIN), "--json"]) == 0
    analysis = json.loads(capsys.readouterr().out)
    assert len(analysis["second_edges"]["edges"]) == 14
    law = analysis["laws"]["cooperative"]
    assert law["leader_settle_s"] < law["limit_s"] < law["predicted_settle_s"] + TICK_S  # delays are means


def test_a_motion_is_passed_on_after_delay_wait_and_loss() -> None:
    subject = load_subject(CHAIN, ["links.peer_delay_s=0.1", "links.peer_loss=0.1", "links.peer_jitter_s=0"])
    assert subject.pass_on_s == pytest.approx(0.1 + 0.01 + 0.02 / 9.0)
    assert 2.1 + 99 * subject.pass_on_s == pytest.approx(13.2, abs=0.05)  # a chain of 100
