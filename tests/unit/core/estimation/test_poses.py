"""Which motion-capture poses are passed on: each kind of wrong pose is refused by its name, and right ones are not."""

from __future__ import annotations

from math import cos, pi, sin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.estimation.poses import FROZEN_S, JUMP_M, LARGEST_JUMP_M, LATE_S, RESTARTS_S, PoseJudge
from companion.geometry.frames import quaternion_from_euler
from companion.types.autopilot import LandedState, PoseSample, VehicleState
from companion.types.peers import BodyPose
from companion.types.values import Vector3

PERIOD_S = 0.01
CLOCK_AHEAD_S = 400.0  # the sender's clock
OTHERS: dict[int, Vector3] = {2: (1.5, 0.0, 1.0)}


class Hall:
    """A vehicle that circles with 1 m/s, an autopilot whose estimate is a little off, and cameras."""

    def __init__(self, armed: bool = True) -> None:
        self.judge, self.now_s, self.armed, self.number, self.offset_enu_m = PoseJudge(), 10.0, armed, 0, (0.05, 0.0)

    def place(self) -> Vector3:
        return (cos(self.now_s), sin(self.now_s), 1.0 + 0.0003 * (self.number % 7)) if self.armed else (0.0, 0.0, 0.0)

    def vehicle(self) -> VehicleState:
        x, y, z = self.place()
        speed = 1.0 if self.armed else 0.0
        return VehicleState(
            position_enu_m=(x + self.offset_enu_m[0], y + self.offset_enu_m[1], z),
            velocity_enu_m_s=(-speed * sin(self.now_s), speed * cos(self.now_s), 0.0),
            yaw_rad=0.3,
            attitude_time_s=self.now_s,
            armed=self.armed,
            landed=LandedState.IN_AIR if self.armed else LandedState.ON_GROUND,
        )

    def pose(self, **changes: object) -> BodyPose:
        quaternion = quaternion_from_euler(0.01, -0.02, 0.3)
        pose = BodyPose(7, self.number, self.now_s + CLOCK_AHEAD_S, self.place(), quaternion)
        return replace(pose, **changes)

    def see(self, for_s: float = PERIOD_S, late_s: float = 0.0, **changes: object) -> PoseSample:
        """The last verdict."""
        for _ in range(round(for_s / PERIOD_S)):
            self.number, self.now_s = self.number + 1, self.now_s + PERIOD_S
            sent_s = self.now_s + CLOCK_AHEAD_S
            sample = self.judge.judge(
                self.now_s + late_s, self.pose(**{"sent_s": sent_s, **changes}), self.vehicle(), OTHERS
            )
        return sample

    def wait(self, for_s: float) -> None:
        self.now_s += for_s


def test_good_poses_are_passed_on() -> None:
    hall = Hall()
    for _ in range(500):
        sample = hall.see()
        assert sample.fault == ""
        assert sample.measured_s == pytest.approx(sample.received_s, abs=0.001)


@pytest.mark.parametrize(
    ("words", "changes"),
    [
        ("jumped by", {"position_enu_m": (4.0, 4.0, 1.0)}),
        ("swapped: vehicle 2 is there", {"position_enu_m": (1.5, 0.05, 1.0)}),
        ("turned by 90 deg", {"quaternion": quaternion_from_euler(0.0, 0.0, 0.3 + pi / 2)}),
        ("turned by 180 deg", {"quaternion": quaternion_from_euler(0.0, 0.0, 0.3 + pi)}),
        ("tilted by 90 deg", {"quaternion": quaternion_from_euler(pi / 2, 0.0, 0.3)}),
        ("tilted by 180 deg", {"quaternion": quaternion_from_euler(pi, 0.0, 0.3)}),
        ("no rotation", {"quaternion": (0.0, 0.0, 0.0, 0.0)}),
        ("out of order", {"sequence": 3}),
    ],
)
def test_a_wrong_pose_is_refused_by_its_name_for_as_long_as_it_lasts(words: str, changes: dict[str, object]) -> None:
    hall = Hall()
    hall.see(2.0)
    hall.wait(0.5)  # the swapped place is far from this one
    hall.see(0.5)
    assert words in hall.see(**changes).fault
    still = hall.see(1.5, **changes)
    assert words in still.fault or still.fault.startswith("frozen")


def test_a_second_source_is_refused_while_the_first_one_sends_and_used_when_it_is_silent() -> None:
    hall = Hall()
    hall.see(1.0)
    assert "two sources" in hall.see(session=8).fault
    assert hall.see().fault == ""
    hall.wait(LATE_S + PERIOD_S)
    assert hall.see(session=8).fault == ""


def test_right_poses_after_wrong_ones_are_passed_on_at_once() -> None:
    hall = Hall()
    hall.see(1.0)
    hall.see(1.0, position_enu_m=(1.5, 0.0, 1.0))
    assert hall.see().fault == ""


def test_a_frozen_pose_is_refused_in_the_air_and_not_on_the_ground() -> None:
    hall = Hall()
    hall.see(1.0)
    here = hall.place()
    assert hall.see(FROZEN_S, position_enu_m=here).fault == ""
    assert hall.see(0.02, position_enu_m=here).fault.startswith("frozen")
    parked = Hall(armed=False)
    assert parked.see(3.0).fault == ""


def test_late_poses_are_refused_and_a_delay_that_is_allowed_counts() -> None:
    hall = Hall()
    hall.see(1.0)
    assert "late" in hall.see(0.5, late_s=0.3).fault
    hall = Hall()
    hall.see(1.0)
    sample = hall.see(0.1, late_s=0.1)
    assert sample.fault == ""
    assert sample.measured_s == pytest.approx(sample.received_s - 0.1, abs=0.01)
    assert "late" in hall.see(age_s=LATE_S + 0.01).fault


def test_the_place_after_a_silence_may_be_off_by_the_drift_and_not_be_that_of_another_vehicle() -> None:
    hall = Hall()
    hall.see(1.0)
    hall.offset_enu_m = (0.8, 0.0)  # dead reckoning for 3 s
    hall.wait(3.0)
    assert hall.see().fault == ""
    hall.see(1.0)
    hall.wait(3.0)
    assert hall.see(position_enu_m=(1.5, 0.05, 1.0)).fault.startswith("swapped")


def test_refusals_never_make_a_place_near_another_vehicle_allowed() -> None:
    assert LARGEST_JUMP_M < 1.0
    hall = Hall()
    hall.see(1.0)
    for _ in range(1000):
        x, y, z = hall.place()
        wobble = 0.0003 * (hall.number % 5)
        sample = hall.see(position_enu_m=(x + LARGEST_JUMP_M + 0.1 + wobble, y, z))
        assert sample.fault


def test_a_vehicle_that_was_carried_away_on_the_ground_is_accepted_there_after_a_second() -> None:
    hall = Hall(armed=False)
    hall.see(1.0)
    assert hall.judge.resets == 0
    assert "jumped" in hall.see(RESTARTS_S - 0.1, position_enu_m=(3.0, 0.0, 0.0)).fault
    assert hall.see(0.2, position_enu_m=(3.0, 0.0, 0.0)).fault == ""
    assert hall.judge.resets == 1


@settings(max_examples=40)
@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(0.0, 2.0))
def test_what_is_passed_on_in_the_air_is_near_the_place_to_be_expected(x: float, y: float, z: float) -> None:
    hall = Hall()
    hall.see(0.5)
    off = (x, y, z)
    sample = hall.see(position_enu_m=off)
    px, py, pz = hall.place()
    away_m = ((x - px) ** 2 + (y - py) ** 2 + (z - pz) ** 2) ** 0.5
    if not sample.fault:
        assert away_m < JUMP_M + 0.15


def test_a_swapped_body_is_refused_until_it_steps_back_wherever_the_estimate_drifts() -> None:
    """Without poses the estimate drifts by metres, also to the place of the other vehicle."""
    hall = Hall()
    hall.see(1.0)
    for number in range(600):
        assert hall.see(position_enu_m=(1.5, 0.05, 1.0 + 0.001 * (number % 3))).fault.startswith("swapped")
        x, y, _ = hall.place()
        hall.offset_enu_m = (1.5 - x, -y)
    hall.offset_enu_m = (0.1, 0.1)
    assert hall.see().fault == ""


def test_an_estimate_that_steps_alone_does_not_shut_poses_out() -> None:
    hall = Hall()
    hall.see(1.0)
    hall.offset_enu_m = (3.0, 0.0)
    hall.see(0.3)
    hall.offset_enu_m = (0.1, 0.0)
    assert hall.see().fault == ""


def test_an_agent_that_starts_in_the_air_waits_for_the_estimate_and_passes_poses_on() -> None:
    hall = Hall()
    hall.offset_enu_m = (-40.0, 0.0)  # no position yet
    assert hall.see(0.2).fault.startswith("jumped")
    hall.offset_enu_m = (0.05, 0.0)
    assert hall.see().fault == ""
