"""Latitude and longitude where metres are expected."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from common import ROOT
from companion.cli.main import main
from companion.config.degrees import degree_notices
from companion.types.notices import Code
from companion.types.values import Vector3
from sitl.flight.flights import check_convergence
from sitl.flight.scenario import load_scenario

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"  # about 47.397742, 8.545594
LATITUDE_FIRST, LONGITUDE_FIRST = (47.397755, 8.545594, 0.0), (8.545594, 47.397755, 0.0)


@pytest.mark.parametrize("start", [LATITUDE_FIRST, LONGITUDE_FIRST])
def test_a_start_in_degrees_is_a_warning(start: Vector3) -> None:
    scenario = load_scenario(PLATOON)
    (notice,) = degree_notices(
        scenario.fleet.origin, replace(scenario, starts_enu_m={**scenario.starts_enu_m, 1: start})
    )
    assert notice.code is Code.LOOKS_LIKE_DEGREES
    assert (
        notice.text
        == f"starts_enu_m.1: {list(start)} looks like latitude and longitude; expected metres east, north and up"
    )


def test_every_position_of_a_file_is_looked_at() -> None:
    scenario = load_scenario(PLATOON)
    point = replace(scenario.reference, point_enu_m=LATITUDE_FIRST)  # type: ignore[arg-type]
    envelope = replace(scenario.fleet.envelope, fence_corners_enu_m=((0.0, 0.0), LONGITUDE_FIRST[:2]))
    changed = replace(scenario, reference=point, fleet=replace(scenario.fleet, envelope=envelope))
    (notice,) = degree_notices(scenario.fleet.origin, changed)
    assert notice.text.startswith("fleet.envelope.fence_corners_enu_m[1]: [8.545594, 47.397755] looks like")
    assert ", and 1 more; expected metres" in notice.text


@pytest.mark.parametrize("start", [(47.4, 8.5456, 0.0), (47.3978, 18.5456, 0.0), (0.3978, 0.5456, 0.0)])
def test_metres_are_none(start: Vector3) -> None:
    scenario = load_scenario(PLATOON)
    assert list(degree_notices(scenario.fleet.origin, [start, {"starts_enu_m": {1: start}}])) == []


def test_analyze_and_flights_warn_of_it(capsys: pytest.CaptureFixture[str]) -> None:
    override = "starts_enu_m.1=[47.397755, 8.545594, 0.0]"
    assert check_convergence(load_scenario(PLATOON, [override]))[0].code is Code.LOOKS_LIKE_DEGREES
    assert main(["analyze", "platoon", "--set", override]) == 0
    assert "- LOOKS_LIKE_DEGREES: starts_enu_m.1: [47.397755" in capsys.readouterr().out


def test_a_refusal_for_places_that_are_too_near_says_it(capsys: pytest.CaptureFixture[str]) -> None:
    slots = [f"fleet.vehicles[{n}].slot_enu_m=[47.39775{n}, 8.545594, 0.0]" for n in (1, 2)]
    point = ["reference.point_enu_m=[47.397755, 8.545594, 1.0]", "fleet.envelope.fence_max_enu_m=[20.0, 20.0, 20.0]"]
    starts = [f"starts_enu_m.{n}=[47.39775{n}, 8.545594, 0.0]" for n in (1, 2)]
    for given in (slots, starts, point):
        assert main(["analyze", "platoon", *(word for line in given for word in ("--set", line))]) == 2
        assert "; it looks like latitude and longitude; expected metres" in capsys.readouterr().err
