"""Pytest plugin: the table of measured faults. `--faults` also runs the cases marked `every_fault`.

`--fault-table FILE` writes the rows of the tests that passed between two marks of that Markdown file.
The rows of other faults stay.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

BEGIN, END = "<!-- measured: faults -->", "<!-- end of faults -->"
TITLES = ("fault or attack", "demanded", "measured", "smallest distance [m]", "largest setpoint step [deg]", "outcome")


@dataclass
class FaultRow:
    """One row. `demanded` is what the failsafe matrix and the acceptance figures ask for."""

    fault: str = ""
    demanded: str = ""
    measured: list[str] = field(default_factory=list)
    smallest_distance_m: float | None = None
    largest_step_deg: float | None = None
    outcome: str = ""

    def line(self) -> str:
        distance = "" if self.smallest_distance_m is None else f"{self.smallest_distance_m:.2f}"
        step = "" if self.largest_step_deg is None else f"{self.largest_step_deg:.1f}"
        cells = (self.fault, self.demanded, "; ".join(self.measured), distance, step, self.outcome)
        return "| " + " | ".join(cells) + " |"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--faults", action="store_true", help="also run the cases marked every_fault (minutes)")
    parser.addoption("--fault-table", type=Path, help="write the measured faults into this Markdown file")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "every_fault: runs only with --faults")
    config.pluginmanager.register(FaultTable(config), "measured_faults")


@pytest.fixture
def row(request: pytest.FixtureRequest) -> Iterator[FaultRow]:
    """The row of this test; it counts if the test passes."""
    measured = FaultRow()
    yield measured
    if measured.fault:
        request.node.user_properties.append(("fault_row", measured.line()))


class FaultTable:
    """Collects the rows in the order of the tests."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._order: list[str] = []
        self._lines: dict[str, str] = {}
        self._failed: set[str] = set()

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        if not self._config.getoption("--faults"):
            left_out = [item for item in items if item.get_closest_marker("every_fault")]
            items[:] = [item for item in items if item not in left_out]
            if left_out:
                self._config.hook.pytest_deselected(items=left_out)
        self._order = [item.nodeid for item in items]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call":
            self._failed.discard(report.nodeid) if report.passed else self._failed.add(report.nodeid)
        elif report.when == "teardown":
            for name, line in report.user_properties:
                if name == "fault_row":
                    self._lines[report.nodeid] = str(line)

    def pytest_sessionfinish(self) -> None:
        file: Path | None = self._config.getoption("--fault-table")
        lines = [self._lines[test] for test in self._order if test in self._lines and test not in self._failed]
        if file is None or not lines or hasattr(self._config, "workerinput"):
            return
        text = file.read_text(encoding="utf-8")
        before, found, rest = text.partition(BEGIN)
        assert found, f"{file} has no mark {BEGIN}"
        table, _, after = rest.partition(END)
        rows = rows_of(table) | {cells[0]: cells for cells in map(cells_of, lines)}
        file.write_text(before + "\n".join((BEGIN, *table_of(list(rows.values())), END)) + after, encoding="utf-8")


def cells_of(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def rows_of(table: str) -> dict[str, list[str]]:
    """The rows of a written table by their first cell, with an empty cell for each column that it leaves out."""
    head, *rows = [cells_of(line) for line in table.splitlines() if line.startswith("| ")] or [list(TITLES)]
    by_title = [dict(zip(head, row, strict=True)) for row in rows]
    return {row[TITLES[0]]: [row.get(title, "") for title in TITLES] for row in by_title}


def table_of(rows: list[list[str]]) -> list[str]:
    """Its lines, without columns that are empty in all rows."""
    kept = [i for i in range(len(TITLES)) if any(row[i] for row in rows)]
    head = [TITLES[i] for i in kept]
    body = [[row[i] for i in kept] for row in rows]
    return [f"| {' | '.join(head)} |", "|---" * len(kept) + "|", *(f"| {' | '.join(row)} |" for row in body)]
