"""The lines and the data of a command's outcome."""

import json
from dataclasses import replace

import pytest

from companion.ground.answers import End, Outcome, TimedReply, answer_lines, answers_as_data, end_lines, outcome_of
from companion.types.commands import CommandReply
from companion.types.notices import Code, Notice

OUTCOMES = {
    i: outcome_of(answer, 3.0)
    for i, answer in {
        2: TimedReply(
            CommandReply(2, 9, False, Code.ATTITUDE_STALE, "arm: attitude \x1b[31mstale", "anna@ground"), 0.0314
        ),
        1: TimedReply(CommandReply(1, 9, True, Code.PHASE_CHANGED, "arm begins", "anna@ground"), 0.012),
        3: None,
    }.items()
}


def test_each_vehicle_has_a_line_with_code_and_time() -> None:
    assert answer_lines(OUTCOMES) == [
        "vehicle 1   accepted   12 ms  PHASE_CHANGED: arm begins",
        "vehicle 2   refused    31 ms  ATTITUDE_STALE: arm: attitude ?[31mstale",
        "vehicle 3   missing           NO_REPLY: no reply within 3 s",
    ]


@pytest.mark.parametrize(("columns", "widest"), [("80", 80), ("100", 100), ("200", 100)])
def test_long_reasons_are_wrapped_and_indented(columns: str, widest: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    long = Outcome(
        OUTCOMES[2].kind, Notice(Code.SLOT_TOO_CLOSE, "the slots of vehicles 1 and 2 are too close; " * 5), 0.1
    )
    lines = answer_lines({2: long})
    assert len(lines) > 2
    assert max(map(len, lines)) <= widest
    assert all(line.startswith(" " * 30) for line in lines[1:])


def test_the_data_has_the_code_and_null_where_nothing_is_known() -> None:
    data = json.loads(json.dumps(answers_as_data(OUTCOMES)))
    assert [(v["vehicle_id"], v["answer"], v["code"], v["after_s"], v["finished"]) for v in data] == [
        (1, "accepted", "PHASE_CHANGED", 0.012, None),
        (2, "refused", "ATTITUDE_STALE", 0.0314, None),
        (3, "missing", "NO_REPLY", None, None),
    ]


def test_the_end_of_an_action_counts_and_names_what_is_not_finished() -> None:
    finished = End(True, 2.14, Notice(Code.ACTION_FINISHED, "armed"))
    failed = End(False, 3.0, Notice(Code.ACTION_FAILED, "not armed: phase ready"))
    outcomes = {1: replace(OUTCOMES[1], end=finished), 2: replace(OUTCOMES[1], end=failed)}
    assert end_lines(outcomes, "armed") == [
        "vehicle 2   not finished  ACTION_FAILED: not armed: phase ready",
        "1 of 2 vehicles armed (3.0 s)",
    ]
    data = answers_as_data(outcomes)
    assert [(v["finished"], v["finished_after_s"], v["end_code"]) for v in data] == [
        (True, 2.14, "ACTION_FINISHED"),
        (False, None, "ACTION_FAILED"),
    ]
    assert [outcome.good for outcome in outcomes.values()] == [True, False]
