"""The true positions of real autopilots, from their own simulations: `python -m sitl.flight.true_positions FILE`.

PX4 in SIH sends HIL_STATE_QUATERNION by itself, ArduCopter SIM_STATE on request. truth_N.csv, beside FILE, has a row for each,
by the time of its arrival. Both have latitude and longitude in 1e-7 degrees: about 1 cm. Indoors the cameras get the poses.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import socket
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from msgspec import Meta

from companion.config.file import ConfigError, load
from companion.config.fleet import GeodeticOrigin
from companion.config.values import Section, VehicleId
from companion.config.vehicle import MavlinkEndpoint
from companion.geometry.frames import (
    Quaternion,
    enu_from_geodetic,
    enu_from_ned,
    euler_enu_from_ned,
    euler_from_quaternion,
    quaternion_from_euler,
)
from companion.link.byte_links import LinkError, open_link
from companion.mavlink.codec import MavlinkCodec, Packet, mavlink
from companion.types.values import Vector3
from sitl.flight.files import truth_path
from sitl.links.cameras import truth_datagram
from sitl.links.ports import LOOPBACK
from sitl.report.metrics import USED
from sitl.vehicle.config import Port

# attitude of FRD in NED; latitude, longitude [1e-7 deg], altitude AMSL [mm], velocity NED [cm/s]
HIL_STATE_QUATERNION = struct.Struct("<8x4f12x3i3h10x")
# attitude of FRD in NED; altitude AMSL [m], velocity NED [m/s], latitude, longitude [1e-7 deg]
SIM_STATE = struct.Struct("<4f44xf8x3f2i")
INTERVAL_US = 20_000
ASK_AGAIN_S = 1.0  # an autopilot that has just started does not listen yet
OWN_SYSTEM_ID, OWN_COMPONENT_ID = 254, 191  # a ground station's and a companion computer's heartbeat are not simulated


class TrueVehicle(Section, frozen=True):
    """Where the true position of one vehicle comes from."""

    id: VehicleId
    endpoint: MavlinkEndpoint


class TruePositionsFile(Section, frozen=True):
    """The vehicles of one flight, the zero of their positions, and the UDP port of the cameras that see them."""

    origin: GeodeticOrigin
    vehicles: Annotated[tuple[TrueVehicle, ...], Meta(min_length=1)]
    truth_port: Port | None = None


class TrueState(NamedTuple):
    """Latitude [deg], longitude [deg], altitude AMSL [m]; velocity; attitude of FRD in NED."""

    geodetic_deg_deg_m: Vector3
    velocity_ned_m_s: Vector3
    quaternion_ned: Quaternion


def true_state(packet: Packet) -> TrueState | None:
    """None for a packet of another message."""
    if packet.message_id == mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION:
        *quaternion, latitude, longitude, altitude_mm, vn, ve, vd = _unpacked(packet, HIL_STATE_QUATERNION)
        place, velocity_m_s = (latitude * 1e-7, longitude * 1e-7, altitude_mm * 1e-3), (vn * 0.01, ve * 0.01, vd * 0.01)
    elif packet.message_id == mavlink.MAVLINK_MSG_ID_SIM_STATE:
        *quaternion, altitude_m, vn, ve, vd, latitude, longitude = _unpacked(packet, SIM_STATE)
        place, velocity_m_s = (latitude * 1e-7, longitude * 1e-7, altitude_m), (vn, ve, vd)
    else:
        return None
    qw, qx, qy, qz = quaternion
    return TrueState(place, velocity_m_s, (qw, qx, qy, qz))


def _unpacked(packet: Packet, layout: struct.Struct) -> tuple[float, ...]:
    """The fields, with the zeros at the payload's end, which are not sent."""
    return layout.unpack(packet.payload[: layout.size].ljust(layout.size, b"\0"))


class TrueTrack:
    """Rows of one vehicle from the packets of its autopilot. `write` takes a line, `show` a datagram for the cameras."""

    def __init__(
        self,
        vehicle_id: int,
        origin: GeodeticOrigin,
        write: Callable[[str], object],
        show: Callable[[bytes], object] | None = None,
    ) -> None:
        self._vehicle_id, self._origin, self._write, self._show = vehicle_id, origin.as_tuple(), write, show
        self._codec = MavlinkCodec(OWN_SYSTEM_ID, OWN_COMPONENT_ID)
        self.newest_s = float("-inf")
        write(",".join(USED) + "\n")

    def received(self, data: bytes, received_s: float) -> bool:
        """Whether the bytes are from this autopilot. Of several states at once the last one is written."""
        own = [packet for packet in self._codec.read(data) if packet.system_id == self._vehicle_id]
        states = [state for packet in own if (state := true_state(packet)) is not None]
        if states and received_s > self.newest_s:
            self.newest_s = received_s
            position_m = enu_from_geodetic(*states[-1].geodetic_deg_deg_m, self._origin)
            self._write("{:.6f},{:.4f},{:.4f},{:.4f}\n".format(received_s, *position_m))
            if self._show:
                self._show_pose(states[-1], position_m, received_s)
        return bool(own)

    def _show_pose(self, state: TrueState, position_m: Vector3, received_s: float) -> None:
        assert self._show is not None
        with contextlib.suppress(ValueError):  # no attitude yet
            attitude = quaternion_from_euler(*euler_enu_from_ned(*euler_from_quaternion(state.quaternion_ned)))
            pose = (*position_m, *enu_from_ned(state.velocity_ned_m_s), *attitude)
            self._show(truth_datagram(self._vehicle_id, received_s, pose))

    def request(self) -> bytes:
        """Asks ArduCopter for SIM_STATE."""
        values = (mavlink.MAVLINK_MSG_ID_SIM_STATE, INTERVAL_US, 0, 0, 0, 0, 0)
        command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        return self._codec.encode(mavlink.MAVLink_command_long_message(self._vehicle_id, 1, command, 0, *values))


async def record(file: Path) -> None:
    """Record until SIGTERM or SIGINT. Raises ConfigError, LinkError, OSError."""
    wanted, loop, ended = load(file, TruePositionsFile), asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:

        def show(datagram: bytes) -> None:
            with contextlib.suppress(OSError):  # a full buffer loses this one
                out.sendto(datagram, (LOOPBACK, wanted.truth_port))

        shown = show if wanted.truth_port else None
        tasks: list[asyncio.Task[Any]] = [loop.create_task(ended.wait())]
        tasks += [loop.create_task(_record_one(one, wanted.origin, file.parent, shown)) for one in wanted.vehicles]
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()  # raises what ended it


async def _record_one(
    vehicle: TrueVehicle, origin: GeodeticOrigin, folder: Path, show: Callable[[bytes], object] | None
) -> None:
    with truth_path(folder, vehicle.id).open("w", encoding="ascii", buffering=1) as rows:
        track = TrueTrack(vehicle.id, origin, rows.write, show)
        link = open_link(vehicle.endpoint, track.received, lambda: None)
        async with asyncio.TaskGroup() as group:
            group.create_task(link.run())
            while True:
                asked_s = asyncio.get_running_loop().time()
                await asyncio.sleep(ASK_AGAIN_S)
                if track.newest_s < asked_s:
                    link.send(track.request())


def main() -> None:
    """Raises SystemExit."""
    try:
        asyncio.run(record(Path(sys.argv[1])))
    except (ConfigError, LinkError, OSError) as error:
        raise SystemExit(f"true positions: {error}") from error


if __name__ == "__main__":
    main()
