"""True positions of real autopilots: both messages, and the rows that become the track of a flight."""

from __future__ import annotations

import struct
from math import cos, pi, sin
from pathlib import Path

import pytest

from companion.config.fleet import GeodeticOrigin
from companion.mavlink.codec import MavlinkCodec, mavlink
from sitl.flight.true_positions import INTERVAL_US, TrueTrack
from sitl.links.cameras import TRUTH
from sitl.report.metrics import read_track

ORIGIN = GeodeticOrigin(47.397742, 8.545594, 488.0)
HIL, SIM, COMMAND = (
    mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION,
    mavlink.MAVLINK_MSG_ID_SIM_STATE,
    mavlink.MAVLINK_MSG_ID_COMMAND_LONG,
)


QUARTER_TURN = (cos(pi / 4), 0.0, 0.0, sin(pi / 4))  # nose to the east, of FRD in NED


def hil_state(
    vehicle_id: int, latitude: int, longitude: int, altitude_mm: int, attitude: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
) -> bytes:
    """As PX4 sends it: 1 m/s to the north, 2 to the east, 3 down; the rates and what comes after the velocity are 0."""
    velocity_cm_s = (100, 200, 300)
    payload = struct.pack(
        "<Q4f3f3i3h2H3h", 5, *attitude, 0, 0, 0, latitude, longitude, altitude_mm, *velocity_cm_s, *[0] * 5
    )
    return MavlinkCodec(vehicle_id, 1).encode(mavlink.mavlink_map[HIL](payload))


def sim_state(vehicle_id: int, latitude: int, longitude: int, altitude_m: float) -> bytes:
    """As ArduCopter sends it: latitude and longitude are also in floats, which are good to 0.5 m."""
    floats = [*QUARTER_TURN, *[0.0] * 9, float(latitude), float(longitude), altitude_m, 0.0, 0.0, 1.0, 2.0, 3.0]
    payload = struct.pack("<21f2i", *floats, latitude, longitude)
    return MavlinkCodec(vehicle_id, 1).encode(mavlink.mavlink_map[SIM](payload))


@pytest.mark.parametrize(
    "packet",
    [hil_state(2, 473_977_150, 85_455_543, 490_250), sim_state(2, 473_977_150, 85_455_543, 490.25)],
    ids=["PX4", "ArduCopter"],
)
def test_a_position_becomes_a_row_about_the_origin(tmp_path: Path, packet: bytes) -> None:
    file = tmp_path / "truth_2.csv"
    with file.open("w", encoding="ascii") as rows:
        track = TrueTrack(2, ORIGIN, rows.write)
        assert track.received(packet, 10.0)
    flown = read_track(file)
    assert flown.time_s.tolist() == [10.0]
    assert flown.position_enu_m[0] == pytest.approx([-2.993, -3.006, 2.25], abs=0.01)


@pytest.mark.parametrize(
    "packet",
    [hil_state(2, 473_977_150, 85_455_543, 490_250, QUARTER_TURN), sim_state(2, 473_977_150, 85_455_543, 490.25)],
    ids=["PX4", "ArduCopter"],
)
def test_cameras_see_the_pose_in_the_frames_of_the_fleet(packet: bytes) -> None:
    shown: list[bytes] = []
    assert TrueTrack(2, ORIGIN, lambda _line: None, shown.append).received(packet, 10.0)
    (datagram,) = shown
    vehicle_id, time_s, *pose = TRUTH.unpack(datagram)
    assert (vehicle_id, time_s) == (2, 10.0)
    assert pose[:3] == pytest.approx([-2.993, -3.006, 2.25], abs=0.01)
    assert pose[3:6] == pytest.approx([2.0, 1.0, -3.0])  # east, north, up
    assert pose[6:] == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-6)  # nose to the east: no turn of FLU in ENU


def test_a_state_without_an_attitude_is_a_row_and_no_pose() -> None:
    rows: list[str] = []
    shown: list[bytes] = []
    track = TrueTrack(2, ORIGIN, rows.append, shown.append)
    assert track.received(hil_state(2, 473_977_150, 85_455_543, 490_250, (0.0, 0.0, 0.0, 0.0)), 10.0)
    assert (len(rows), shown) == (2, [])


def test_rows_are_of_one_vehicle_and_their_times_rise() -> None:
    rows: list[str] = []
    track = TrueTrack(1, ORIGIN, rows.append)
    assert not track.received(hil_state(2, 1, 1, 1), 10.0)
    assert track.received(MavlinkCodec(1, 1).encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3)), 10.0)
    assert track.newest_s == float("-inf")
    first, last = sim_state(1, 473_977_420, 85_455_940, 489.0), sim_state(1, 473_977_420, 85_455_940, 490.0)
    track.received(first + last, 11.0)  # one read of a stream
    track.received(first, 11.0)
    track.received(last[:20], 11.5)
    track.received(last[20:], 12.0)
    assert rows == [
        "monotonic_s,x_m,y_m,z_m\n", "11.000000,0.0000,0.0000,2.0000\n", "12.000000,0.0000,0.0000,2.0000\n"
    ]  # fmt: skip


def test_arducopter_is_asked_for_its_true_position() -> None:
    (packet,) = MavlinkCodec(1, 1).read(TrueTrack(3, ORIGIN, lambda _line: None).request())
    message = packet.message
    assert (packet.message_id, message.target_system, message.target_component) == (COMMAND, 3, 1)
    assert (message.command, message.param1, message.param2) == (
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
        SIM,
        INTERVAL_US,
    )
