"""What is believed of a target: in order, finite, plausible, one sender at a time, and never too late."""

from __future__ import annotations

from math import inf, nan

import pytest
from msgspec.structs import replace

from companion.core.targets import TOO_LATE_S, Targets
from companion.types import ReceivedTarget, TargetSample

GOOD = TargetSample(
    session=7, sequence=5, sent_s=100.0, velocity_enu_m_s=(1.0, 0.0, -2.0), position_enu_m=(3.0, 4.0, 5.0)
)
NAMES = ["main"]


def heard(*words: tuple[float, TargetSample], name: str = "main") -> Targets:
    targets = Targets()
    for received_s, sample in words:
        targets.fold([ReceivedTarget(received_s, name, sample)], NAMES)
    return targets


def test_what_is_heard_is_carried_on_with_its_velocity() -> None:
    target = heard((10.0, GOOD)).newest("main")
    assert target is not None
    assert target.measured_s == 10.0
    assert target.position_at(10.5) == (3.5, 4.0, 4.0)
    joystick = heard((10.0, replace(GOOD, position_enu_m=None))).newest("main")
    assert joystick is not None
    assert joystick.position_at(10.5) is None


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"position_enu_m": (nan, 0.0, 0.0)}, "numbers not finite"),
        ({"velocity_enu_m_s": (0.0, inf, 0.0)}, "numbers not finite"),
        ({"sent_s": nan}, "numbers not finite"),
        ({"position_enu_m": (0.0, 2.1e4, 0.0)}, "position not plausible"),
        ({"velocity_enu_m_s": (80.0, 80.0, 0.0)}, "speed not plausible"),
        ({"sent_s": -1.0}, "time of sending not plausible"),
        ({"session": 8}, "two of one name"),
        ({"sequence": 5}, "out of order or replayed"),
        ({"sent_s": 100.1 - TOO_LATE_S - 0.1}, "comes too late"),
    ],
)
def test_what_is_not_believed_is_counted_and_changes_nothing(changes: dict[str, object], reason: str) -> None:
    targets = heard((10.0, GOOD), (10.1, replace(GOOD, **({"sequence": 6, "sent_s": 100.1} | changes))))
    assert targets.rejected == {f"target: {reason}": 1}
    newest = targets.newest("main")
    assert newest is not None
    assert newest.sample == GOOD


def test_another_sender_is_believed_when_the_first_has_been_silent() -> None:
    second = replace(GOOD, session=8, sequence=1, sent_s=3.0)
    newest = heard((10.0, GOOD), (10.0 + TOO_LATE_S, second)).newest("main")
    assert newest is not None
    assert newest.sample == second


def test_what_the_network_held_up_is_as_old_as_that() -> None:
    late = replace(GOOD, sequence=6, sent_s=100.1)
    newest = heard((10.0, GOOD), (10.4, late)).newest("main")
    assert newest is not None
    assert newest.measured_s == pytest.approx(10.1, abs=1e-3)


def test_of_a_name_that_nobody_follows_nothing_is_kept() -> None:
    targets = heard((10.0, GOOD), name="stranger")
    assert targets.newest("stranger") is None
    assert not targets.rejected
