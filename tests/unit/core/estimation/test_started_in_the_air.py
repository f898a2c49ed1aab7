"""An agent that starts in the air while heights count from the take-off: what it believes, and what it says."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from companion.core.estimation.vehicle import VehicleTracker
from companion.types.autopilot import (
    AutopilotKind,
    GroundSample,
    HeartbeatSample,
    LandedSample,
    LandedState,
    OriginSample,
    PositionSample,
    Telemetry,
)
from companion.types.flight import FLAG_TEXTS, HealthFlag
from companion.types.notices import Code

ORIGIN = (47.0, 8.0, 400.0)
BOOTED_S = 40.0
KEPT = GroundSample(99.0, 3.0, BOOTED_S, 2.0)


def flying(
    at_s: float, up_m: float = 8.0, armed: bool = True, landed: LandedState = LandedState.IN_AIR
) -> list[Telemetry]:
    """Telemetry of an autopilot that is `up_m` above its origin, which is that of the fleet."""
    return [
        HeartbeatSample(at_s, armed, AutopilotKind.PX4),
        LandedSample(at_s, landed),
        OriginSample(at_s, *ORIGIN),
        PositionSample(at_s, at_s - BOOTED_S, (1.0, 2.0, up_m), (0.0, 0.0, 0.0)),
    ]


def on_ground(at_s: float, up_m: float) -> list[Telemetry]:
    return flying(at_s, up_m, armed=False, landed=LandedState.ON_GROUND)


def tracker() -> VehicleTracker:
    return VehicleTracker(ORIGIN, height_from_takeoff=True)


def test_the_next_agent_has_the_position_of_the_one_before() -> None:
    before, after = tracker(), tracker()
    before.fold(on_ground(50.0, 3.0))
    assert before.takeoff is None  # nothing is needed on the ground
    flown, _ = before.fold(flying(60.0))
    assert before.takeoff == GroundSample(60.0, 3.0, BOOTED_S, 0.0)
    state, events = after.fold([replace(before.takeoff, within_s=2.0), *flying(60.02)])
    assert state.position_enu_m == flown.position_enu_m == (1.0, 2.0, 5.0)
    assert (state.frame_known, state.ground_unknown) == (True, False)
    assert [event.code for event in events] == [Code.GROUND_KEPT]
    assert after.takeoff is not None  # so that a third one knows it, too
    assert after.takeoff.ground_up_m == 3.0


@pytest.mark.parametrize(
    "kept",
    [
        None,
        replace(KEPT, booted_s=BOOTED_S + 2.1),  # another start of the autopilot
        replace(KEPT, booted_s=BOOTED_S - 2.1),
        replace(KEPT, within_s=-1.0),
    ],
)
def test_without_it_the_agent_says_at_once_that_it_must_land(kept: GroundSample | None) -> None:
    one = tracker()
    state, events = one.fold([*([kept] if kept else []), *flying(100.0)])
    assert state.position_time_s == float("-inf")
    assert state.ground_unknown
    assert [(event.code, event.text) for event in events] == [
        (Code.GROUND_UNKNOWN, FLAG_TEXTS[HealthFlag.GROUND_UNKNOWN])
    ]
    assert one.takeoff is None


def test_it_is_said_once_and_ends_with_the_landing() -> None:
    one = tracker()
    assert one.fold(flying(100.0))[1]
    assert one.fold(flying(100.1))[1] == ()
    assert not one.fold(flying(101.0, landed=LandedState.ON_GROUND))[0].ground_unknown
    state, _ = one.fold(on_ground(102.0, 1.0))
    assert (state.position_enu_m[2], state.ground_unknown) == (0.0, False)


def test_what_was_kept_is_nothing_to_an_agent_that_starts_on_the_ground() -> None:
    one = tracker()
    one.fold([KEPT, *on_ground(100.0, 7.0)])
    state, events = one.fold(flying(110.0, 8.0))
    assert (state.position_enu_m[2], events) == (1.0, ())


def test_a_heartbeat_on_the_ground_before_the_first_position_ends_that_flight() -> None:
    one = tracker()
    heartbeat, landed, *_ = on_ground(100.0, 7.0)
    one.fold([KEPT, heartbeat, landed])
    state, _ = one.fold(flying(101.0))
    assert state.ground_unknown


def test_a_reboot_in_flight_forgets_the_take_off() -> None:
    one = tracker()
    one.fold([KEPT, *flying(100.0)])
    rebooted = [
        replace(one_of, boot_time_s=1.0) if isinstance(one_of, PositionSample) else one_of for one_of in flying(101.0)
    ]
    one.fold(rebooted)
    state, events = one.fold([*flying(101.0)[:3], PositionSample(101.1, 1.1, (1.0, 2.0, 8.0), (0.0, 0.0, 0.0))])
    assert state.ground_unknown
    assert [event.code for event in events] == [Code.GROUND_UNKNOWN]
    assert one.takeoff is None


def test_with_heights_about_the_origin_nothing_is_kept_nor_missed() -> None:
    one = VehicleTracker(ORIGIN)
    state, events = one.fold([KEPT, *flying(100.0)])
    assert (state.position_enu_m, state.ground_unknown, events) == ((1.0, 2.0, 8.0), False, ())
    assert one.takeoff is None
