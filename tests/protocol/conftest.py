"""One vehicle of each make in the air, for all tests of a file."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from wire_autopilots import ARDUPILOT, PX4, TappedFlight, in_the_air


@pytest.fixture(scope="module", params=[PX4, ARDUPILOT], ids=["px4", "ardupilot"])
def vehicle(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[TappedFlight]:
    """A stand-in with a wire tap. A test starts an agent, and `form` brings the vehicle into formation from any state."""
    with in_the_air(tmp_path_factory.mktemp("in_the_air"), request.param) as flight:
        yield flight
