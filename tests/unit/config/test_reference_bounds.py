"""References at the edge of their bounds: each is refused with a reason or flown, never with another exception."""

import pytest
from msgspec import ValidationError, convert

from companion.config.reference import ReferenceSection
from companion.config.reference_check import reference_problems
from one_agent import FLEET

WAYPOINTS = {"kind": "waypoints", "points_enu_m": [[0.0, 0.0, 5.0], [5.0, 0.0, 5.0]]}
CIRCLE = {"kind": "circle", "centre_enu_m": [0.0, 0.0, 5.0], "radius_m": 3.0, "period_s": 20.0}
EIGHT = {"kind": "figure_8", "centre_enu_m": [0.0, 0.0, 5.0], "width_m": 3.0, "height_m": 2.0, "period_s": 20.0}


@pytest.mark.parametrize("tiny", [1e-200, 5e-324, 1e-3])
@pytest.mark.parametrize(
    ("described", "key"),
    [
        (WAYPOINTS, "max_speed_m_s"),
        (WAYPOINTS, "max_acceleration_m_s2"),
        (CIRCLE, "radius_m"),
        (CIRCLE, "ramp_s"),
        (EIGHT, "width_m"),
        (EIGHT, "height_m"),
    ],
)
def test_a_size_near_zero_is_refused(described: dict[str, object], key: str, tiny: float) -> None:
    with pytest.raises(ValidationError, match=f"reference.{key}"):
        convert({"reference": {**described, key: tiny}}, ReferenceSection)


def test_points_at_one_place_are_flown() -> None:
    for offset_m in (0.0, 5e-324, 1e-200, 1e-7):
        points = [[0.0, 0.0, 5.0], [offset_m, 0.0, 5.0], [3.0, 0.0, 5.0]]
        described = {**WAYPOINTS, "points_enu_m": points, "max_speed_m_s": 100.0, "max_acceleration_m_s2": 50.0}
        reference = convert({"reference": described}, ReferenceSection).reference
        list(reference_problems(FLEET, reference))
        assert reference.curve()(1e6)[0] == (3.0, 0.0, 5.0)
