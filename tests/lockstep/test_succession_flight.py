"""The ring on its figure 8 in virtual time, and in the middle of it the leader's agent dies."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from math import degrees, dist, hypot
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from companion.types import AttitudeTarget, CommandName, FlightPhase, HealthFlag, PeerPacket, Role, Status
from sitl.director import Director
from sitl.fleet import ids_of
from sitl.lockstep import Lockstep
from sitl.metrics import errors_m, reference_positions_m, standing
from sitl.progress import Progress
from sitl.scenario import load_scenario, reference_of
from sitl.watch import FlightWatch

RING = Path(__file__).parents[2] / "config" / "scenarios" / "ring_figure_8.yaml"
SUCCESSOR = "fleet.successors=[2]"
DIES_AFTER_S = 26.0  # in formation: where the eight is flown fastest, 0.5 m/s


@dataclass(frozen=True)
class Flown:
    """From the leader's death on; times count from it."""

    packets: list[tuple[float, PeerPacket]]
    targets: dict[int, list[AttitudeTarget]]
    errors_m: dict[int, np.ndarray]  # of each that is left to its slot about the RFT, every 20 ms
    told: list[Status]

    def noticed_s(self) -> dict[int, float]:
        return self._first(lambda packet: packet.leader_word is None)

    def led_s(self, by: int) -> dict[int, float]:
        return self._first(lambda packet: packet.leader_word is not None and packet.leader_word.leader_id == by)

    def steps_deg(self) -> list[float]:
        return [
            degrees(max(abs(after.roll_rad - before.roll_rad), abs(after.pitch_rad - before.pitch_rad)))
            for told in self.targets.values()
            for before, after in pairwise(told)
        ]

    def last(self) -> dict[int, Status]:
        return {status.vehicle_id: status for status in self.told}

    def _first(self, is_it) -> dict[int, float]:  # type: ignore[no-untyped-def]
        return {packet.vehicle_id: at_s for at_s, packet in reversed(self.packets) if is_it(packet)}


@cache
def flown(*overrides: str, dead: Iterable[int] = (1,), for_s: float = 5.0) -> Flown:
    scenario = load_scenario(RING, overrides)
    lockstep, watch = Lockstep(scenario), FlightWatch(ids_of(scenario), [1], 0.0)
    director = Director(lockstep, watch, Progress("test", True, 0.0), lambda: None, tuple, lockstep)
    director.fly([*scenario.timeline[:3], replace(scenario.timeline[3], for_s=DIES_AFTER_S)])
    died_s, packets, targets = lockstep.now_s(), [], {}
    send = lockstep._network.send

    def sent(packet: PeerPacket, now_s: float) -> None:
        packets.append((now_s - died_s, packet))
        send(packet, now_s)

    lockstep._network.send = sent  # type: ignore[method-assign]
    lockstep._in_order = [vehicle for vehicle in lockstep._in_order if vehicle.vehicle_id not in dead]
    for vehicle in lockstep._in_order:
        told, follow = targets.setdefault(vehicle.vehicle_id, []), vehicle.link.command

        def command(target, now_s, told=told, follow=follow):  # type: ignore[no-untyped-def]
            told.append(target)
            follow(target, now_s)

        vehicle.link.command = command  # type: ignore[method-assign]
    lockstep.sleep(for_s)
    assert watch.formation is not None
    times_s = np.arange(died_s, lockstep.now_s() - 0.1, 0.02)
    reference_enu_m = reference_positions_m(reference_of(scenario), watch.formation.reference_start_s, times_s)
    slots = standing({member.id: member.slot_enu_m for member in scenario.fleet.vehicles})
    tracks = {s.vehicle_id: s.track() for s in lockstep.stand_ins if s.vehicle_id not in dead}
    errors = {i: errors_m(track, slots[i], reference_enu_m, times_s) for i, track in tracks.items()}
    return Flown(packets, targets, errors, [report.status for report in lockstep.drain()])


def test_a_dead_leader_is_missed_within_0_3_s_and_replaced_within_0_6() -> None:
    flight = flown(SUCCESSOR, "fleet.law.name=cooperative")
    assert max(flight.noticed_s().values()) < 0.3
    assert flight.noticed_s().keys() == {2, 3, 4}
    assert flight.led_s(by=2).keys() == {2, 3, 4}
    assert max(flight.led_s(by=2).values()) < 0.65
    assert {(s.role, s.epoch, s.prc) for s in flight.last().values() if s.vehicle_id == 2} == {(Role.LEADER, 1, 1)}
    assert [flight.last()[i].prc for i in (2, 3, 4)] == [1, 2, 3]


def test_meanwhile_the_missing_leader_is_told_and_nobody_leaves_formation() -> None:
    flight = flown(SUCCESSOR, "fleet.law.name=cooperative")
    assert {status.phase for status in flight.told} == {FlightPhase.FORMATION}
    assert {flag for status in flight.told for flag in status.flags} == {HealthFlag.LEADER_AWAITED}
    assert "no leader's word: formation is held without" in {status.last_event for status in flight.told}
    assert not any(status.flags for status in flight.last().values())


def test_a_formation_that_turns_goes_on_turning_without_a_step() -> None:
    flight = flown(SUCCESSOR, "fleet.law.name=cooperative", "fleet.formation_heading=course")
    assert max(flight.led_s(by=2).values()) < 0.65
    assert max(flight.steps_deg()) < 2.0
    for i in (2, 3, 4):
        slots = [(at_s, packet.slot) for at_s, packet in flight.packets if packet.vehicle_id == i]
        assert max(hypot(*slot.velocity_enu_m_s) for _, slot in slots) > 0.1  # it does turn
        for (a_s, a), (b_s, b) in pairwise(slots):
            moved = [x + v * (b_s - a_s) for x, v in zip(a.position_enu_m, a.velocity_enu_m_s, strict=True)]
            assert dist(moved, b.position_enu_m) < 0.002


@pytest.mark.parametrize(("law", "most_m"), [("cooperative", 0.1), ("weighted", 0.5)])
def test_nobody_leaves_its_slot_nor_steps(law: str, most_m: float) -> None:
    """The weighted law is as far from it before: it follows what moves at a distance."""
    flight = flown(SUCCESSOR, f"fleet.law.name={law}")
    assert max(float(error_m.max()) for error_m in flight.errors_m.values()) < most_m
    assert max(flight.steps_deg()) < 3.0


@pytest.mark.parametrize("seed", [1, 2])
def test_so_it_is_over_a_slow_network_that_loses_a_tenth_with_noise(seed: int) -> None:
    links = ("links.peer_loss=0.1", "links.peer_delay_s=0.1")
    noise = ("stand_in.sensors=default", f"stand_in.seed={seed}")
    flight = flown(SUCCESSOR, "fleet.law.name=cooperative", *links, *noise)
    assert max(flight.led_s(by=2).values()) < 1.5
    assert {status.phase for status in flight.told} == {FlightPhase.FORMATION}
    assert max(float(error_m.max()) for error_m in flight.errors_m.values()) < 0.5
    assert max(flight.steps_deg()) < 5.0


def test_where_the_first_successor_dies_too_the_next_one_leads() -> None:
    third = ("fleet.vehicles[2].may_lead=true", "fleet.successors=[2,3]")
    flight = flown("fleet.law.name=cooperative", *third, dead=(1, 2))
    assert 0.8 < max(flight.led_s(by=3).values()) < 1.0
    assert max(float(error_m.max()) for error_m in flight.errors_m.values()) < 0.1
    assert flight.last()[4].prc == 2


def test_no_living_leader_is_missed_over_a_slow_network_that_loses_a_tenth() -> None:
    flight = flown(SUCCESSOR, "links.peer_loss=0.1", "links.peer_delay_s=0.1", dead=(), for_s=60.0)
    assert not flight.noticed_s()
    assert {status.epoch for status in flight.told} == {0}


def test_without_successors_all_hold_and_after_a_while_land() -> None:
    flight = flown("fleet.land_after_s=3", for_s=25.0)
    assert max(flight.noticed_s().values()) < 0.3
    events = {status.last_event for status in flight.told}
    assert "formation -> release (no leader's word)" in events
    assert "hold -> land (in hold for want of a leader, and none came)" in events
    assert {(status.phase, status.armed) for status in flight.last().values()} == {(FlightPhase.OBSERVE, False)}


def test_without_a_time_to_land_they_stay_in_hold() -> None:
    flight = flown(for_s=25.0)
    assert {(status.phase, status.armed) for status in flight.last().values()} == {(FlightPhase.HOLD, True)}


def test_what_a_command_sends_into_hold_does_not_land_by_itself() -> None:
    scenario = load_scenario(RING, ["fleet.land_after_s=1"])
    lockstep, watch = Lockstep(scenario), FlightWatch(ids_of(scenario), [1], 0.0)
    director = Director(lockstep, watch, Progress("test", True, 0.0), lambda: None, tuple, lockstep)
    director.fly(scenario.timeline[:3])
    assert all(reply and reply.accepted for reply in lockstep.command([2, 3], CommandName.HOLD, 1.0).values())
    lockstep._in_order = lockstep._in_order[1:3]
    lockstep.sleep(5.0)
    assert {report.status.phase for report in lockstep.drain()[-2:]} == {FlightPhase.HOLD}
