"""A second agent with an id of the fleet, as a whole agent takes it: no flight begins, one that flies goes on."""

from __future__ import annotations

import pytest

from common import with_fields
from companion.core.safety.failsafe import DUPLICATE_FOR_S
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, HealthFlag
from companion.types.notices import Code
from companion.types.peers import ReceivedPeerPacket
from one_agent import AgentFlight

OWN_ID, PEER_ID = 2, 1
GROUND_COMMANDS = (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF, CommandName.FORM)


class Doubled(AgentFlight):
    """A flight beside which a second agent sends under `double_id`: valid packets from another place, in another session."""

    double_id: int | None = None

    def peer(self) -> list[ReceivedPeerPacket]:
        received = super().peer()
        if self.double_id is not None:
            packet = received[0].packet
            double = with_fields(packet, vehicle_id=self.double_id, session=99, position_enu_m=(0.3, 0.0, 1.0))
            received.append(ReceivedPeerPacket(self.now_s, double))
        return received

    def flags(self) -> tuple[HealthFlag, ...]:
        """Those of the newest status within half a second."""
        statuses = [status for _ in range(25) if (status := self.tick().status)]
        return statuses[-1].safety.flags


@pytest.mark.parametrize("double_id", [OWN_ID, PEER_ID], ids=["own id", "id of a peer"])
@pytest.mark.parametrize("name", GROUND_COMMANDS)
def test_no_flight_begins_beside_a_double_and_seconds_after_it_one_does(double_id: int, name: CommandName) -> None:
    flight = Doubled()
    before = {
        CommandName.PREPARE: FlightPhase.OBSERVE,
        CommandName.ARM: FlightPhase.READY,
        CommandName.TAKEOFF: FlightPhase.ARMED,
        CommandName.FORM: FlightPhase.HOLD,
    }[name]
    flight.fly_to(before)
    flight.double_id = double_id
    assert HealthFlag.DUPLICATE_ID in flight.flags()
    (reply,) = flight.tick(name).replies
    assert not reply.accepted
    assert "two agents use the same vehicle id" in reply.reason
    flight.double_id = None
    for _ in range(round(DUPLICATE_FOR_S / 0.02) + 10):
        flight.tick()
    (reply,) = flight.tick(name).replies
    assert reply.accepted, reply


@pytest.mark.parametrize("double_id", [OWN_ID, PEER_ID], ids=["own id", "id of a peer"])
def test_a_formation_goes_on_beside_a_double_with_one_warning(double_id: int) -> None:
    flight = Doubled()
    flight.fly_to(FlightPhase.FORMATION)
    for _ in range(100):
        flight.tick()
    flight.events.clear()
    before, flight.double_id = flight.targets[-1], double_id
    sent = len(flight.targets)
    for _ in range(200):
        flight.tick()
    assert flight.agent.phase is FlightPhase.FORMATION
    assert len(flight.targets) == sent + 200
    assert [event.code for event in flight.events] == [Code.DUPLICATE_ID]
    after = flight.targets[-1]
    assert (after.roll_rad, after.pitch_rad) == pytest.approx((before.roll_rad, before.pitch_rad), abs=0.02)
    flight.double_id = None
    for _ in range(round(DUPLICATE_FOR_S / 0.02)):
        flight.tick()
    assert HealthFlag.DUPLICATE_ID not in flight.flags()
