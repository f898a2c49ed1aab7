"""The motion-capture system of the stand-ins: noise, latency, and each of its faults."""

from __future__ import annotations

from math import dist, pi, radians
from statistics import pstdev

import pytest

from companion.geometry.frames import euler_from_quaternion, quaternion_from_euler, wrap_pi
from sitl.vehicle.capture import LATE_S, BodyPlace, CaptureSystem, MeasuredBody
from sitl.vehicle.config import CaptureFault

PERIOD_S = 0.01
LEVEL = (1.0, 0.0, 0.0, 0.0)
NOISE_M = 0.02  # ten standard deviations


def true_at(now_s: float) -> dict[int, BodyPlace]:
    """Two vehicles 5 m apart that fly east at 1 m/s; one of them looks west."""
    return {1: ((now_s, 0.0, 1.0), LEVEL), 2: ((now_s, 5.0, 1.0), quaternion_from_euler(0.0, 0.0, pi))}


def flown(*faults: CaptureFault, seconds: float = 4.0, seed: int = 1) -> list[tuple[float, dict[int, MeasuredBody]]]:
    """Every frame with its time; bodies by vehicle."""
    cameras = CaptureSystem(seed, faults)
    times_s = [PERIOD_S * frame for frame in range(round(seconds / PERIOD_S))]
    return [(now_s, {body[0]: body for body in cameras.frame(now_s, true_at(now_s))}) for now_s in times_s]


def error_m(body: MeasuredBody, now_s: float) -> float:
    """Of a position against the truth at the time that the frame states."""
    vehicle_id, position_m, _, age_s = body
    return dist(position_m, true_at(now_s - age_s)[vehicle_id][0])


def yaw_error_rad(body: MeasuredBody) -> float:
    return abs(wrap_pi(euler_from_quaternion(body[2])[2] - euler_from_quaternion(true_at(0.0)[body[0]][1])[2]))


def fault(kind: str, **more: object) -> CaptureFault:
    """Of vehicle 1 from second 1 to 2."""
    return CaptureFault(**{"kind": kind, "vehicle": 1, "at_s": 1.0, "for_s": 1.0, **more})


def split(frames: list[tuple[float, dict[int, MeasuredBody]]]) -> tuple[list, list]:
    """The frames while the fault lasts, and the others after the first tenth of a second."""
    within = [frame for frame in frames if 1.0 - 1e-6 <= frame[0] < 2.0 - 1e-6]
    return within, [frame for frame in frames if frame not in within and frame[0] > 0.1]


def test_noise_of_two_millimetres_and_a_true_age():
    frames = flown()[10:]
    bodies = [(body, now_s) for now_s, frame in frames for body in frame.values()]
    assert len(bodies) == 2 * len(frames)
    errors_m = [
        body[1][axis] - true_at(now_s - body[3])[body[0]][0][axis] for body, now_s in bodies for axis in range(3)
    ]
    assert pstdev(errors_m) == pytest.approx(0.002, rel=0.05)
    assert {round(body[3], 6) for body, _ in bodies} == {PERIOD_S}
    assert pstdev([euler_from_quaternion(frame[1][2])[2] for _, frame in frames]) == pytest.approx(0.003, rel=0.1)


def test_the_same_seed_gives_the_same_frames():
    assert flown(seconds=0.5) == flown(seconds=0.5)
    assert flown(seconds=0.5) != flown(seconds=0.5, seed=2)


def test_a_lost_body_is_in_no_frame():
    within, others = split(flown(fault("lost")))
    assert {tuple(frame) for _, frame in within} == {(2,)}
    assert {tuple(frame) for _, frame in others} == {(1, 2)}


def test_swapped_bodies_have_each_others_poses():
    within, others = split(flown(fault("swapped", other=2)))
    for now_s, frame in within:
        for one, other in ((1, 2), (2, 1)):
            assert error_m((other, *frame[one][1:]), now_s) < NOISE_M
            assert yaw_error_rad((other, *frame[one][1:])) < 0.05
    assert all(error_m(body, now_s) < NOISE_M for now_s, frame in others for body in frame.values())


@pytest.mark.parametrize("turn_deg", [90, 180])
def test_a_flipped_body_is_turned_where_it_is(turn_deg: int):
    within, others = split(flown(fault("flipped", turn_deg=turn_deg)))
    assert all(abs(yaw_error_rad(frame[1]) - radians(turn_deg)) < 0.05 for _, frame in within)
    assert all(error_m(body, now_s) < NOISE_M for now_s, frame in within for body in frame.values())
    assert all(yaw_error_rad(body) < 0.05 for body in (frame[2] for _, frame in within))
    assert all(yaw_error_rad(body) < 0.05 for _, frame in others for body in frame.values())


def test_a_frozen_body_says_it_is_fresh():
    frames = flown(fault("frozen"))
    within, others = split(frames)
    before = next(frame for now_s, frame in frames if now_s == pytest.approx(0.99))
    assert {frame[1][1:3] for _, frame in within} == {before[1][1:3]}
    assert {round(frame[1][3], 6) for _, frame in within} == {PERIOD_S}
    assert all(error_m(frame[2], now_s) < NOISE_M for now_s, frame in within)
    assert all(error_m(frame[1], now_s) < NOISE_M for now_s, frame in others)


def test_a_late_body_says_so():
    within, others = split(flown(fault("late")))
    assert {round(frame[1][3], 6) for _, frame in within} == {PERIOD_S + LATE_S}
    assert all(error_m(body, now_s) < NOISE_M for now_s, frame in within for body in frame.values())
    assert {round(frame[1][3], 6) for _, frame in others} == {PERIOD_S}


def test_a_swap_needs_another_vehicle():
    assert [key for key, _ in fault("swapped").contradictions()] == ["other"]
    assert [key for key, _ in fault("swapped", other=1).contradictions()] == ["other"]
    assert [key for key, _ in fault("lost", other=2).contradictions()] == ["other"]
    assert not [*fault("swapped", other=2).contradictions(), *fault("lost").contradictions()]
