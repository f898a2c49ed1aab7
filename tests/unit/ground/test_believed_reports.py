"""What one vehicle reports, however senseless, prevents no command to the others."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common import ROOT, with_fields
from companion.config.fleet_check import load_fleet
from companion.ground.changes import FleetAction, FormationRequest, ReferenceRequest, believed, fleet_time_s
from companion.ground.commands import OperatorCommands
from companion.types.commands import Command, CommandName
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot, Heading, HeldReference
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
    (one,) = believed([liar], FLEET)
    assert max(map(abs, (*one.motion.position_enu_m, *one.formation.slot.position_enu_m))) <= 20_000.0
    if liar == one and action is not LINE:
        return  # a slot that is possible and wrong: the vehicles refuse it, with the reason
    command = sent_content(action, liar)
    assert command.name in (CommandName.FORMATION, CommandName.REFERENCE)


@given(anything)
def test_a_time_that_nobody_shares_is_not_the_fleet_time(reference_s: float) -> None:
    others = [in_formation(1), with_fields(in_formation(2), reference_s=AT_S - 0.3)]
    assert fleet_time_s([*others, with_fields(in_formation(2), reference_s=reference_s)]) == pytest.approx(
        AT_S, abs=5.0
    )
    assert fleet_time_s(believed([in_formation(1), in_formation(2, reference_s=1e300)], FLEET)) == AT_S


def test_a_leader_alone_in_formation_has_the_time_of_the_fleet() -> None:
    waiting = with_fields(in_formation(2), phase=FlightPhase.HOLD, reference_s=0.0)
    assert fleet_time_s([in_formation(1), waiting, waiting]) == AT_S
    assert fleet_time_s([waiting, waiting]) == 0.0
