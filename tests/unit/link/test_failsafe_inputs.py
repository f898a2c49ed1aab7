"""From the clock of the loop and the bytes of the autopilot to the flags: late ticks and a bad estimator end in hold."""

from __future__ import annotations

from agent_on_bytes import BOTH, PX4, FailingFlight
from companion.mavlink.codec import mavlink
from companion.types.autopilot import AutopilotKind
from companion.types.flight import FlightPhase, HealthFlag

P, F, M = FlightPhase, HealthFlag, mavlink
GOOD = M.ESTIMATOR_ATTITUDE | M.ESTIMATOR_VELOCITY_HORIZ | M.ESTIMATOR_VELOCITY_VERT | M.ESTIMATOR_POS_VERT_ABS


def flags(flight: FailingFlight) -> set[HealthFlag]:
    return set(flight.peers.reports[-1].status.safety.flags)


def estimator_status(flight: FailingFlight, bits: int, error_m: float = 0.2) -> None:
    flight.autopilot.queued.append(M.MAVLink_estimator_status_message(0, bits, 0, 0, 0, 0, 0, 0, error_m, error_m))


@BOTH
def test_a_late_tick_is_flagged_for_a_second(kind: AutopilotKind) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    assert not flags(flight)
    flight.now_s += 0.15
    flight.ticks(0.2)
    assert flags(flight) == {F.TICK_LATE}
    flight.ticks(1.0)
    assert not flags(flight)
    assert flight.agent.phase is P.FORMATION


@BOTH
def test_a_loop_that_stays_late_for_5_s_ends_in_hold(kind: AutopilotKind) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    begin_s = flight.now_s
    while flight.agent.phase is P.FORMATION and flight.now_s < begin_s + 20.0:
        flight.now_s += 0.15
        flight.ticks(0.5)
    assert 5.0 < flight.now_s - begin_s < 6.5
    flight.ticks(1.0)
    assert flight.agent.phase is P.HOLD


@BOTH
def test_an_unhealthy_state_estimate_in_sys_status_ends_in_hold(kind: AutopilotKind) -> None:
    flight = FailingFlight(kind).fly_to(P.FORMATION)
    flight.autopilot.estimator_healthy = False
    flight.ticks(2.0)
    assert flight.agent.phase is P.HOLD
    assert F.ESTIMATOR_BAD in flags(flight)


def test_the_flags_and_errors_of_estimator_status_decide() -> None:
    flight = FailingFlight(PX4)
    flight.ticks(0.2)
    for bits, error_m, bad in (
        (GOOD | M.ESTIMATOR_POS_HORIZ_REL, 0.2, False),
        (GOOD | M.ESTIMATOR_POS_HORIZ_ABS, 0.2, False),
        (GOOD, 0.2, True),  # no horizontal position
        (GOOD | M.ESTIMATOR_POS_HORIZ_ABS | M.ESTIMATOR_CONST_POS_MODE, 0.2, False),  # PX4 at rest on the ground
        (GOOD | M.ESTIMATOR_CONST_POS_MODE, 0.2, True),
        ((GOOD | M.ESTIMATOR_POS_HORIZ_ABS) & ~M.ESTIMATOR_VELOCITY_HORIZ, 0.2, True),
        (0, 0.2, False),  # not reported
        (GOOD | M.ESTIMATOR_POS_HORIZ_ABS, 5.1, True),
        (GOOD | M.ESTIMATOR_POS_HORIZ_ABS, 4.9, False),
    ):
        estimator_status(flight, bits, error_m)
        flight.ticks(0.2)
        assert (F.ESTIMATOR_BAD in flags(flight)) is bad, (bits, error_m)
