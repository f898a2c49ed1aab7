"""The direct link without sockets carries the same values as MAVLink messages over bytes, but for the rounding of those."""

from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from companion.mavlink.codec import MavlinkCodec, mavlink
from companion.mavlink.translator import Translator
from companion.types.autopilot import (
    AckSample,
    AttitudeSample,
    AttitudeTarget,
    AutopilotKind,
    OriginSample,
    PositionSample,
    RequestOrigin,
    Telemetry,
)
from sitl.autopilots.autopilot import DT_S
from sitl.autopilots.messages import BUILDERS
from sitl.autopilots.px4 import link as px4_link
from sitl.autopilots.px4.autopilot import Px4, Px4Mode
from sitl.autopilots.types import AUTOPILOT_TYPES
from sitl.links.direct_link import SAMPLES, DirectLink, rates_hz, setpoint_of
from sitl.vehicle.config import AutopilotFile, BatteryLevel, Links, StandIn

RECEIVED_S = 12.5
RATES_HZ = rates_hz(AutopilotKind.PX4)
OF_PX4 = (*RATES_HZ, mavlink.MAVLINK_MSG_ID_MISSION_CURRENT)  # the last one without being asked
MICRORADIAN = 1e-6
ROUNDED = 0.6e-4  # half of the coarsest step of received telemetry, 0.1 mm
ROUNDED_RAD = 0.6e-5
LOW_SOON = StandIn(seed=5, batteries=(BatteryLevel(vehicle=3, at_s=5.0, percent=14),))


def flying() -> Iterator[Px4]:
    """One stand-in with noise, at several times of a flight."""
    px4 = Px4(AutopilotFile(id=3, start_enu_m=(12.3, -4.5, 0.0), start_yaw_deg=130.0, stand_in=LOW_SOON), DT_S)
    yield px4
    for step in range(3000):
        px4.step()
        if step == 1100:
            px4.arm()
            px4.take_off(None)
        if step in (1150, 1500, 2500):
            yield px4
    assert px4.set_mode(Px4Mode.LAND)
    yield px4


def by_bytes(px4: Px4, message_id: int) -> list[Telemetry]:
    data = MavlinkCodec(px4.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1).encode(BUILDERS[message_id](px4))
    return Translator(px4.system_id, AutopilotKind.PX4).telemetry(data, RECEIVED_S)


def flat(value: Any) -> list[Any]:
    """All values of a sample, those of its vectors one by one."""
    if isinstance(value, msgspec.Struct):
        value = msgspec.structs.astuple(value)
    return [leaf for part in value for leaf in flat(part)] if isinstance(value, tuple) else [value]


@pytest.mark.parametrize("message_id", [i for i in OF_PX4 if i != mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION])
def test_samples_equal_those_of_the_messages(message_id: int) -> None:
    for px4 in flying():
        direct, received = SAMPLES[message_id](px4, RECEIVED_S), by_bytes(px4, message_id)
        assert [type(sample) for sample in direct] == [type(sample) for sample in received]
        for one, other in zip(direct, received, strict=True):
            pairs = list(zip(flat(one), flat(other), strict=True))
            assert [(a, b) for a, b in pairs if a != b and not (isinstance(a, float) and abs(a - b) < ROUNDED)] == []


def test_attitudes_equal_those_of_the_messages() -> None:
    for px4 in flying():
        (direct,) = SAMPLES[mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION](px4, RECEIVED_S)
        (received,) = by_bytes(px4, mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION)
        assert isinstance(direct, AttitudeSample)
        assert isinstance(received, AttitudeSample)
        assert direct.received_s == received.received_s
        assert (direct.roll_rad, direct.pitch_rad, direct.yaw_rad) == pytest.approx(
            (received.roll_rad, received.pitch_rad, received.yaw_rad), abs=ROUNDED_RAD
        )


def test_all_requested_messages_are_sent() -> None:
    assert SAMPLES.keys() == set(OF_PX4) | rates_hz(AutopilotKind.ARDUPILOT).keys()
    assert RATES_HZ[mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED] == 50.0


@pytest.mark.parametrize("target", [AttitudeTarget(0.1, -0.2, 3.0, 0.51), AttitudeTarget(-0.3, 0.05, -3.1, 0.2)])
def test_setpoints_equal_those_of_the_messages_to_a_microradian(target: AttitudeTarget) -> None:
    (message,) = MavlinkCodec(1, 1).decode(Translator(1, AutopilotKind.PX4).attitude_target(target, 3.0))
    received = px4_link.setpoint_of(message, (1.0, 0.0, 0.0, 0.0))
    direct = setpoint_of(AutopilotKind.PX4, target)
    assert received is not None
    assert direct.quaternion == pytest.approx(received.quaternion, abs=MICRORADIAN)
    assert direct.thrust_norm == pytest.approx(received.thrust_norm, abs=1e-7)
    assert direct.rates_rad_s is received.rates_rad_s is None
    assert direct.yaw_rate_rad_s == received.yaw_rate_rad_s == 0.0


def direct_link(links: Links, phase_s: float) -> DirectLink:
    px4 = AUTOPILOT_TYPES[AutopilotKind.PX4].vehicle(AutopilotFile(), DT_S)
    return DirectLink(px4, AUTOPILOT_TYPES[AutopilotKind.PX4].onboard_link(px4), links, phase_s)


def stepped(link: DirectLink, first: int, last: int) -> None:
    for step in range(first, last + 1):
        link.deliver(step * DT_S)
        link.autopilot.step()
        link.send_telemetry(step * DT_S)


def test_a_request_is_answered_after_both_delays() -> None:
    links = Links(telemetry_delay_s=0.03, setpoint_delay_s=0.05)
    link = direct_link(links, phase_s=10.0)
    link.request(RequestOrigin(), 0.0)
    stepped(link, 1, 30)
    assert link.drain(0.0815) == ()
    origin, acknowledgement = link.drain(0.0825)
    assert isinstance(origin, OriginSample)
    assert origin.received_s == pytest.approx(0.082)
    assert isinstance(acknowledgement, AckSample)
    assert acknowledgement.accepted


def test_a_setpoint_acts_from_the_step_after_its_arrival() -> None:
    link = direct_link(Links(setpoint_delay_s=0.006), phase_s=10.0)
    link.command(AttitudeTarget(0.0, 0.0, 0.0, 0.5), 0.0003)
    stepped(link, 1, 1)
    assert isinstance(link.autopilot, Px4)
    assert not link.autopilot.streaming
    stepped(link, 2, 2)
    assert link.autopilot.streaming


def test_positions_trigger_ticks_at_50_hz_from_their_phase() -> None:
    link = direct_link(Links(telemetry_delay_s=0.001), phase_s=0.008)
    ticks, samples = [], []
    for step in range(1, 51):
        stepped(link, step, step)
        while (position_s := link.position_s) < (step + 1) * DT_S:
            link.take_position()
            ticks.append(position_s)
            samples += link.drain(position_s)
    assert ticks == pytest.approx([0.009 + 0.02 * i for i in range(10)])
    assert [s.received_s for s in samples if isinstance(s, PositionSample)] == ticks
