"""Checks of commands, as the ground asks for them, and what it offers instead of what is refused."""

from __future__ import annotations

from math import dist

import pytest
from msgspec.structs import replace

from companion.config.fleet import GeodeticOrigin
from companion.ground.answers import AnswerKind, Outcome, accepted_instead, instead_lines
from companion.ground.changes import FleetAction, FormationRequest, ReferenceRequest
from companion.ground.commands import OperatorCommands
from companion.types.commands import CommandName, Content, Described, ReferenceChange
from companion.types.flight import FlightPhase
from companion.types.formation import FormationChange
from companion.types.notices import Accepts, Code, Notice
from ground_fleet import DirectedVehicles
from one_agent import FLEET

C = CommandName
LINE = FormationRequest("line", None, 200.0, 0.0, 1.0)
AT = [47.397755, 8.545594, 3.0]
IN_DEGREES = {1: (47.397755, 8.545594, 0.0), 2: (8.0, 4.0, 0.0)}
WAYPOINTS: Described = {"kind": "waypoints", "max_speed_m_s": 2.0, "max_acceleration_m_s2": 1.0}


def checked(vehicles: DirectedVehicles, action: FleetAction) -> dict[int, AnswerKind]:
    sent = OperatorCommands(vehicles, FLEET, 1.0).check(action)
    assert vehicles.received == []  # no command
    return {i: outcome.kind for i, outcome in sent.outcomes.items()}


def refused(*accepts: Accepts) -> dict[int, Outcome]:
    notices = [Notice(Code.SLOT_OUTSIDE_FENCE, "too far", one) for one in accepts]
    return {i: Outcome(AnswerKind.REFUSED, notice) for i, notice in enumerate(notices, 1)}


def test_arm_is_checked_as_far_as_the_first_step_of_each_vehicle() -> None:
    vehicles = DirectedVehicles()
    vehicles.change(2, phase=FlightPhase.READY)
    assert set(checked(vehicles, FleetAction("arm")).values()) == {AnswerKind.ACCEPTED}
    assert vehicles.checked == [(C.PREPARE, (1,), None), (C.ARM, (2,), None)]


def test_every_vehicle_answers_for_itself_also_where_the_command_is_for_all_or_none() -> None:
    vehicles = DirectedVehicles()
    vehicles.refuses[(2, C.TAKEOFF)] = ["not in phase armed"]
    assert checked(vehicles, FleetAction("takeoff")) == {1: AnswerKind.ACCEPTED, 2: AnswerKind.REFUSED}
    vehicles.mute.add(1)
    assert checked(vehicles, FleetAction("land", only=(1,))) == {1: AnswerKind.MISSING}


def test_a_formation_is_checked_with_the_slots_that_would_be_sent() -> None:
    vehicles = DirectedVehicles()
    assert set(checked(vehicles, FleetAction("formation", formation=LINE)).values()) == {AnswerKind.ACCEPTED}
    ((name, ids, content),) = vehicles.checked
    assert (name, ids) == (C.FORMATION, (1, 2))
    assert isinstance(content, FormationChange)
    (_, one), (_, other) = content.slots_enu_m
    assert dist(one, other) == pytest.approx(200.0)


@pytest.mark.parametrize(
    ("action", "named"),
    [
        (FleetAction("formation", formation=FormationRequest(None, None, None, 0.0, 1.0, IN_DEGREES)), "slots_enu_m"),
        (FleetAction("reference", reference=ReferenceRequest(None, {"kind": "point"}, (AT,))), "reference.point_enu_m"),
        (FleetAction("formation", formation=LINE), ""),
    ],
)
def test_places_in_degrees_are_a_warning_beside_the_answers(action: FleetAction, named: str) -> None:
    fleet = replace(FLEET, origin=GeodeticOrigin(latitude_deg=47.3977, longitude_deg=8.5456, altitude_amsl_m=488.0))
    sent = OperatorCommands(DirectedVehicles(), fleet, 1.0).check(action)
    assert set(sent.outcomes) >= {1}
    assert [notice.code for notice in sent.warnings] == ([Code.LOOKS_LIKE_DEGREES] if named else [])
    assert all(notice.text.startswith(named) for notice in sent.warnings)


@pytest.mark.parametrize(
    ("action", "content", "outcomes", "instead", "options"),
    [
        (
            FleetAction("formation", formation=LINE),
            None,
            refused((("scale", 0.4),), (("scale", 0.3077),)),
            {"spacing_m": 61.54},
            "--spacing 61.54",
        ),
        (
            FleetAction("formation", formation=FormationRequest(None, None, None, 0.0, 3.0)),
            None,
            refused((("scale", 0.5),)),
            {"scale": 1.5},
            "--scale 1.5",
        ),
        (
            FleetAction("reference"),
            ReferenceChange(1, WAYPOINTS, 3.0),
            refused(
                (("max_speed_m_s", 1.5), ("max_acceleration_m_s2", 0.57)),
                (("max_speed_m_s", 1.4), ("max_acceleration_m_s2", 0.6)),
            ),
            {"max_speed_m_s": 1.4, "max_acceleration_m_s2": 0.57},
            "--speed 1.4 --acceleration 0.57",
        ),
        (FleetAction("formation", formation=LINE), None, refused((("scale", 0.4),), ()), {}, ""),
        (FleetAction("takeoff"), None, refused(()), {}, ""),
    ],
)
def test_what_all_vehicles_would_accept_is_offered(
    action: FleetAction, content: Content | None, outcomes: dict[int, Outcome], instead: dict[str, float], options: str
) -> None:
    assert accepted_instead(action, content, outcomes) == instead
    assert instead_lines(instead) == ([f"accepted would be {options}"] if options else [])
