"""For faults in flight: a fleet of its own for each test, in formation."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from process_fleet import FaultyFleet, faulty_fleet


@pytest.fixture
def flight(tmp_path: Path) -> Iterator[FaultyFleet]:
    with faulty_fleet(tmp_path) as flight:
        flight.form()
        yield flight
