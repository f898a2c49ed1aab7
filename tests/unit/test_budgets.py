"""Files, lines, long functions, repeated names and the work of one tick stay within tests/unit/budgets.json."""

from __future__ import annotations

import ast

import pytest

from tests.bench import budgets

FLOWN = ("tick", "position_to_setpoint")


@pytest.fixture(scope="module")
def source() -> budgets.Budgets:
    return budgets.source_budgets()


@pytest.mark.parametrize("group", [group for group in budgets.stored() if group not in FLOWN])
def test_the_source_is_within_its_budgets(group: str, source: budgets.Budgets) -> None:
    assert budgets.exceeded({group: source[group]}, budgets.stored()) == []


def test_the_laboratory_needs_no_exception() -> None:
    found = budgets.laboratory_exceptions()
    assert found["lines_of_long_functions"] == found["repeated_class_names"] == found["positional_parameters"] == {}


def test_a_tick_of_a_follower_in_steady_formation_is_within_its_budgets() -> None:
    assert budgets.exceeded({"tick": budgets.tick_budgets()}, budgets.stored()) == []


def test_what_lies_between_a_position_and_its_setpoint_is_within_its_budgets() -> None:
    assert budgets.exceeded({"position_to_setpoint": budgets.hot_path_budgets()}, budgets.stored()) == []


def test_tightening_never_raises_a_budget() -> None:
    stored = {"total": {"files": 10.0, "code_lines": 100.0}, "repeated_class_names": {"Row": 7.0, "Case": 3.0}}
    today = {"total": {"files": 9.0, "code_lines": 101.0}, "repeated_class_names": {"Row": 2.0, "Line": 2.0}}
    assert budgets.tightened(today, stored) == {
        "total": {"files": 9.0, "code_lines": 100.0},
        "repeated_class_names": {"Row": 2.0},
    }
    assert budgets.exceeded(today, stored) == [
        "total of code_lines: 101, budget 100",
        "repeated_class_names of Line: 2, budget 0",
    ]


@pytest.mark.parametrize("folder", [*budgets.PROGRAMS, *budgets.LABORATORY])
def test_a_program_begins_when_its_whole_module_is_read(folder: str) -> None:
    """What stands behind the call of `main` is not defined yet."""
    for path in (budgets.TOP / folder).rglob("*.py"):
        body = ast.parse(path.read_text(encoding="utf-8")).body
        begins = [at for at, node in enumerate(body, start=1) if ast.unparse(node).startswith("if __name__ ==")]
        assert begins in ([], [len(body)]), path


MODULE = '''"""Two
lines."""

from a import (
    b,
)

# a comment


def f():
    """One."""
    return b  # counts
'''


def test_code_lines_are_neither_blank_nor_imports_comments_or_docstrings() -> None:
    assert budgets.code_lines(budgets.Module(MODULE)) == 2
