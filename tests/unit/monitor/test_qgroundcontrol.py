"""A fleet towards a ground station: a real UDP socket, with pymavlink's own parser as the receiver."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import closing

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from pymavlink.dialects.v20 import common

from common import ROOT, with_fields
from companion.config.fleet import FleetConfig
from companion.config.fleet_check import load_fleet
from companion.geometry.frames import enu_from_geodetic
from companion.ground.fleet_state import FleetState, fold, vehicles_at
from companion.link.byte_links import LinkError
from companion.monitor.qgroundcontrol import DENIALS_PER_STEP, TEXT_AGAIN_S, TEXTS_PER_STEP, FleetFeed
from companion.types.autopilot import LandedState
from companion.types.flight import FlightPhase, HealthFlag
from companion.types.status import Status
from companion.wire.messages import StatusReport
from ground_fleet import TIMING, leader, reported

FIELD = load_fleet(ROOT / "config/fleets/pair.yaml")


class GroundStation:
    """Receives and sends MAVLink on a port of its own, as QGroundControl does."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self._parser = common.MAVLink(None)
        self._parser.robust_parsing = False
        self.sender: tuple[str, int] = ("", 0)

    @property
    def endpoint(self) -> str:
        return f"udpout:127.0.0.1:{self.socket.getsockname()[1]}"

    def received(self) -> list[common.MAVLink_message]:
        messages: list[common.MAVLink_message] = []
        while True:
            try:
                data, self.sender = self.socket.recvfrom(4096)
            except BlockingIOError:
                return messages
            messages += self._parser.parse_buffer(data) or []

    def send(self, message: common.MAVLink_message) -> None:
        mav = common.MAVLink(None, srcSystem=255, srcComponent=190)
        self.socket.sendto(message.pack(mav), self.sender)


@pytest.fixture
def station() -> Iterator[GroundStation]:
    made = GroundStation()
    with closing(made.socket):
        yield made


class FedFleet(FleetFeed):
    """A feed with its own fold of statuses."""

    state = FleetState()

    def take(self, status: Status, now_s: float) -> None:
        self.state = fold(self.state, StatusReport(status, TIMING), now_s)

    def step(self, now_s: float) -> None:
        self.forward(vehicles_at(self.state, now_s), now_s)


@pytest.fixture
def feed(station: GroundStation) -> Iterator[FedFleet]:
    with FedFleet(station.endpoint, FIELD) as made:
        yield made


def of_fleet(status: Status) -> Status:
    return with_fields(status, fleet=FIELD.name)


def by_kind(messages: list[common.MAVLink_message], system: int) -> dict[str, common.MAVLink_message]:
    return {message.get_type(): message for message in messages if message.get_srcSystem() == system}


def test_two_vehicles_are_two_systems(feed: FedFleet, station: GroundStation) -> None:
    feed.take(of_fleet(leader(position_enu_m=(10.0, 20.0, 2.5))), 100.0)
    feed.take(of_fleet(reported(7, armed=False, phase=FlightPhase.READY, landed=LandedState.ON_GROUND)), 100.0)
    feed.step(100.0)
    messages = station.received()
    first, second = by_kind(messages, 1), by_kind(messages, 7)
    expected = {
        "HEARTBEAT", "SYS_STATUS", "BATTERY_STATUS", "EXTENDED_SYS_STATE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"
    }  # fmt: skip
    assert set(first) == set(second) == expected
    assert {message.get_srcComponent() for message in messages} == {common.MAV_COMP_ID_AUTOPILOT1}
    beat = first["HEARTBEAT"]
    assert (beat.type, beat.autopilot) == (common.MAV_TYPE_QUADROTOR, common.MAV_AUTOPILOT_GENERIC)
    assert beat.base_mode == common.MAV_MODE_FLAG_SAFETY_ARMED | common.MAV_MODE_FLAG_GUIDED_ENABLED
    assert beat.system_status == common.MAV_STATE_ACTIVE
    assert (second["HEARTBEAT"].base_mode, second["HEARTBEAT"].system_status) == (0, common.MAV_STATE_STANDBY)
    assert first["SYS_STATUS"].battery_remaining == first["BATTERY_STATUS"].battery_remaining == 87
    assert second["EXTENDED_SYS_STATE"].landed_state == common.MAV_LANDED_STATE_ON_GROUND


def test_positions_are_where_the_vehicle_is(feed: FedFleet, station: GroundStation) -> None:
    feed.take(of_fleet(leader(position_enu_m=(10.0, 20.0, 2.5), velocity_enu_m_s=(3.0, 0.0, -1.0))), 100.0)
    feed.step(100.0)
    read = by_kind(station.received(), 1)
    local, glob = read["LOCAL_POSITION_NED"], read["GLOBAL_POSITION_INT"]
    assert (local.x, local.y, local.z) == pytest.approx((20.0, 10.0, -2.5))
    back = enu_from_geodetic(glob.lat / 1e7, glob.lon / 1e7, glob.alt / 1e3, FIELD.origin.as_tuple())
    assert back == pytest.approx((10.0, 20.0, 2.5), abs=0.02)
    assert glob.relative_alt == 2500
    assert (glob.vx, glob.vy, glob.vz) == (0, 300, 100)
    assert glob.hdg == 9000  # east


def test_a_position_across_the_180th_meridian_is_within_the_globe(station: GroundStation) -> None:
    origin = replace(FIELD.origin, longitude_deg=179.9999)
    with FedFleet(station.endpoint, replace(FIELD, origin=origin)) as feed:
        feed.take(of_fleet(leader(position_enu_m=(100.0, 20.0, 2.5))), 100.0)
        feed.step(100.0)
        glob = by_kind(station.received(), 1)["GLOBAL_POSITION_INT"]
    assert -1_800_000_000 < glob.lon < -1_799_000_000
    back = enu_from_geodetic(glob.lat / 1e7, glob.lon / 1e7, glob.alt / 1e3, origin.as_tuple())
    assert back == pytest.approx((100.0, 20.0, 2.5), abs=0.02)


def test_without_a_course_there_is_no_heading_and_never_an_attitude(feed: FedFleet, station: GroundStation) -> None:
    feed.take(of_fleet(leader(velocity_enu_m_s=(0.1, 0.0, 0.0))), 100.0)
    feed.step(100.0)
    read = by_kind(station.received(), 1)
    assert read["GLOBAL_POSITION_INT"].hdg == 65535
    assert "ATTITUDE" not in read


def test_rates_are_bounded(feed: FedFleet, station: GroundStation) -> None:
    for i in range(1000):  # ten seconds
        feed.take(of_fleet(leader()), 100.0 + 0.01 * i)
        feed.step(100.0 + 0.01 * i)
    kinds = [message.get_type() for message in station.received()]
    assert kinds.count("HEARTBEAT") == 10
    assert 45 <= kinds.count("GLOBAL_POSITION_INT") <= 50


def test_late_steps_do_not_lower_the_rates(feed: FedFleet, station: GroundStation) -> None:
    for i in range(100):  # ten steps a second, each a little later than the last
        feed.take(of_fleet(leader()), 100.0 + 0.1003 * i)
        feed.step(100.0 + 0.1003 * i)
    kinds = [message.get_type() for message in station.received()]
    assert kinds.count("HEARTBEAT") == 10
    assert kinds.count("GLOBAL_POSITION_INT") == 50


def test_a_recording_that_goes_back_sends_no_vehicle_of_its_future(feed: FedFleet, station: GroundStation) -> None:
    feed.take(of_fleet(leader()), 100.0)
    feed.step(100.0)
    assert station.received()
    feed.forward([], 99.5)
    assert station.received() == []
    feed.take(of_fleet(leader()), 99.6)
    feed.step(99.6)
    assert station.received()


def test_a_silent_vehicle_is_not_sent_and_comes_back(feed: FedFleet, station: GroundStation) -> None:
    feed.take(of_fleet(leader()), 100.0)
    feed.step(101.5)
    assert station.received() == []
    feed.take(of_fleet(leader()), 102.0)
    feed.step(102.0)
    assert "HEARTBEAT" in by_kind(station.received(), 1)


@pytest.mark.parametrize(
    "change",
    [{"state_age_s": 1e9}, {"position_enu_m": (1e300, 0.0, 0.0)}, {"velocity_enu_m_s": (0.0, 0.0, -301.0)}],
)
def test_an_old_or_impossible_position_is_left_out(
    change: dict[str, object], feed: FedFleet, station: GroundStation
) -> None:
    feed.take(of_fleet(leader(**change)), 100.0)
    feed.step(100.0)
    read = by_kind(station.received(), 1)
    assert "HEARTBEAT" in read
    assert not {"LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"} & read.keys()


@given(
    st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3),
    st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3),
    st.none() | st.floats(allow_nan=False, allow_infinity=False),
)
def test_no_status_that_can_be_decoded_ends_the_feed(
    position_enu_m: tuple, velocity_enu_m_s: tuple, battery_percent: float | None
) -> None:
    with FedFleet("udpout:127.0.0.1:9", FIELD) as feed:
        hostile = leader(
            position_enu_m=position_enu_m, velocity_enu_m_s=velocity_enu_m_s, battery_percent=battery_percent
        )
        feed.take(of_fleet(hostile), 100.0)
        feed.step(100.0)


def texts(station: GroundStation) -> list[str]:
    return [message.text for message in station.received() if message.get_type() == "STATUSTEXT"]


def test_a_new_flag_is_a_text_once(feed: FedFleet, station: GroundStation) -> None:
    flagged = of_fleet(leader(flags=(HealthFlag.OUTSIDE_FENCE,)))
    for i in range(5):
        feed.take(flagged, 100.0 + 0.1 * i)
        feed.step(100.0 + 0.1 * i)
    assert texts(station) == ["OUTSIDE_FENCE: outside the fence"]
    for i, flags in enumerate([(), (HealthFlag.OUTSIDE_FENCE,)] * 20):  # it comes and goes for four seconds
        feed.take(of_fleet(leader(flags=flags)), 101.0 + 0.1 * i)
        feed.step(101.0 + 0.1 * i)
    assert texts(station) == []
    feed.take(flagged, 101.0 + TEXT_AGAIN_S)
    feed.step(101.0 + TEXT_AGAIN_S)
    assert len(texts(station)) <= 1


def test_on_the_ground_no_leader_is_missed(feed: FedFleet, station: GroundStation) -> None:
    feed.take(of_fleet(reported(2, phase=FlightPhase.READY, flags=(HealthFlag.LEADER_LOST,))), 100.0)
    feed.step(100.0)
    assert texts(station) == []
    feed.take(of_fleet(reported(2, flags=(HealthFlag.LEADER_LOST,))), 101.0)
    feed.step(101.0)
    assert texts(station) == ["LEADER_LOST: no fresh leader beacon"]


def test_many_flags_come_in_steps(feed: FedFleet, station: GroundStation) -> None:
    feed.take(of_fleet(leader(flags=tuple(HealthFlag))), 100.0)
    feed.step(100.0)
    assert len(texts(station)) == TEXTS_PER_STEP
    for i in range(1, 9):
        feed.step(100.0 + 0.1 * i)
    assert len(texts(station)) == len(HealthFlag) - TEXTS_PER_STEP


def command(target: int) -> common.MAVLink_message:
    return common.MAVLink_command_long_message(target, 1, common.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, 0, 0, 0, 0, 0, 0)


def test_a_command_is_denied_and_everything_else_ignored(feed: FedFleet, station: GroundStation) -> None:
    feed.take(of_fleet(leader()), 100.0)
    feed.step(100.0)
    station.received()
    station.send(common.MAVLink_param_request_list_message(1, 1))
    station.send(command(1))
    station.send(command(99))
    station.socket.sendto(b"\xfd noise", station.sender)
    feed.step(100.01)
    (answer,) = station.received()
    assert (answer.get_type(), answer.get_srcSystem()) == ("COMMAND_ACK", 1)
    assert (answer.command, answer.result) == (common.MAV_CMD_COMPONENT_ARM_DISARM, common.MAV_RESULT_DENIED)
    assert (feed.ignored, feed.denied) == (3, 1)


def test_a_flood_of_commands_has_few_answers(feed: FedFleet, station: GroundStation) -> None:
    feed.take(of_fleet(leader()), 100.0)
    feed.step(100.0)
    station.received()
    for _ in range(50):
        station.send(command(1))
    feed.step(100.01)
    assert len(station.received()) == DENIALS_PER_STEP
    assert feed.denied == 50


def test_a_stranger_is_not_received(feed: FedFleet, station: GroundStation) -> None:
    feed.take(of_fleet(leader()), 100.0)
    feed.step(100.0)
    station.received()
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as stranger:
        stranger.sendto(command(1).pack(common.MAVLink(None, srcSystem=254)), station.sender)
    feed.step(100.01)
    assert feed.ignored == 0


def test_a_fleet_without_a_geodetic_origin_has_local_positions(station: GroundStation) -> None:
    indoor: FleetConfig = replace(FIELD, origin="indoor")
    with FedFleet(station.endpoint, indoor) as feed:
        feed.take(of_fleet(leader()), 100.0)
        feed.step(100.0)
    read = by_kind(station.received(), 1)
    assert "LOCAL_POSITION_NED" in read
    assert "GLOBAL_POSITION_INT" not in read


def test_another_fleet_is_not_sent(feed: FedFleet, station: GroundStation) -> None:
    feed.take(with_fields(leader(), fleet="strangers"), 100.0)
    feed.step(100.0)
    assert station.received() == []


@pytest.mark.parametrize(
    "endpoint", ["udpin:127.0.0.1:14550", "udpout:127.0.0.1", "udpout:127.0.0.1:0", "udpout:x:70000", "udpout:a..b:1"]
)
def test_an_endpoint_that_cannot_be_used_is_one_line(endpoint: str) -> None:
    with pytest.raises(LinkError) as error:
        FleetFeed(endpoint, FIELD)
    assert "\n" not in str(error.value)


def test_an_empty_ground_station_is_no_error() -> None:
    """Nothing listens there: ICMP errors come back."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with FedFleet(f"udpout:127.0.0.1:{port}", FIELD) as feed:
        for i in range(20):
            feed.take(of_fleet(leader()), 100.0 + i)
            feed.step(100.0 + i)


def test_a_recording_that_goes_back_is_sent_at_once(feed: FedFleet, station: GroundStation) -> None:
    for now_s in (100.0, 500.0, 400.0, 50.0):
        feed.take(of_fleet(leader()), now_s)
        feed.step(now_s)
        assert "HEARTBEAT" in by_kind(station.received(), 1)
