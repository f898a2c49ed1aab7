"""Vehicle state in the fleet frame from telemetry."""

from math import nan

import pytest

from companion.core.estimation.corrections import VelocityCorrection
from companion.core.estimation.vehicle import VehicleTracker
from companion.geometry.frames import geodetic_from_enu
from companion.types.autopilot import AttitudeSample, OriginSample, PositionSample
from companion.types.flight import Flight
from companion.types.values import Vector3

FLEET = (47.397742, 8.545594, 488.0)


def sample(
    boot_time_s: float, position: Vector3 = (1.0, 2.0, 3.0), velocity: Vector3 = (0.0, 0.0, 0.0)
) -> PositionSample:
    return PositionSample(boot_time_s + 100.0, boot_time_s, position, velocity)


def test_position_is_unknown_without_an_origin() -> None:
    state = VehicleTracker(FLEET).fold([sample(1.0)])[0]
    assert not state.frame_known
    assert state.position_time_s == float("-inf")


def test_local_origin_is_mapped_into_the_fleet_frame() -> None:
    tracker = VehicleTracker(FLEET)
    own_origin = geodetic_from_enu((50.0, -20.0, 2.0), FLEET)
    state = tracker.fold([OriginSample(0.0, *own_origin), sample(1.0)])[0]
    assert state.position_enu_m == pytest.approx((51.0, -18.0, 5.0), abs=1e-6)
    assert state.altitude_amsl_m == pytest.approx(493.0)


def test_indoor_fleet_needs_no_origin() -> None:
    assert VehicleTracker(None).fold([sample(1.0)])[0].position_enu_m == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    "bad",
    [
        sample(2.0, (nan, 0.0, 0.0)),
        sample(2.0, (1e9, 0.0, 0.0)),
        sample(2.0, velocity=(0.0, 0.0, 500.0)),
        sample(1.0, (9.0, 9.0, 9.0)),  # the same time twice
        sample(0.9, (9.0, 9.0, 9.0)),  # overtaken on its way
        AttitudeSample(102.0, nan, 0.0, 0.0),
        OriginSample(102.0, 900.0, 0.0, 0.0),
    ],
)
def test_implausible_sample_changes_nothing(bad: PositionSample | AttitudeSample | OriginSample) -> None:
    tracker = VehicleTracker(None)
    before = tracker.fold([sample(1.0)])[0]
    assert tracker.fold([bad])[0] == before
    assert tracker.rejected.total() == 1


def test_origin_is_unknown_after_a_reboot() -> None:
    tracker = VehicleTracker(FLEET)
    tracker.fold([OriginSample(0.0, *FLEET), sample(1000.0)])
    after = tracker.fold([sample(2.0)])[0]
    assert not after.frame_known
    assert after.altitude_amsl_m is None
    assert after.position_time_s == float("-inf")
    again = tracker.fold([OriginSample(0.0, *geodetic_from_enu((0.0, 0.0, 1.0), FLEET)), sample(3.0)])[0]
    assert again.position_enu_m == pytest.approx((1.0, 2.0, 4.0), abs=1e-6)


def test_last_position_is_dropped_when_the_origin_moves() -> None:
    tracker = VehicleTracker(FLEET)
    tracker.fold([OriginSample(0.0, *FLEET), sample(1.0)])
    assert tracker.fold([OriginSample(0.0, *FLEET)])[0].position_time_s == 101.0  # sent again, unchanged
    moved = OriginSample(0.0, *geodetic_from_enu((5.0, 0.0, 0.0), FLEET))
    assert tracker.fold([moved])[0].position_time_s == float("-inf")
    tracker.step(1.0, (), Flight())  # not in formation
    assert tracker.fold([sample(1.02)])[0].position_enu_m == pytest.approx((6.0, 2.0, 3.0), abs=1e-6)


def test_samples_are_accepted_after_a_reboot() -> None:
    tracker = VehicleTracker(None)
    tracker.fold([sample(1000.0)])
    assert tracker.fold([sample(2.0, (4.0, 5.0, 6.0))])[0].position_enu_m == (4.0, 5.0, 6.0)


def test_the_velocity_is_that_of_the_position_where_a_correction_is_given() -> None:
    tracker = VehicleTracker(None, velocity_correction=VelocityCorrection(2.0))
    states = [tracker.fold([sample(1.0 + 0.02 * tick, velocity=(0.1, 0.0, 0.0))])[0] for tick in range(500)]
    assert states[0].velocity_enu_m_s == (0.1, 0.0, 0.0)
    assert states[-1].velocity_enu_m_s == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    rebooted = tracker.fold([sample(0.0, velocity=(0.1, 0.0, 0.0))])[0]  # the autopilot's clock begins again
    assert rebooted.velocity_enu_m_s == (0.1, 0.0, 0.0)
