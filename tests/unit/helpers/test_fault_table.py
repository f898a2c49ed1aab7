"""The plugin that writes measured faults into a page."""

from pathlib import Path

import pytest

from common import ROOT
from fault_table import FaultRow, cells_of, rows_of, table_of

CASES = """
    import pytest

    @pytest.mark.parametrize("distance_m", [1.4, 0.5])
    def test_fault(row, distance_m):
        row.fault, row.demanded, row.outcome = f"fault {distance_m}", "1 m", "lands"
        row.measured.append("after 0.1 s")
        row.smallest_distance_m, row.largest_step_deg = distance_m, 2.0
        assert distance_m > 1.0

    @pytest.mark.every_fault
    def test_long(row):
        row.fault = "long"
"""
PAGE = """\
before
<!-- measured: faults -->
| fault or attack | outcome |
|---|---|
| fault 1.4 | old |
| other | kept |
<!-- end of faults -->
after
"""


def run(pytester: pytest.Pytester, *options: str) -> tuple[pytest.RunResult, list[str]]:
    pytester.makeconftest(
        f"import sys\nsys.path.insert(0, {str(ROOT / 'tests' / 'helpers')!r})\npytest_plugins = ['fault_table']\n"
    )
    pytester.makepyfile(CASES)
    page = Path(pytester.path / "page.md")
    page.write_text(PAGE, encoding="utf-8")
    result = pytester.runpytest_subprocess("-q", "-p", "no:cacheprovider", *options)
    return result, page.read_text(encoding="utf-8").splitlines()


def test_rows_of_passed_cases_replace_theirs_and_others_stay(pytester: pytest.Pytester) -> None:
    result, lines = run(pytester, "--fault-table", "page.md")
    result.assert_outcomes(passed=1, failed=1, deselected=1)
    assert (lines[0], lines[-1]) == ("before", "after")
    rows = [line for line in lines if line.startswith("| ") and not line.startswith("| fault or attack |")]
    assert rows == ["| fault 1.4 | 1 m | after 0.1 s | 1.40 | 2.0 | lands |", "| other |  |  |  |  | kept |"]


def test_the_long_cases_run_on_demand(pytester: pytest.Pytester) -> None:
    result, lines = run(pytester, "--faults", "--fault-table", "page.md")
    result.assert_outcomes(passed=2, failed=1)
    assert any(line.startswith("| long |") for line in lines)


def test_without_the_option_no_page_is_written(pytester: pytest.Pytester) -> None:
    _, lines = run(pytester)
    assert lines == PAGE.splitlines()


def test_a_column_that_is_empty_in_all_rows_is_left_out_and_comes_back() -> None:
    first = cells_of(FaultRow("a flood", "in formation", ["error 0.05 m"], outcome="dropped").line())
    table = table_of([first])
    assert table[0] == "| fault or attack | demanded | measured | outcome |"
    assert table[2] == "| a flood | in formation | error 0.05 m | dropped |"
    second = cells_of(FaultRow("a gust", "in formation", ["error 0.1 m"], 1.234, outcome="ok").line())
    merged = table_of([*rows_of("\n".join(table)).values(), second])
    assert merged[0] == "| fault or attack | demanded | measured | smallest distance [m] | outcome |"
    assert merged[2:] == [
        "| a flood | in formation | error 0.05 m |  | dropped |",
        "| a gust | in formation | error 0.1 m | 1.23 | ok |",
    ]
