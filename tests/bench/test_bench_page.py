"""The page of the bench: what stands in a row, and how figures are written."""

from __future__ import annotations

import pytest

from tests.bench.figures import Row, Section, Target
from tests.bench.machine import Machine
from tests.bench.page import digits, page, quantity, row_in_words, table, target_in_words

pytestmark = pytest.mark.long

MACHINE = Machine(
    processor="a processor",
    cores=2,
    python="3.12.1",
    commit="abc1234",
    date="2026-01-31",
    lasted_s=570.0,
    stolen_percent=1.25,
)
MEASURED = Row(
    what="wake-up",
    unit="ms",
    values=(0.2, 0.3, 0.25),
    beside="C loop",
    beside_values=(0.1, 0.2),
    target=Target("ratio", most=1.5),
)
MISSING = Row(what="flight", unit="Hz", values=(), target=Target("value", least=49.5, most=50.5), remark="it failed")


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.012345, "0.0123"), (1.0, "1.00"), (99.94, "99.9"), (1234.5, "1,230"), (-12.34, "-12.3")],
)
def test_three_digits_are_written(value: float, text: str) -> None:
    assert digits(value) == text


def test_a_quantity_has_its_range() -> None:
    assert quantity((1.0, 3.0, 2.0), "us") == "2.00 us (1.00 to 3.00)"
    assert quantity((20.0, 20.0), "ms") == "20.0 ms"
    assert quantity((), "us") == "not measured"


def test_targets_in_words() -> None:
    assert target_in_words(Target("value", most=0.3), "ms") == "at most 0.3 ms"
    assert target_in_words(Target("ratio", most=2.0), "ms") == "at most 2 times"
    assert target_in_words(Target("value", least=340.0), "1/s") == "at least 340 1/s"
    assert target_in_words(Target("value", least=49.5, most=50.5), "Hz") == "49.5 to 50.5 Hz"


def test_figure_other_ratio_and_target_stand_in_one_row() -> None:
    line = table([MEASURED]).splitlines()[-1]
    assert line == (
        "| wake-up | 0.250 ms (0.200 to 0.300) | C loop: 0.150 ms (0.100 to 0.200) | 1.67 | at most 1.5 times | no |"
    )


def test_what_could_not_be_measured_says_so() -> None:
    assert table([MISSING]).splitlines()[-1] == "| flight | not measured |  |  | 49.5 to 50.5 Hz | not measured |"
    assert row_in_words(MISSING).endswith("target 49.5 to 50.5 Hz: not measured   (it failed)")


def test_the_page_says_where_and_how_it_was_measured() -> None:
    text = page(
        MACHINE, [Section(title="Wake-up", how="By a\nclock. " * 30, rows=(MEASURED, MISSING), others_cores=0.5)]
    )
    assert text.startswith("# Performance\n")
    assert "9.5 minutes on 2 cores of a processor" in " ".join(text.split())
    assert "\n## Wake-up\n\nBy a clock." in text
    assert "\n- flight: it failed\n- meanwhile processes outside the bench used 0.50 cores\n" in text
    assert all(len(line) <= 100 or line.startswith("|") for line in text.splitlines())
