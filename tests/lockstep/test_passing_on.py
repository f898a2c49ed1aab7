"""A formation that was commanded to some alone: the leader passes it on, to those that fly, that stand and that start anew."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.assembly import build_agent
from companion.config.vehicle import AgentConfig
from companion.ground.formations import change_to
from companion.types import CommandName, FormationChange, PeerPacket, Status, Vector3
from sitl.director import Director
from sitl.fleet import ids_of, reached_stand_in, vehicle_file
from sitl.lockstep import Lockstep
from sitl.progress import Progress
from sitl.scenario import load_scenario
from sitl.watch import FlightWatch

SCENARIO = Path(__file__).parents[2] / "config" / "scenarios" / "formations.yaml"
ALL = range(1, 9)
WIDER: dict[int, Vector3] = {i: (-2.5 * (i - 1), 0.0, 0.0) for i in ALL}


class Flight:
    """The fleet of eight in formation, and all that its vehicles say from then on."""

    def __init__(self, *overrides: str) -> None:
        self.scenario = load_scenario(SCENARIO, ["stand_in.sensors=ideal", *overrides])
        self.lockstep = Lockstep(self.scenario)
        watch = FlightWatch(ids_of(self.scenario), [1], 0.0)
        director = Director(self.lockstep, watch, Progress("test", True, 0.0), lambda: None, tuple, self.lockstep)
        director.fly(self.scenario.timeline[:4])
        self.newest: dict[int, Status] = {}
        self.events: list[tuple[int, str]] = []
        self.packets: list[PeerPacket] = []
        send = self.lockstep._network.send

        def sent(packet: PeerPacket, now_s: float) -> None:
            self.packets.append(packet)
            send(packet, now_s)

        self.lockstep._network.send = sent  # type: ignore[method-assign]
        self.go_on(0.5)

    def go_on(self, seconds: float) -> None:
        self.lockstep.sleep(seconds)
        for report in self.lockstep.drain():
            self.newest[report.status.vehicle_id] = report.status
            self.events.append((report.status.vehicle_id, report.status.last_event))

    def give(self, name: CommandName, *ids: int, content: FormationChange | None = None) -> None:
        replies = self.lockstep.command(ids or ALL, name, 1.0, content)
        assert all(reply and reply.accepted for reply in replies.values()), replies

    def restart(self, vehicle_id: int) -> None:
        member = self.scenario.fleet.member(vehicle_id)
        assert member is not None
        file = vehicle_file(self.scenario, reached_stand_in(self.scenario, vehicle_id, port_offset=0), port_offset=0)
        agent = build_agent(AgentConfig(file, self.scenario.fleet, member), session=2)
        self.lockstep._vehicles[vehicle_id]._agent = agent

    def wider(self) -> FormationChange:
        return change_to(WIDER, list(self.newest.values()), 1.0)


@pytest.mark.parametrize("overrides", [(), ("links.peer_loss=0.1", "links.peer_delay_s=0.05")])
def test_what_the_leader_alone_was_told_all_fly(overrides: tuple[str, ...]) -> None:
    flight = Flight(*overrides)
    flight.give(CommandName.FORMATION, 1, content=flight.wider())
    flight.go_on(0.8)
    assert {status.slot.waiting for status in flight.newest.values()} == {1}
    flight.go_on(14.0)
    assert {i: status.slot.position_enu_m for i, status in flight.newest.items()} == WIDER
    flight.packets.clear()
    flight.go_on(1.0)
    assert flight.packets
    assert not any(packet.change for packet in flight.packets)  # nobody lacks it any more


def test_what_the_leader_was_not_told_nobody_flies() -> None:
    flight = Flight()
    flight.give(CommandName.FORMATION, *range(2, 9), content=flight.wider())
    flight.go_on(2.0)
    assert {status.slot.formation for status in flight.newest.values()} == {0}
    assert (5, "formation 1 does not begin: vehicle 1 does not have it") in flight.events


def test_who_landed_meanwhile_and_whose_agent_started_anew_gets_it_on_the_ground() -> None:
    flight = Flight()
    flight.give(CommandName.LAND, 8)
    flight.go_on(15.0)
    assert not flight.newest[8].armed
    change = flight.wider()
    flight.give(CommandName.FORMATION, *range(1, 8), content=change)
    flight.go_on(14.0)
    assert {status.slot.formation for status in flight.newest.values()} == {1}
    assert flight.newest[8].slot.position_enu_m == WIDER[8]
    assert (8, "passed on by vehicle 1: formation 1, which the others fly") in flight.events

    in_order = flight.lockstep._in_order
    flight.lockstep._in_order = in_order[:7]
    flight.go_on(1.0)
    flight.restart(8)
    flight.lockstep._in_order = in_order
    flight.newest.clear()
    flight.go_on(1.0)
    assert flight.newest[8].slot.position_enu_m == WIDER[8]
