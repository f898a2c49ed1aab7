"""Checks of target samples: order, finite and plausible numbers, one sender, age."""

from __future__ import annotations

from math import inf, nan

import pytest
from msgspec.structs import replace

from companion.core.reference.target import TOO_LATE_S, Targets
from companion.types.notices import Code
from companion.types.peers import ReceivedTarget, TargetSample

GOOD = TargetSample(
    session=7, sequence=5, sent_s=100.0, velocity_enu_m_s=(1.0, 0.0, -2.0), position_enu_m=(3.0, 4.0, 5.0)
)
NAMES = ["main"]


def folded(*samples: tuple[float, TargetSample], name: str = "main") -> Targets:
    targets = Targets()
    for received_s, sample in samples:
        targets.fold([ReceivedTarget(received_s, name, sample)], NAMES)
    return targets


def test_target_is_extrapolated_with_its_velocity() -> None:
    target = folded((10.0, GOOD)).newest("main")
    assert target is not None
    assert target.measured_s == 10.0
    assert target.position_at(10.5) == (3.5, 4.0, 4.0)
    joystick = folded((10.0, replace(GOOD, position_enu_m=None))).newest("main")
    assert joystick is not None
    assert joystick.position_at(10.5) is None


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"position_enu_m": (nan, 0.0, 0.0)}, Code.TARGET_NOT_FINITE),
        ({"velocity_enu_m_s": (0.0, inf, 0.0)}, Code.TARGET_NOT_FINITE),
        ({"sent_s": nan}, Code.TARGET_NOT_FINITE),
        ({"position_enu_m": (0.0, 2.1e4, 0.0)}, Code.TARGET_POSITION_IMPLAUSIBLE),
        ({"velocity_enu_m_s": (80.0, 80.0, 0.0)}, Code.TARGET_SPEED_IMPLAUSIBLE),
        ({"sent_s": -1.0}, Code.TARGET_TIME_IMPLAUSIBLE),
        ({"session": 8}, Code.TARGET_NAME_TWICE),
        ({"sequence": 5}, Code.TARGET_OUT_OF_ORDER),
        ({"sent_s": 100.1 - TOO_LATE_S - 0.1}, Code.TARGET_LATE),
    ],
)
def test_refused_sample_is_counted_and_changes_nothing(changes: dict[str, object], code: Code) -> None:
    targets = folded((10.0, GOOD), (10.1, replace(GOOD, **({"sequence": 6, "sent_s": 100.1} | changes))))
    assert targets.rejected == {code: 1}
    newest = targets.newest("main")
    assert newest is not None
    assert newest.sample == GOOD


def test_another_sender_is_accepted_after_silence_of_the_first() -> None:
    second = replace(GOOD, session=8, sequence=1, sent_s=3.0)
    newest = folded((10.0, GOOD), (10.01 + TOO_LATE_S, second)).newest("main")
    assert newest is not None
    assert newest.sample == second


def test_age_includes_the_network_delay() -> None:
    late = replace(GOOD, sequence=6, sent_s=100.1)
    newest = folded((10.0, GOOD), (10.4, late)).newest("main")
    assert newest is not None
    assert newest.measured_s == pytest.approx(10.1, abs=1e-3)


def test_target_with_another_name_is_ignored() -> None:
    targets = folded((10.0, GOOD), name="stranger")
    assert targets.newest("stranger") is None
    assert not targets.rejected
