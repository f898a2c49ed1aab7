"""The guided check judges motions of bodies by hand: each wrong choice of axes is named with what to set."""

from __future__ import annotations

from collections.abc import Iterable
from math import radians

import pytest

from companion.geometry.capture_axes import CaptureAxes
from companion.geometry.frames import Quaternion, quaternion_from_euler
from companion.ground.mocap.bodies import CaptureFrame, SeenBody
from companion.ground.mocap.guide import GuideStep, Motion, StepVerdict, StepWatch, steps
from companion.types.values import ZERO3, Vector3

PERIOD_S = 0.02
EAST, NORTH, UP = (1.02, 0.05, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.9)


def yawed(degrees: float) -> Quaternion:
    return quaternion_from_euler(0.0, 0.0, radians(degrees))


def judged(
    motion: Motion,
    moves: dict[str, tuple[Vector3, float]],
    real: CaptureAxes,
    file: CaptureAxes | None = None,
    turn_deg: float = 0.0,
    yaw_deg: float = 0.0,
) -> StepVerdict | None:
    """The verdict on cf1. `moves`: by body, how far and by how many degrees it goes within a second, in the real room."""
    watch = StepWatch(GuideStep("cf1", motion), file or real, turn_deg)
    for frame in range(150):
        share = min(1.0, max(0.0, frame * PERIOD_S - 0.5))
        bodies = tuple(
            SeenBody(name, *real.to_capture(scaled(move, share), yawed(yaw_deg + share * turn)))
            for name, (move, turn) in moves.items()
        )
        if verdict := watch.take(CaptureFrame(frame * PERIOD_S, 0.0, bodies), frame * PERIOD_S):
            assert share == 1.0, "it still moved"
            return verdict
    return None


def scaled(vector: Vector3, share: float) -> Vector3:
    return (vector[0] * share, vector[1] * share, vector[2] * share)


def of(*moves: tuple[str, Vector3, float]) -> dict[str, tuple[Vector3, float]]:
    still: dict[str, tuple[Vector3, float]] = {"cf1": (ZERO3, 0.0), "cf2": (ZERO3, 0.0)}
    return still | {name: (move, turn) for name, move, turn in moves}


def names_of(all_steps: Iterable[GuideStep]) -> list[tuple[str, Motion]]:
    return [(step.name, step.motion) for step in all_steps]


def test_the_first_body_shows_the_axes_and_each_other_one_its_name():
    expected = [("cf1", "east"), ("cf1", "up"), ("cf1", "left"), ("cf2", "up"), ("cf3", "up")]
    assert names_of(steps(["cf1", "cf2", "cf3"])) == expected


@pytest.mark.parametrize("axes", [CaptureAxes.of("y", "x"), CaptureAxes.of("z", "-y"), CaptureAxes.of("z", "x", 30.0)])
def test_right_axes_are_right(axes: CaptureAxes):
    assert judged("east", of(("cf1", EAST, 0.0)), axes) == (
        True,
        "cf1 moved 1.02 m to the east, nose +0 degrees from east: right",
    )
    assert judged("up", of(("cf1", UP, 0.0)), axes) == (True, "cf1 moved 0.90 m up: right")
    assert judged("left", of(("cf1", ZERO3, 85.0)), axes) == (True, "cf1 turned by 85 degrees to the left: right")


@pytest.mark.parametrize(
    ("real", "file", "advice"),
    [
        (("z", "x"), ("z", "-x"), "to the west; expected east: set forward: x"),
        (("y", "-z"), ("y", "x"), "to the north; expected east: set forward: -z"),
        (("y", "x"), ("y", "z"), "to the north; expected east: set forward: x"),
    ],
)
def test_a_wrong_forward_axis_is_named_with_the_right_one(real, file, advice: str):
    verdict = judged("east", of(("cf1", (1.02, 0.0, 0.0), 0.0)), CaptureAxes.of(*real), CaptureAxes.of(*file))
    assert verdict == (False, f"cf1 moved 1.02 m {advice}")


def test_a_wrong_up_axis_is_named_with_the_right_one():
    verdict = judged("up", of(("cf1", UP, 0.0)), CaptureAxes.of("y", "x"), CaptureAxes.of("z", "x"))
    assert verdict == (False, "cf1 moved 0.90 m to the north; expected up: set up: y")


def test_a_frame_that_stands_askew_is_named_with_its_angle():
    verdict = judged(
        "east", of(("cf1", (1.0, 0.0, 0.0), 0.0)), CaptureAxes.of("z", "x", -35.0), CaptureAxes.of("z", "x")
    )
    assert verdict is not None
    assert not verdict.good
    assert verdict.line.endswith("set turn_deg: -35, if the move was to the east")


def test_another_body_that_moves_shows_swapped_names():
    verdict = judged("up", of(("cf2", UP, 0.0)), CaptureAxes.of("y", "x"))
    assert verdict == (False, "'cf2' moved, expected 'cf1': the names in bodies are swapped")


def test_a_body_made_with_its_nose_elsewhere():
    verdict = judged("east", of(("cf1", EAST, 0.0)), CaptureAxes.of("y", "x"), yaw_deg=90.0)
    assert verdict is not None
    assert not verdict.good
    assert "its nose is 90 degrees to the left of east: make the body again" in verdict.line


def test_a_turn_to_the_right_where_left_is_asked():
    verdict = judged("left", of(("cf1", ZERO3, -85.0)), CaptureAxes.of("y", "x"))
    assert verdict is not None
    assert (verdict.good, verdict.line.partition(";")[0]) == (False, "cf1 turned by 85 degrees to the right")


def test_other_motions_than_asked():
    axes = CaptureAxes.of("y", "x")
    for verdict, words in (
        (judged("east", of(("cf1", ZERO3, 85.0)), axes), "turned by 85 degrees; expected a move"),
        (judged("left", of(("cf1", NORTH, 0.0)), axes), "moved; expected a turn"),
    ):
        assert verdict is not None
        assert not verdict.good
        assert words in verdict.line


def test_nothing_is_judged_while_all_rest():
    assert judged("east", of(), CaptureAxes.of("y", "x")) is None
