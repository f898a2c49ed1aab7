"""The monitor behind the filter: what must always hold, and nothing else."""

from __future__ import annotations

from math import inf, nan, radians

import pytest
from msgspec.structs import replace

from companion.core.consensus.peers import PeerState
from companion.core.safety.assurance import IN_A_ROW, SHARE, CommandMonitor
from companion.core.safety.limits import OutputLimits
from companion.geometry.airspace import Airspace, Cylinder, Fence
from companion.types.autopilot import AttitudeTarget, VehicleState
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender
from companion.types.values import ZERO3, Vector3

FENCE = Fence((-50.0, -50.0, 1.0), (50.0, 50.0, 30.0))
LIMITS = OutputLimits(radians(25.0), radians(120.0), 0.6, 1.4, 10.0, FENCE)
SEPARATION_M = 2.0
NOW_S = 10.0


def monitor(*obstacles: Cylinder) -> CommandMonitor:
    return CommandMonitor(SEPARATION_M, Airspace(FENCE, obstacles), LIMITS)


def vehicle(velocity_enu_m_s: Vector3 = ZERO3, position_enu_m: Vector3 = (0.0, 0.0, 10.0)) -> VehicleState:
    return VehicleState(
        position_enu_m=position_enu_m, velocity_enu_m_s=velocity_enu_m_s, position_time_s=NOW_S, attitude_time_s=NOW_S
    )


def peer(position_enu_m: Vector3, velocity_enu_m_s: Vector3, phase: FlightPhase = FlightPhase.FORMATION) -> PeerState:
    packet = PeerPacket(
        sender=Sender(2, 1, 1, 1),
        phase=phase,
        role=Role.FOLLOWER,
        motion=Motion(position_enu_m, velocity_enu_m_s, ZERO3, 0.0, 0.0),
        leader=LeaderReport(2, None),
        slot=FlownSlot(ZERO3),
    )
    return PeerState(packet, NOW_S, 0.0, NOW_S)


def braked(given: Vector3, own: VehicleState, other: PeerState | None, at: CommandMonitor) -> bool:
    near = {2: other} if other else {}
    for _ in range(IN_A_ROW - 1):
        assert at.acceleration(NOW_S, own, near, given) is given
    allowed = at.acceleration(NOW_S, own, near, given)
    at.acceleration(NOW_S, vehicle(), {}, ZERO3)  # nothing is found any more
    return allowed is not given


@pytest.mark.parametrize(
    ("apart_m", "closing_m_s", "brakes"),
    [
        (20.0, 4.0, False),
        (6.5, 4.0, False),
        (3.0, 4.0, True),
        (SHARE * SEPARATION_M + 0.2, 0.0, False),
        (0.5, -1.0, False),
    ],
)
def test_two_that_cooperate_can_still_stop(apart_m: float, closing_m_s: float, brakes: bool) -> None:
    other = peer((apart_m, 0.0, 10.0), (-0.5 * closing_m_s, 0.0, 0.0))
    assert braked(ZERO3, vehicle((0.5 * closing_m_s, 0.0, 0.0)), other, monitor()) is brakes


def test_it_brakes_against_the_velocity() -> None:
    at, own, other = monitor(), vehicle((2.0, 0.0, -1.0)), peer((2.0, 0.0, 10.0), ZERO3)
    allowed = [at.acceleration(NOW_S, own, {2: other}, (3.0, 0.0, 0.0)) for _ in range(IN_A_ROW)][-1]
    assert allowed[0] < 0.0 and allowed[1] == 0.0 and allowed[2] > 0.0


def test_the_command_counts_and_not_only_the_velocity() -> None:
    own, other = vehicle(), peer((SHARE * SEPARATION_M + 0.4, 0.0, 10.0), ZERO3)
    assert braked((4.0, 0.0, 0.0), own, other, monitor())
    assert not braked((-4.0, 0.0, 0.0), own, other, monitor())


def test_a_velocity_that_changes_its_sign_with_each_packet_stops_nobody() -> None:
    at, own, given = monitor(), vehicle(), (0.1, 0.0, 0.0)
    for tick in range(100):
        other = peer((3.0, 0.0, 10.0), (-11.9 if tick % 2 else 11.9, 0.0, 0.0))
        assert at.acceleration(NOW_S, own, {2: other}, given) is given


def test_who_passes_by_at_a_distance_is_let_pass() -> None:
    own = vehicle((4.0, 0.0, 0.0))
    assert not braked(ZERO3, own, peer((4.0, SEPARATION_M, 10.0), (-1.0, 0.0, 0.0)), monitor())
    assert braked(ZERO3, own, peer((4.0, 0.3, 10.0), (-1.0, 0.0, 0.0)), monitor())


def test_who_does_not_cooperate_is_the_filters_alone() -> None:
    own, other = vehicle((4.0, 0.0, 0.0)), peer((2.0, 0.0, 10.0), ZERO3, FlightPhase.HOLD)
    assert not braked(ZERO3, own, other, monitor())


@pytest.mark.parametrize(
    ("position_enu_m", "velocity_enu_m_s", "brakes"),
    [
        ((49.0, 0.0, 10.0), (3.0, 0.0, 0.0), True),
        ((49.0, 0.0, 10.0), (-3.0, 0.0, 0.0), False),
        ((0.0, -49.0, 10.0), (0.0, -3.0, 0.0), True),
        ((0.0, 0.0, 1.5), (0.0, 0.0, -2.0), True),
        ((0.0, 0.0, 29.5), (0.0, 0.0, 2.0), True),
        ((0.0, 0.0, 10.0), (5.0, 5.0, -2.0), False),
        ((51.0, 0.0, 10.0), (-1.0, 0.0, 0.0), False),  # outside, on its way back
    ],
)
def test_the_fence_can_still_be_kept(position_enu_m: Vector3, velocity_enu_m_s: Vector3, brakes: bool) -> None:
    assert braked(ZERO3, vehicle(velocity_enu_m_s, position_enu_m), None, monitor()) is brakes


def test_an_obstacle_can_still_be_avoided() -> None:
    at = monitor(Cylinder((5.0, 0.0), 1.0, 0.0, 20.0))
    assert braked(ZERO3, vehicle((4.0, 0.0, 0.0), (2.0, 0.0, 10.0)), None, at)
    assert not braked(ZERO3, vehicle((-4.0, 0.0, 0.0), (2.0, 0.0, 10.0)), None, at)
    assert not braked(ZERO3, vehicle((1.0, 0.0, 0.0), (0.0, 0.0, 10.0)), None, at)


LEVEL = AttitudeTarget(0.0, 0.0, 0.0, 0.5)


@pytest.mark.parametrize(
    "bad",
    [
        {"roll_rad": radians(26.0)},
        {"pitch_rad": nan},
        {"yaw_rad": inf},
        {"thrust_norm": 1.1},
        {"thrust_norm": -0.1},
        {"thrust_norm": nan},
        {"roll_rad": radians(20.0)},  # 20 degrees in a tick
    ],
)
def test_no_target_beyond_the_limits_is_sent(bad: dict[str, float]) -> None:
    at, own = monitor(), vehicle()
    assert at.permits(NOW_S, own, LEVEL)
    assert not at.permits(NOW_S + 0.02, own, AttitudeTarget(**{**_fields(LEVEL), **bad}))
    assert at.permits(NOW_S + 0.04, own, LEVEL)


def test_no_target_by_an_old_position_is_sent() -> None:
    at = monitor()
    assert not at.permits(NOW_S + 0.2, vehicle(), LEVEL)
    assert at.permits(NOW_S + 0.2, replace(vehicle(), position_time_s=NOW_S + 0.19), LEVEL)


def _fields(target: AttitudeTarget) -> dict[str, float]:
    return {name: getattr(target, name) for name in ("roll_rad", "pitch_rad", "yaw_rad", "thrust_norm")}


def test_level_flight_is_never_touched() -> None:
    given = (0.1, -0.1, 0.05)
    other = peer((SEPARATION_M, 0.0, 10.0), ZERO3)
    assert monitor().acceleration(NOW_S, vehicle((0.05, 0.0, 0.0)), {2: other}, given) is given
