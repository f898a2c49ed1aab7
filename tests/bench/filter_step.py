"""Time of the separation filter in one tick, and of the whole tick: python -m tests.bench.filter_step.

One vehicle in formation with others nearby. Each figure is the best of a few rounds, so that other load on the machine counts
little. The ratios hold on any machine; the limit is one for the computer on board.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from math import cos, pi, sin

from companion.assembly import safety_filter_of
from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember
from companion.core.consensus.peers import PeerState
from companion.types.autopilot import PositionError, VehicleState
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender
from companion.types.values import ZERO3, Vector3

LIMIT_US, CONTRADICTED_LIMIT_US = 60.0, 120.0
TICK_US = 20_000.0
NEAR = 7
ROUNDS, ROUND_S = 200, 0.003
ERROR = PositionError(0.05, 0.05)


def main() -> int:
    all_too_near = f"{NEAR} vehicles nearby, all too near"
    cases = {
        f"{NEAR} vehicles nearby, none too near": filter_step(NEAR, 3.0, (0.5, 0.2, 0.0)),
        f"{NEAR} vehicles nearby, one half-space active": filter_step(NEAR, 1.6, (3.0, 0.2, 0.0)),
        all_too_near: filter_step(NEAR, 1.0, (3.0, 1.0, 0.5)),
        f"{NEAR} vehicles far away": filter_step(NEAR, 60.0, (0.5, 0.2, 0.0)),
    }
    limits_us = dict.fromkeys(cases, LIMIT_US) | {all_too_near: CONTRADICTED_LIMIT_US}
    best_us = dict.fromkeys(cases, 1e9)
    for _ in range(ROUNDS):
        for name, step in cases.items():
            best_us[name] = min(best_us[name], _time_us(step))
    limits = f"limit {LIMIT_US:g} us, {CONTRADICTED_LIMIT_US:g} us among vehicles that contradict each other"
    print(f"separation filter, one tick; {limits}; period {TICK_US / 1000:g} ms")
    for name, time_us in best_us.items():
        share = time_us / limits_us[name]
        print(f"  {name:44} {time_us:6.1f} us  {share:5.2f} of the limit  {time_us / TICK_US:7.4f} of the period")
    return 0 if all(time_us <= limits_us[name] for name, time_us in best_us.items()) else 1


def filter_step(count: int, distance_m: float, wanted_enu_m_s2: Vector3) -> Callable[[], None]:
    """One call of the filter with vehicles on a circle around the own one, which fly towards it."""
    peers = {i: _peer(i, count, distance_m) for i in range(2, count + 2)}
    fleet = FleetConfig(
        name="bench",
        origin="indoor",
        vehicles=tuple(FormationMember(i, Role.FOLLOWER, ZERO3) for i in range(1, count + 2)),
        neighbours=EdgeNeighbours(()),
    )
    safety_filter = safety_filter_of(fleet, 1)
    vehicle = VehicleState(
        position_enu_m=(0.0, 0.0, 10.0),
        velocity_enu_m_s=(0.4, 0.1, 0.0),
        position_time_s=10.0,
        armed=True,
        position_error=ERROR,
    )

    def step() -> None:
        safety_filter.step(10.001, vehicle, FlownSlot(ZERO3), peers, peers, wanted_enu_m_s2, (0.1, 0.0, 0.0), ZERO3)

    return step


def _peer(vehicle_id: int, count: int, distance_m: float) -> PeerState:
    angle_rad = 2.0 * pi * (vehicle_id + 0.3) / count
    x, y = distance_m * cos(angle_rad), distance_m * sin(angle_rad)
    packet = PeerPacket(
        sender=Sender(vehicle_id=vehicle_id, session=1, sequence=1, formation_hash=1),
        phase=FlightPhase.FORMATION,
        role=Role.FOLLOWER,
        motion=Motion(
            position_enu_m=(x, y, 10.2),
            velocity_enu_m_s=(-0.2 * cos(angle_rad), -0.2 * sin(angle_rad), 0.0),
            acceleration_enu_m_s2=(0.1, 0.1, 0.0),
            state_age_s=0.01,
            sent_s=10.0,
        ),
        leader=LeaderReport(prc=2, beacon=None),
        slot=FlownSlot((x, y, 0.0)),
        position_error=ERROR,
    )
    return PeerState(packet, 10.0, 0.0, 9.99)


def _time_us(step: Callable[[], None]) -> float:
    """Mean time of a call within one round."""
    began_s = time.perf_counter()
    calls = 0
    while (elapsed_s := time.perf_counter() - began_s) < ROUND_S:
        step()
        calls += 1
    return elapsed_s / calls * 1e6


if __name__ == "__main__":
    sys.exit(main())
