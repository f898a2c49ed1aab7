"""Positions and velocities of a sender that contradict each other: what is found, and what honest vehicles may do."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from math import cos, hypot, nan, sin
from random import Random
from typing import Any

import pytest

from common import AT_REST, with_fields
from companion.assembly import fleet_limits
from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember
from companion.config.law import LawSection
from companion.core.autopilot import LAG_S
from companion.core.consensus.coherence import Coherence, coherent
from companion.core.consensus.peers import FleetLimits, PeerTable
from companion.geometry.vectors import minus
from companion.types.flight import FlightPhase, Role
from companion.types.formation import LeaderBeacon
from companion.types.notices import Code
from companion.types.peers import ReceivedPeerPacket
from companion.types.values import ZERO3, Vector3
from stage_fleets import LIMITS, PX4_SIH, TICK_S, Drift

MOST_M_S2 = 9.4  # of the default envelope
State = tuple[Vector3, Vector3]
ONE = (FormationMember(1, Role.LEADER, ZERO3),)
SECOND = round(1.0 / TICK_S)


def found(
    states: Callable[[int], State],
    ticks: int,
    skipped: Callable[[int], bool] = lambda _: False,
    commanded: Callable[[int], Vector3 | None] = lambda _: None,
) -> list[Coherence]:
    """What is found after each state that arrives."""
    before, all_found = None, []
    for tick in range(ticks):
        if not skipped(tick):
            before = coherent(before, tick * TICK_S, *states(tick), commanded(tick), MOST_M_S2)
            all_found.append(before)
    return all_found


def in_turn(sign_every: int, m_s: float) -> Callable[[int], State]:
    return lambda tick: (ZERO3, (m_s if tick // sign_every % 2 else -m_s, 0.0, 0.0))


LIES: dict[str, Callable[[int], State]] = {
    "velocity in turn": in_turn(1, 11.9),
    "velocity changes each second": in_turn(SECOND, 11.9),
    "velocity without a motion": lambda _: (ZERO3, (0.0, 3.0, 0.0)),
    "motion without a velocity": lambda tick: ((0.0, 0.0, 2.5 * tick * TICK_S), ZERO3),
    "jumps of 3 m each second": lambda tick: ((3.0 * (tick // SECOND), 0.0, 0.0), ZERO3),
    "jumps to and fro": lambda tick: ((3.0 * (tick // SECOND % 2), 0.0, 0.0), ZERO3),
    "swings": lambda tick: (ZERO3, (6.0 * sin(6.0 * tick * TICK_S), 0.0, 0.0)),
}


@pytest.mark.parametrize("lie", LIES)
def test_what_contradicts_itself_is_found_and_stays_found(lie: str) -> None:
    results = found(LIES[lie], 8 * SECOND)
    assert all(result.contradicts for result in results[round(2.5 * SECOND) :])


@pytest.mark.parametrize("lie", ["velocity in turn", "velocity changes each second", "velocity without a motion"])
def test_a_false_velocity_is_found_within_some_tenths_of_a_second(lie: str) -> None:
    assert found(LIES[lie], SECOND)[-1].contradicts


def test_a_sender_that_agrees_with_itself_again_is_believed_after_some_seconds() -> None:
    lie = in_turn(1, 11.9)
    results = found(lambda tick: lie(tick) if tick < SECOND else (ZERO3, ZERO3), 5 * SECOND)
    assert results[SECOND].contradicts and results[2 * SECOND].contradicts
    assert not results[-1].contradicts


def test_the_velocity_by_the_positions_is_that_of_the_motion() -> None:
    results = found(lambda tick: ((2.0 * tick * TICK_S, 0.0, 0.0), (-9.0 if tick % 2 else 9.0, 0.0, 0.0)), 3 * SECOND)
    assert results[-1].moves_enu_m_s[0] == pytest.approx(2.0, abs=0.1)


def test_a_step_that_takes_no_time_by_the_senders_clock_is_a_step() -> None:
    first = coherent(None, 1.0, ZERO3, ZERO3, None, MOST_M_S2)
    again = coherent(first, 1.0, (3.0, 0.0, 0.0), ZERO3, None, MOST_M_S2)
    assert again.moves_enu_m_s == pytest.approx((6.0, 0.0, 0.0))


def circling(tick: int) -> State:
    """At 6 m/s with 6 m/s2."""
    at = tick * TICK_S
    return (6.0 * cos(at), 6.0 * sin(at), 0.0), (-6.0 * sin(at), 6.0 * cos(at), 0.0)


def jumping_once(tick: int) -> State:
    (x, y, z), velocity = circling(tick)
    return (x + (8.0 if tick >= 2 * SECOND else 0.0), y, z), velocity


def corrected(tick: int) -> State:
    """As ArduCopter after GPS is back: 3 m in 15 small steps within 3 s."""
    (x, y, z), velocity = circling(tick)
    return (x + 0.2 * min(15, max(0, tick - SECOND) // 10), y, z), velocity


def biased(tick: int) -> State:
    """As a stock EKF2 at worst."""
    position, (vx, vy, vz) = circling(tick)
    return position, (vx + 0.6, vy - 0.6, vz)


def braking(tick: int) -> State:
    """From 12 m/s with 9 m/s2."""
    at = min(tick * TICK_S, 12.0 / 9.0)
    return (12.0 * at - 4.5 * at * at, 0.0, 0.0), (12.0 - 9.0 * at, 0.0, 0.0)


@pytest.mark.parametrize("state", [circling, jumping_once, corrected, biased, braking])
@pytest.mark.parametrize("lost", [0.0, 0.3, 0.8])
def test_an_honest_vehicle_is_never_in_doubt(state: Callable[[int], State], lost: float) -> None:
    random = Random(1)
    for skips in (lambda _: random.random() < lost, lambda tick: tick % 10 != 0 if lost else False):  # or at 5 Hz
        assert not any(result.contradicts for result in found(state, 10 * SECOND, skips))


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_a_stock_estimator_is_far_from_doubt(seed: int) -> None:
    random = Random(seed)
    position = Drift(2.0 * PX4_SIH.position_sd_m, 5.0, random)
    velocity = Drift(2.0 * PX4_SIH.velocity_sd_m_s, 2.0, random)

    def state(tick: int) -> State:
        position.step()
        velocity.step()
        (x, y, z), (vx, vy, vz) = circling(tick)
        (dx, dy, dz), (ex, ey, ez) = position.value, velocity.value
        white = [random.gauss(0.0, 0.06) for _ in range(3)]
        return (x + dx, y + dy, z + dz), (vx + ex + white[0], vy + ey + white[1], vz + ez + white[2])

    assert not any(result.doubt_s > 0.2 for result in found(state, 60 * SECOND))


def towards_the_centre(tick: int) -> Vector3:
    """What `circling` takes."""
    at = tick * TICK_S
    return (-6.0 * cos(at), -6.0 * sin(at), 0.0)


@pytest.mark.parametrize("lost", [0.0, 0.3, 0.8])
@pytest.mark.parametrize("wrong", [(1.8, 0.0, 0.0), (-1.0, 1.0, 1.0)])
def test_who_flies_about_as_it_commands_is_never_in_doubt(lost: float, wrong: Vector3) -> None:
    def commanded(tick: int) -> Vector3:
        (x, y, z), (dx, dy, dz) = towards_the_centre(tick + round(LAG_S / TICK_S)), wrong
        return (x + dx, y + dy, z + dz)

    random = Random(1)
    results = found(circling, 10 * SECOND, lambda _: random.random() < lost, commanded)
    assert not any(result.doubt_s for result in results)


@pytest.mark.parametrize(
    "commanded",
    [
        lambda _: (4.5, 0.0, 0.0),
        lambda _: (0.0, 0.0, -200.0),
        lambda tick: (2.0 * 9.0 * (tick % (2 * SECOND) < SECOND) - 9.0, 0.0, 0.0),
    ],
)
def test_an_acceleration_that_is_not_flown_is_found_within_two_seconds(commanded: Callable[[int], Vector3]) -> None:
    results = found(lambda _: (ZERO3, ZERO3), 4 * SECOND, commanded=commanded)
    assert results[2 * SECOND].contradicts
    assert not results[SECOND // 2].contradicts


@pytest.mark.parametrize("afterwards", [ZERO3, None])
def test_who_flies_what_it_says_again_is_believed_after_some_seconds(afterwards: Vector3 | None) -> None:
    def commanded(tick: int) -> Vector3 | None:
        return (9.0, 0.0, 0.0) if tick < 2 * SECOND else afterwards

    results = found(lambda _: (ZERO3, ZERO3), 8 * SECOND, commanded=commanded)
    assert results[2 * SECOND - 1].contradicts
    assert not results[-1].contradicts


def test_a_mirrored_acceleration_is_found() -> None:
    mirrored = found(circling, 3 * SECOND, commanded=lambda tick: minus(ZERO3, towards_the_centre(tick)))
    assert mirrored[2 * SECOND].contradicts


def table_after(
    states: Callable[[int], State],
    ticks: int,
    commanded: Callable[[int], Vector3] = lambda _: ZERO3,
    limits: FleetLimits = LIMITS,
) -> tuple[PeerTable, float]:
    """A table of vehicle 1 that has received vehicle 2."""
    table = PeerTable(1, {1: True, 2: True}, 42, 0.3, limits, ())
    now_s = 100.0
    for tick in range(ticks):
        now_s += TICK_S
        position_enu_m, velocity_enu_m_s = states(tick)
        packet = with_fields(
            AT_REST,
            vehicle_id=2,
            sequence=tick,
            formation_hash=42,
            sent_s=now_s,
            position_enu_m=position_enu_m,
            velocity_enu_m_s=velocity_enu_m_s,
            acceleration_enu_m_s2=commanded(tick),
            phase=FlightPhase.FORMATION,
        )
        table.fold([ReceivedPeerPacket(now_s, packet)], 0)
    return table, now_s


def test_a_peer_in_doubt_is_known_by_its_positions_and_neither_fresh_nor_present() -> None:
    table, now_s = table_after(in_turn(1, 11.9), 2 * SECOND)
    assert table.in_time(now_s) == ({}, {})
    assert table.in_doubt(now_s) == (2,)
    assert table.in_doubt(now_s + 1.0) == ()  # silent by then, in any case
    motion = table.known[2].packet.motion
    assert hypot(*motion.velocity_enu_m_s) < 0.5
    assert motion.acceleration_enu_m_s2 == ZERO3
    assert table.rejected[f"{Code.PEER_IN_DOUBT} 2"] > 0


def test_an_honest_peer_is_fresh_and_as_it_was_sent() -> None:
    table, now_s = table_after(circling, 3 * SECOND, towards_the_centre)
    fresh, present = table.in_time(now_s)
    assert fresh.keys() == present.keys() == {2}
    assert table.in_doubt(now_s) == ()
    assert table.known[2].packet.motion.velocity_enu_m_s == circling(3 * SECOND - 1)[1]


def test_accelerations_are_compared_where_the_wind_is_observed() -> None:
    """Else the command alone keeps a vehicle in its place against the wind."""
    assert table_after(circling, 3 * SECOND)[0].known[2].contradicts  # an acceleration of zero on a circle
    windward = replace(LIMITS, wind_is_observed=False)
    assert not table_after(circling, 3 * SECOND, limits=windward)[0].known[2].contradicts
    laws = [LawSection(disturbance_bandwidth_1_s=bandwidth) for bandwidth in (0.0, 0.9, 1.0, 4.0)]
    fleets = [
        FleetConfig(name="f", origin="indoor", vehicles=ONE, neighbours=EdgeNeighbours(()), law=law) for law in laws
    ]
    assert [fleet_limits(fleet).wind_is_observed for fleet in fleets] == [False, False, True, True]


def received(packets: Iterable[ReceivedPeerPacket]) -> tuple[PeerTable, float]:
    """A table of vehicle 1 after these packets of vehicle 2, which may not lead."""
    table, now_s = PeerTable(1, {1: True, 2: False}, 42, 0.3, LIMITS, ()), 0.0
    for one in packets:
        now_s = one.received_s
        table.fold([one], 0)
    return table, now_s


def sent(tick: int, arrives_s: float = 0.0, proven: bool = True, **said: Any) -> ReceivedPeerPacket:
    """What vehicle 2 sends in this tick, with what it says in place of the truth."""
    now_s = 100.0 + TICK_S * tick
    fields = {"vehicle_id": 2, "sequence": tick, "formation_hash": 42, "sent_s": now_s, "phase": FlightPhase.FORMATION}
    packet = with_fields(AT_REST, **(fields | said))
    return ReceivedPeerPacket(now_s + arrives_s, packet, proven)


REFUSED: dict[str, dict[str, Any]] = {
    "it leads": {"role": Role.LEADER, "prc": 1},
    "its sequence does not rise": {"sequence": 0},
    "it is not a number": {"position_enu_m": (nan, 0.0, 0.0)},
    "another one leads, without a signature": {"proven": False},
    "an epoch that nobody missed": {"beacon": LeaderBeacon(1, 100, 1)},
}


@pytest.mark.parametrize("what", REFUSED)
def test_who_sends_for_half_a_second_what_is_not_believed_is_named(what: str) -> None:
    table, now_s = received(sent(tick, **(REFUSED[what] if tick else {})) for tick in range(round(0.4 * SECOND)))
    assert table.refused(now_s) == ()
    table, now_s = received(sent(tick, **(REFUSED[what] if tick else {})) for tick in range(round(0.7 * SECOND)))
    assert table.refused(now_s) == (2,)
    assert table.refused(now_s + 0.5) == ()  # silent
    for tick in range(SECOND, 3 * SECOND):
        table.fold([sent(tick)], 0)
    assert not table.disbelief.sums


def test_what_the_network_holds_back_or_sends_twice_is_no_lie() -> None:
    packets = [sent(tick, delay_s) for tick in range(3 * SECOND) for delay_s in (0.001, 0.15 if tick % 4 else 0.25)]
    table, now_s = received(sorted(packets, key=lambda one: one.received_s))
    assert table.rejected[f"{Code.PEER_OUT_OF_ORDER} 2"] > 2 * SECOND
    assert table.refused(now_s) == () and not table.disbelief.sums


def test_one_lie_in_three_packets_names_nobody() -> None:
    table, now_s = received(sent(tick, **({} if tick % 3 else REFUSED["it leads"])) for tick in range(4 * SECOND))
    assert table.refused(now_s) == ()
