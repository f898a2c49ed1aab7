"""The configuration reference, generated from the types: complete, and with working links."""

import re
import runpy
from types import SimpleNamespace

import pytest

from common import ROOT


@pytest.fixture(scope="module")
def page() -> str:
    module = SimpleNamespace(**runpy.run_path(str(ROOT / "docs" / "generate" / "configuration.py")))
    text: str = module.configuration()
    return text


def test_every_key_has_a_type_and_a_meaning(page: str) -> None:
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert len(rows) > 120
    for row in rows:
        key, kind, _, _, _, meaning = row.replace("\\|", "/").strip("| ").split(" | ")
        assert kind and meaning.strip(), row
        assert re.fullmatch(r"`\w+`", key)


def test_every_link_leads_to_a_heading_and_no_heading_is_used_twice(page: str) -> None:
    headings = [line.lstrip("# ").lower().replace(" ", "-") for line in page.splitlines() if line.startswith("#")]
    assert len(headings) == len(set(headings))
    assert set(re.findall(r"\(#([^)]+)\)", page)) <= set(headings)


def test_bounds_units_and_defaults_are_those_of_the_types(page: str) -> None:
    assert "| `takeoff_height_m` | number | m | 0.5 to 120 | `2.5` | height of the take-off above the ground |" in page
    assert "| `max_tilt_deg` | number | deg | > 0, ≤ 45 | `25.0` | largest commanded tilt |" in page
    assert "| `role` | `leader`, `follower` |  |  | required |" in page


def test_prose_has_at_most_100_columns(page: str) -> None:
    assert all(len(line) <= 100 for line in page.splitlines() if not line.startswith("|"))
