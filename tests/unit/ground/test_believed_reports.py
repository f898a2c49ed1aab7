"""What one vehicle reports, however senseless, prevents no command to the others."""

from __future__ import annotations

from math import dist
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common import ROOT, with_fields
from companion.config.fleet_check import load_fleet
from companion.core.formation.limits import FormationLimits
from companion.ground.belief import believed, doubts_of
from companion.ground.changes import (
    FleetAction,
    FormationRequest,
    ReferenceRequest,
    change_to,
    fleet_time_s,
    flown_reference_enu_m,
)
from companion.ground.commands import OperatorCommands
from companion.types.commands import Command, CommandName
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange, Heading, HeldReference, LeaderBeacon
from companion.types.notices import Code
from companion.types.status import Status
from companion.types.values import MAX_NUMBER
from companion.wire.messages import decode_command, encode
from ground_fleet import DirectedVehicles, reported

FLEET = load_fleet(Path(ROOT / "config/fleets/pair.yaml"))
AT_S = 120.0
LINE = FleetAction("formation", formation=FormationRequest("line", None, 4.0, 0.0, 1.0))
SCALED = FleetAction("formation", formation=FormationRequest(None, None, None, 0.0, 1.5))
POINT = FleetAction("reference", reference=ReferenceRequest(None, {"kind": "point"}, ([0.0, 0.0, 4.0],)))
anything = st.floats(allow_nan=False, allow_infinity=False) | st.sampled_from([1e300, -1e300, 1e6, -1.0])
vector = st.tuples(anything, anything, anything)


def in_formation(vehicle_id: int, **changes: object) -> Status:
    slot = next(member.slot_enu_m for member in FLEET.vehicles if member.id == vehicle_id)
    flown = {"slot": FlownSlot(slot), "reference_s": AT_S, "reference": HeldReference()}
    return with_fields(reported(vehicle_id, phase=FlightPhase.FORMATION), **(flown | changes))


def sent_content(action: FleetAction, liar: Status) -> Command:
    """What the fleet is sent for this action while vehicle 2 reports so, as each vehicle decodes it."""
    vehicles = DirectedVehicles()
    vehicles.statuses = {1: in_formation(1), 2: liar}
    sent = OperatorCommands(vehicles, FLEET, 1.0).send(action)
    assert 1 in sent.outcomes
    return decode_command(encode(Command(sent.name, 1, "anna@ground", 1, sent.content)))


@given(vector, vector, vector, anything, st.integers(0, MAX_NUMBER))
@pytest.mark.parametrize("action", [LINE, SCALED, POINT])
def test_no_report_prevents_a_formation_or_a_reference(
    action: FleetAction, position: tuple, slot: tuple, reference: tuple, angle_rad: float, number: int
) -> None:
    liar = in_formation(
        2,
        position_enu_m=position,
        slot=FlownSlot(slot, formation=number, waiting=number),
        reference_enu_m=reference,
        heading=Heading(angle_rad),
        reference=HeldReference(number, number),
    )
    (_, one), doubts, unsure, _ = believed([in_formation(1), liar], FLEET)
    assert max(map(abs, one.formation.slot.position_enu_m)) <= 200.0
    assert one.motion.is_known is not any(doubt.field == "position_enu_m" for doubt in doubts)
    if not doubts and not unsure and action is not LINE:
        return  # a slot of the formation that all fly, possible and wrong: the vehicles refuse it, with the reason
    command = sent_content(action, liar)
    assert command.name in (CommandName.FORMATION, CommandName.REFERENCE)


@given(anything)
def test_a_time_that_nobody_shares_is_not_the_fleet_time(reference_s: float) -> None:
    others = [in_formation(1), with_fields(in_formation(2), reference_s=AT_S - 0.3)]
    assert fleet_time_s([*others, with_fields(in_formation(2), reference_s=reference_s)]) == pytest.approx(
        AT_S, abs=5.0
    )
    assert fleet_time_s(believed([in_formation(1), in_formation(2, reference_s=1e300)], FLEET).statuses) == AT_S


def test_a_leader_alone_in_formation_has_the_time_of_the_fleet() -> None:
    waiting = with_fields(in_formation(2), phase=FlightPhase.HOLD, reference_s=0.0)
    assert fleet_time_s([in_formation(1), waiting, waiting]) == AT_S
    assert fleet_time_s([waiting, waiting]) == 0.0


def test_while_none_is_in_formation_the_latest_time_is_in_time_for_all() -> None:
    """Each vehicle has stopped at another time: one flew on without its leader, one has started again."""
    stopped = [with_fields(in_formation(2), phase=FlightPhase.HOLD, reference_s=t) for t in (4.7, 4.6, 0.0)]
    flew_on = with_fields(in_formation(2), phase=FlightPhase.HOLD, reference_s=10.6)
    assert fleet_time_s([*stopped, flew_on]) == 10.6
    senseless = with_fields(in_formation(2), phase=FlightPhase.HOLD, reference_s=55.0)
    assert fleet_time_s([*stopped, senseless]) == 4.7


FENCE = ((-50.0, -50.0, -2.0), (50.0, 50.0, 20.0))
FAR = (5000.0, 0.0, 2.5)  # beyond the fence of 100 m, and nearer than what a packet may have


@pytest.mark.parametrize(
    ("lie", "field", "found", "expected"),
    [
        (
            {"position_enu_m": FAR},
            "position_enu_m",
            "5000, 0, 2.5 m",
            "x, y, z of -191 to 191, -191 to 191, -143 to 161 m",
        ),
        ({"position_enu_m": (0.0, 0.0, 300.0)}, "position_enu_m", "0, 0, 300 m", "by the fence"),
        ({"slot": FlownSlot((0.0, -900.0, 0.0))}, "slot", "0, -900, 0 m", "at most 141 m from the reference"),
        ({"slot": FlownSlot((0.0, 0.0, 30.0), formation=3, waiting=3)}, "slot", "0, 0, 30 m", "and 22 m in height"),
        (
            {"slot": FlownSlot((-2.0, 0.0, 0.0))},
            "slot",
            "-2, 0, 0 m",
            "-3, 0, 0 m as in the fleet file, in formation 0",
        ),
        (
            {"slot": FlownSlot((0.0, 0.5, 0.0), formation=3, waiting=3)},
            *("slot", "0, 0.5, 0 m", "one that is free in formation 0, which the others fly"),
        ),
        ({"reference_enu_m": FAR}, "reference_enu_m", "5000, 0, 2.5 m", "by the fence"),
        ({"reference_s": -3.0}, "reference_s", "-3 s", "0 to "),
        ({"reference_s": 4000.0}, "reference_s", "4000 s", "about 120 s, as the others in formation report"),
    ],
)
@pytest.mark.parametrize("action", [LINE, SCALED, POINT])
def test_one_senseless_value_is_named_and_costs_only_its_vehicle(
    action: FleetAction, lie: dict[str, object], field: str, found: str, expected: str
) -> None:
    vehicles = DirectedVehicles()
    vehicles.statuses = {1: leads(), 2: in_formation(2, **lie)}
    sent = OperatorCommands(vehicles, FLEET, 1.0).send(action)
    (doubt,) = sent.doubts
    assert (doubt.vehicle_id, doubt.field, doubt.found) == (2, field, found)
    assert expected in doubt.expected
    assert str(doubt) == f"vehicle 2 reports {field} {found}; expected {doubt.expected}: it is not believed"
    assert doubt.notice.code is Code.REPORT_IMPLAUSIBLE
    assert 1 in sent.outcomes
    if isinstance(sent.content, FormationChange):
        assert sent.content.absent == ()
        assert sent.content.begins_s == pytest.approx(AT_S + 1.0)
        slots = dict(sent.content.slots_enu_m)
        assert dist(slots[1], slots[2]) >= FLEET.separation_m


def leads(**changes: object) -> Status:
    beacon = LeaderBeacon(1, 0, 1, AT_S)
    return with_fields(
        in_formation(1), **{"role": Role.LEADER, "reference_enu_m": (1.0, 2.0, 3.0), "leader_beacon": beacon} | changes
    )


def test_honest_reports_raise_no_doubt() -> None:
    joining = in_formation(2, slot=FlownSlot((-9.0, 3.0, 0.0), (1.0, 0.0, 0.0), moves_for_s=4.0))
    outside = with_fields(in_formation(2), position_enu_m=(-80.0, 0.0, 1.0))  # of a small fence, by its pilot
    unplaced = with_fields(in_formation(2), position_enu_m=FAR, state_age_s=1e6)  # zeros, or anything: there is none
    for status in (in_formation(2), joining, outside, unplaced):
        assert doubts_of([leads(), status], FLEET) == ()


def test_a_change_lasts_long_enough_for_a_slot_that_is_not_known() -> None:
    """The others know where it flies; with a shorter change they would refuse it as too fast."""
    slots = {1: (0.0, 0.0, 0.0), 2: (-3.0, 0.0, 0.0)}
    known = [leads(slot=FlownSlot((0.0, 0.0, 0.0), formation=4, waiting=4)), in_formation(2)]
    statuses, _, unsure, reach_m = believed(known, FLEET)
    assert unsure == {2}  # of formation 0, while the other flies formation 4
    joining = [leads(), in_formation(2, slot=FlownSlot((-1.5, 0.0, 0.0), moves_for_s=3.0))]
    far = {1: (0.0, 0.0, 0.0), 2: (2.0, 0.0, 0.0)}  # 5 m from the slot that the leader knows, 3.5 m from where it is
    refusal = FormationLimits(1.0, 1.0, FENCE).refusal_of_change({1: far[1], 2: (-3.0, 0.0, 0.0)}, far, 1.0)
    assert refusal is not None
    assert refusal.code is Code.SLOT_TOO_FAST
    lasts_s = change_to(far, joining, 1.0, believed(joining, FLEET).reach_m).lasts_s
    assert FormationLimits(1.0, 1.0, FENCE).refusal_of_change({1: far[1], 2: (-3.0, 0.0, 0.0)}, far, lasts_s) is None
    wide = {i: (10.0 * x, y, z) for i, (x, y, z) in slots.items()}
    assert change_to(slots, statuses, 1.0, reach_m).lasts_s > change_to(slots, statuses, 1.0).lasts_s
    assert change_to(wide, statuses, 1.0, reach_m).lasts_s > change_to(wide, statuses, 1.0).lasts_s


@pytest.mark.parametrize("action", [SCALED, POINT])
def test_a_slot_that_never_stops_moving_prevents_nothing(action: FleetAction) -> None:
    """It is where vehicle 1 flies, and 40 m aside, where the reference would bring it outside the fence."""
    for slot in ((0.1, 0.0, 0.0), (0.0, 49.0, 0.0)):
        vehicles = DirectedVehicles()
        vehicles.statuses = {1: leads(), 2: in_formation(2, slot=FlownSlot(slot, moves_for_s=60.0))}
        sent = OperatorCommands(vehicles, FLEET, 1.0).send(action)
        assert 1 in sent.outcomes
        if isinstance(sent.content, FormationChange):
            one, two = dict(sent.content.slots_enu_m).values()
            assert dist(one, two) >= FLEET.separation_m


def test_the_reference_is_that_of_the_leader_that_vehicles_follow() -> None:
    liar = with_fields(in_formation(2), reference_enu_m=(40.0, 0.0, 2.0), role=Role.LEADER)
    follower = with_fields(in_formation(2), leader_beacon=LeaderBeacon(1, 0, 1, AT_S))
    assert flown_reference_enu_m([liar, leads(), follower]) == (1.0, 2.0, 3.0)
    assert flown_reference_enu_m([follower]) is None
