"""What a scenario with external vision must say, each as one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.config.file import ConfigError
from sitl.flight.scenario import load_scenario

FAULT = "stand_in.capture_faults=[{{kind: {}, at_s: 3, for_s: 2}}]"
IN_FLEET = "no vehicle 9 in the fleet"


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ("stand_in.positioning=gps", "stand_in.positioning: of vehicle 1, 2, 3, 4: expected external_vision"),
        ("stand_in.vehicles={2: {positioning: gps}}", "stand_in.positioning: of vehicle 2: expected external_vision"),
        ("fleet.external_vision=null", 'fleet.origin: "indoor" without fleet.external_vision.place'),
        (
            "fleet.origin={latitude_deg: 1, longitude_deg: 2, altitude_amsl_m: 3}",
            "fleet.external_vision: given, and origin is a place on Earth",
        ),
        (FAULT.format("lost, vehicle: 9"), f"stand_in.capture_faults[0].vehicle: {IN_FLEET}"),
        (FAULT.format("swapped, vehicle: 2, other: 9"), f"stand_in.capture_faults[0].other: {IN_FLEET}"),
        (FAULT.format("swapped, vehicle: 2"), "stand_in.capture_faults[0].other: expected with swapped"),
        (FAULT.format("lost, vehicle: 2, other: 3"), "stand_in.capture_faults[0].other: expected with swapped"),
    ],
)
def test_what_is_wrong_is_named_first(change: str, line: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_scenario(Path("lab_platoon"), [change])
    assert line in str(caught.value).splitlines()[0]


def test_stand_ins_without_gps_need_poses() -> None:
    with pytest.raises(ConfigError, match=r"expected gps, because fleet\.external_vision is not given"):
        load_scenario(Path("platoon"), ["stand_in.positioning=external_vision"])
