"""To what a reported altitude refers, and how far that is from mean sea level."""

from __future__ import annotations

from math import nan

import pytest

from companion.ground.publishers import AMSL, UNKNOWN_HEIGHT, above_ellipsoid, pressure_altitude


def test_an_altitude_above_the_ellipsoid_is_higher_by_the_geoid() -> None:
    assert above_ellipsoid(47.0).add_m == -47.0
    assert above_ellipsoid(-106.0).add_m == 106.0  # south of India
    assert (AMSL.add_m, UNKNOWN_HEIGHT.add_m) == (0.0, None)


@pytest.mark.parametrize(
    ("qnh_hpa", "add_m"), [(1013.25, 0.0), (1036.5, 191.0), (1003.25, -83.5), (980.0, -280.6), (1050.0, 300.9)]
)
def test_a_pressure_altitude_is_off_by_the_pressure_at_sea_level(qnh_hpa: float, add_m: float) -> None:
    """By the international standard atmosphere 8.3 m for each hPa."""
    assert pressure_altitude(qnh_hpa).add_m == pytest.approx(add_m, abs=1.5)


@pytest.mark.parametrize("qnh_hpa", [0.0, 29.92, 101_325.0, nan])
def test_a_pressure_in_another_unit_is_refused(qnh_hpa: float) -> None:
    with pytest.raises(ValueError, match=r"^qnh_hpa: .* hPa, expected 850 to 1100$"):
        pressure_altitude(qnh_hpa)


def test_a_geoid_that_is_nowhere_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^geoid_m: 488 m, expected -120 to 100$"):
        above_ellipsoid(488.0)
