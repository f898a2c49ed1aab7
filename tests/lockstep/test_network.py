"""The simulated network between agents: receivers, delay, loss and jitter of packets."""

from math import pi
from typing import Any, Literal

import pytest

from common import with_fields
from companion.types.autopilot import PositionError
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, Heading, LeaderBeacon
from companion.types.peers import LeaderReport, LostVehicle, Motion, PeerPacket, Sender
from companion.types.values import ZERO3
from sitl.links.network import Network
from sitl.vehicle.config import Links, Partition
from sitl.vehicle.lies import Lie


def packet(vehicle_id: int, sequence: int) -> PeerPacket:
    return PeerPacket(
        sender=Sender(vehicle_id=vehicle_id, session=1, sequence=sequence, formation_hash=7),
        phase=FlightPhase.FORMATION,
        role=Role.FOLLOWER,
        motion=Motion(
            position_enu_m=ZERO3, velocity_enu_m_s=ZERO3, acceleration_enu_m_s2=ZERO3, state_age_s=0.0, sent_s=0.0
        ),
        leader=LeaderReport(prc=2, beacon=None),
        slot=FlownSlot(ZERO3),
    )


def sequences(network: Network, receiver: int, now_s: float) -> list[int]:
    return [received.packet.sender.sequence for received in network.receive(receiver, now_s)]


def received(links: Links, seed: int, packets: int = 2000) -> list[tuple[int, ...]]:
    """Sequence numbers that vehicles 2 and 3 receive from vehicle 1, tick by tick."""
    network = Network([1, 2, 3], links, seed)
    ticks = []
    for number in range(packets):
        now_s = number * 0.02
        network.send(packet(1, number), now_s)
        ticks += [tuple(sequences(network, receiver, now_s)) for receiver in (2, 3)]
    return ticks


def test_all_other_agents_receive_a_packet_once_after_its_delay() -> None:
    network = Network([1, 2, 3], Links(peer_delay_s=0.1), 1)
    network.send(packet(1, 5), 1.0)
    assert sequences(network, 2, 1.09) == []
    assert sequences(network, 2, 1.11) == [5]
    assert sequences(network, 2, 1.2) == []
    assert sequences(network, 3, 1.2) == [5]
    assert sequences(network, 1, 9.0) == []


def test_agents_with_the_same_phase_receive_packets_in_the_next_tick() -> None:
    """This also holds without delay; otherwise the order of the agents would matter."""
    network = Network([1, 2], Links(peer_delay_s=0.0), 1)
    network.send(packet(1, 1), 1.0)
    assert sequences(network, 2, 1.0) == []
    assert sequences(network, 2, 1.02) == [1]


def test_distant_peers_are_received_at_5_hz_and_the_others_at_50_hz() -> None:
    network = Network([1, 2, 3], Links(peer_delay_s=0.0), 1)
    network.set_low_rate_peers(2, [1], 0.5)
    counts = {2: 0, 3: 0}
    for number in range(100):
        now_s = 1.0 + number * 0.02
        network.send(packet(1, number), now_s)
        for receiver in counts:
            counts[receiver] += len(sequences(network, receiver, now_s + 0.01))
    assert counts == {2: 10, 3: 100}
    network.set_low_rate_peers(2, [], 3.0)
    network.send(packet(1, 101), 3.0)
    network.send(packet(1, 102), 3.2)
    assert sequences(network, 2, 3.3) == [102]


def test_the_time_of_polling_is_the_time_of_receipt() -> None:
    network = Network([1, 2], Links(), 1)
    network.send(packet(1, 1), 1.0)
    (received,) = network.receive(2, 1.019)
    assert received.received_s == 1.019


def test_loss_has_the_configured_rate_and_is_independent_for_each_link() -> None:
    ticks = received(Links(peer_loss=0.1), seed=1)
    to_2, to_3 = ticks[::2], ticks[1::2]
    for way in (to_2, to_3):
        assert sum(map(len, way)) == pytest.approx(1800, abs=60)
    assert to_2 != to_3


def test_the_same_seed_loses_the_same_packets() -> None:
    links = Links(peer_loss=0.1, peer_delay_s=0.1, peer_jitter_s=0.03)
    assert received(links, seed=4) == received(links, seed=4)
    assert received(links, seed=4) != received(links, seed=5)


def test_jitter_can_reorder_packets() -> None:
    arrived = [number for tick in received(Links(peer_jitter_s=0.1), seed=1)[::2] for number in tick]
    assert arrived != sorted(arrived)
    assert len(arrived) > 1990


def test_duplicates_arrive_twice_at_the_configured_rate() -> None:
    arrived = [number for tick in received(Links(peer_duplicates=0.2), seed=1)[::2] for number in tick]
    assert len(arrived) == pytest.approx(2400, abs=60)
    assert set(arrived) >= set(range(1999))


def test_a_loss_of_one_loses_all_packets() -> None:
    assert not any(received(Links(peer_loss=1.0), seed=1))


@pytest.mark.parametrize(
    ("lost", "to_2", "to_3", "to_1"),
    [("both", False, False, False), ("received", True, True, False), ("sent", False, False, True)],
)
def test_a_partition_loses_the_packets_of_its_direction_until_it_ends(
    lost: Literal["both", "received", "sent"], to_2: bool, to_3: bool, to_1: bool
) -> None:
    network = Network([1, 2, 3], Links(partitions=(Partition((1,), from_s=1.0, until_s=2.0, lost=lost),)), 1)

    def arrive(number: int, now_s: float) -> list[bool]:
        for sender in (1, 2):
            network.send(packet(sender, number), now_s)
        to_3_from_2 = [received.packet.sender.vehicle_id for received in network.receive(3, now_s + 0.02)]
        assert 2 in to_3_from_2  # on one side
        return [bool(sequences(network, 2, now_s + 0.02)), 1 in to_3_from_2, bool(sequences(network, 1, now_s + 0.02))]

    assert arrive(1, 0.98) == [True, True, True]
    assert arrive(2, 1.0) == [to_2, to_3, to_1]
    assert arrive(3, 1.98) == [to_2, to_3, to_1]
    assert arrive(4, 2.0) == [True, True, True]


def test_a_lying_vehicle_states_another_position_for_a_time() -> None:
    links = Links(lies=(Lie(vehicle=1, by_enu=(0.0, 1.0, 0.0), from_s=1.0, until_s=2.0),))
    network = Network([1, 2], links, seed=1)
    stated = []
    for now_s in (0.5, 1.5, 2.5):
        network.send(packet(1, 1), now_s)
        network.send(packet(2, 1), now_s)
        stated += [one.packet.motion.position_enu_m for i in (2, 1) for one in network.receive(i, now_s + 0.1)]
    assert stated == [ZERO3, ZERO3, (0.0, 1.0, 0.0), ZERO3, ZERO3, ZERO3]


def test_a_false_position_that_grows_states_a_velocity_that_agrees() -> None:
    lie = Lie(vehicle=1, kind="drift", by_enu=(0.0, 2.0, 0.0), from_s=1.0, over_s=4.0)
    network = Network([1, 2], Links(lies=(lie,)), seed=1)
    stated = []
    for now_s in (0.5, 3.0, 6.0):
        network.send(packet(1, 1), now_s)
        (one,) = network.receive(2, now_s + 0.1)
        stated.append((one.packet.motion.position_enu_m, one.packet.motion.velocity_enu_m_s))
    true_m_s = packet(1, 1).motion.velocity_enu_m_s
    drifts_m_s = (true_m_s[0], true_m_s[1] + 0.5, true_m_s[2])
    assert stated == [(ZERO3, true_m_s), ((0.0, 1.0, 0.0), drifts_m_s), ((0.0, 2.0, 0.0), true_m_s)]


LIES: dict[str, tuple[dict[str, Any], str, object]] = {
    "velocity": ({"kind": "jump", "by_enu": (1.0, 0.0, 0.0)}, "velocity_enu_m_s", (1.0, 0.0, 0.0)),
    "acceleration": ({"by_enu": (0.0, 3.0, 0.0)}, "acceleration_enu_m_s2", (0.0, 3.0, 0.0)),
    "slot": ({"by_enu": (0.0, 0.0, 4.0)}, "slot", FlownSlot((0.0, 0.0, 4.0))),
    "rft": ({"by_enu": (5.0, 0.0, 0.0)}, "rft", ((5.0, 0.0, 0.0), ZERO3, ZERO3)),
    "phase": ({"phase": FlightPhase.LAND}, "phase", FlightPhase.LAND),
    "disarmed": ({}, "armed", False),
    "prc": ({"by": 3.0}, "prc", 5),
    "epoch": ({"by": 7.0}, "beacon", LeaderBeacon(2, 7, 100)),
    "claim": ({"by": 1.0}, "beacon", LeaderBeacon(2, 0, 100, claim=1)),
    "stamp": ({"by": -500.0}, "beacon", LeaderBeacon(2, 0, 0)),
    "mission_time": ({"kind": "drift", "by": 4.0, "over_s": 2.0}, "beacon", LeaderBeacon(2, 0, 100, 3.0)),
    "heading": ({"by": 0.5}, "beacon", LeaderBeacon(2, 0, 100, heading=Heading(0.5))),
    "leader": ({}, "beacon", LeaderBeacon(1, 1, 100)),
    "sequence": ({"kind": "frozen"}, "sequence", 1),
    "age": ({"by": 0.25}, "state_age_s", 0.25),
    "sent": ({"by": -1.0}, "sent_s", 0.0),
    "error": ({"by": 5.0}, "position_error", PositionError(5.0, 5.0)),
    "formation": ({"by": 2.0}, "formation", 2),
    "lost": ({"other": 2, "by_enu": (1.0, 2.0, 3.0)}, "lost", (LostVehicle(2, (1.0, 2.0, 3.0), ZERO3, 5.0),)),
    "law_values": ({"by_enu": (0.0, 1.0, 0.0)}, "law_values", ((0.0, 1.0, 0.0),)),
}


@pytest.mark.parametrize("says", LIES)
def test_a_lie_states_one_thing_that_is_false_and_gives_no_signature_of_another_leader(says: str) -> None:
    keys, name, stated = LIES[says]
    network = Network([1, 2], Links(lies=(Lie(vehicle=1, says=says, from_s=0.5, **keys),)), seed=1)  # type: ignore[arg-type]
    true = with_fields(packet(1, 1), prc=2, beacon=LeaderBeacon(2, 0, 100), law_values=(ZERO3,))
    network.send(true, 0.5)
    network.send(with_fields(true, sequence=2), 2.0)
    last = network.receive(2, 3.0)[-1]
    parts = (last.packet, last.packet.sender, last.packet.motion, last.packet.leader, last.packet.slot)
    assert next(getattr(part, name) for part in parts if name in part.__struct_fields__) == stated
    assert last.proven is (says not in ("epoch", "claim"))


MOVES = {
    "swing": ((2.0, 0.0, 0.0), (1.0, pi, 0.0)),  # a whole period is over
    "mirror": ((-2.0, 0.0, 0.0), (-1.0, 0.0, 0.0)),
    "frozen": (ZERO3, (1.0, 0.0, 0.0)),
    "chase": ((10.0, 1.0, 0.0), ZERO3),
}


@pytest.mark.parametrize("kind", MOVES)
def test_a_false_position_moves_with_a_velocity_that_belongs_to_it(kind: str) -> None:
    """Vehicle 1 flies east at 1 m/s; vehicle 2, which it comes upon, hovers at (10, 0, 0)."""
    lie = Lie(vehicle=1, kind=kind, by_enu=(0.0, 1.0, 0.0), over_s=2.0, other=2, from_s=1.0)  # type: ignore[arg-type]
    network = Network([1, 2, 3], Links(lies=(lie,)), seed=1)
    resting = with_fields(packet(2, 1), position_enu_m=(10.0, 0.0, 0.0), velocity_enu_m_s=ZERO3)
    for number, now_s in enumerate((1.0, 2.0, 3.0), start=1):
        network.send(resting, now_s)
        at = (now_s - 1.0, 0.0, 0.0)
        network.send(with_fields(packet(1, number), position_enu_m=at, velocity_enu_m_s=(1.0, 0.0, 0.0)), now_s)
    motion = network.receive(3, 3.1)[-1].packet.motion
    position_enu_m, velocity_enu_m_s = MOVES[kind]
    assert motion.position_enu_m == pytest.approx(position_enu_m)
    assert motion.velocity_enu_m_s == pytest.approx(velocity_enu_m_s)
