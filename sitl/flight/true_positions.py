"""The true positions of real autopilots, from their own simulations: `python -m sitl.flight.true_positions FILE`.

PX4 in SIH sends HIL_STATE_QUATERNION by itself, ArduCopter SIM_STATE on request. truth_N.csv, beside FILE, has a row for each,
by the time of its arrival. Both have latitude and longitude in 1e-7 degrees: about 1 cm.
"""

from __future__ import annotations

import asyncio
import signal
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from companion.config.file import ConfigError, load
from companion.config.fleet import GeodeticOrigin
from companion.config.values import Section, VehicleId
from companion.config.vehicle import MavlinkEndpoint
from companion.geometry.frames import enu_from_geodetic
from companion.link.byte_links import LinkError, open_link
from companion.mavlink.codec import MavlinkCodec, Packet, mavlink
from companion.types.values import Vector3
from sitl.flight.files import truth_path
from sitl.report.metrics import USED

HIL_STATE_QUATERNION = struct.Struct("<36xiii16x")  # latitude, longitude [1e-7 deg], altitude AMSL [mm]
SIM_STATE = struct.Struct("<60xf20xii")  # altitude AMSL [m], latitude, longitude [1e-7 deg]
INTERVAL_US = 20_000
ASK_AGAIN_S = 1.0  # an autopilot that has just started does not listen yet
OWN_SYSTEM_ID, OWN_COMPONENT_ID = 254, 191  # a ground station's and a companion computer's heartbeat are not simulated


class TrueVehicle(Section, frozen=True):
    """Where the true position of one vehicle comes from."""

    id: VehicleId
    endpoint: MavlinkEndpoint


class TruePositionsFile(Section, frozen=True):
    """The vehicles of one flight, and the zero of their positions."""

    origin: GeodeticOrigin
    vehicles: Annotated[tuple[TrueVehicle, ...], Meta(min_length=1)]


def true_geodetic(packet: Packet) -> Vector3 | None:
    """Latitude [deg], longitude [deg], altitude AMSL [m]; None for a packet of another message."""
    if packet.message_id == mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION:
        latitude, longitude, altitude_mm = HIL_STATE_QUATERNION.unpack(_whole(packet, HIL_STATE_QUATERNION))
        return latitude * 1e-7, longitude * 1e-7, altitude_mm * 1e-3
    if packet.message_id == mavlink.MAVLINK_MSG_ID_SIM_STATE:
        altitude_m, latitude, longitude = SIM_STATE.unpack(_whole(packet, SIM_STATE))
        return latitude * 1e-7, longitude * 1e-7, altitude_m
    return None


def _whole(packet: Packet, layout: struct.Struct) -> bytes:
    """The payload with the zeros at its end, which are not sent."""
    return packet.payload[: layout.size].ljust(layout.size, b"\0")


class TrueTrack:
    """Rows of one vehicle from the packets of its autopilot. `write` takes a line."""

    def __init__(self, vehicle_id: int, origin: GeodeticOrigin, write: Callable[[str], object]) -> None:
        self._vehicle_id, self._origin, self._write = vehicle_id, origin.as_tuple(), write
        self._codec = MavlinkCodec(OWN_SYSTEM_ID, OWN_COMPONENT_ID)
        self.newest_s = float("-inf")
        write(",".join(USED) + "\n")

    def received(self, data: bytes, received_s: float) -> bool:
        """Whether the bytes are from this autopilot. Of several positions at once the last one is written."""
        own = [packet for packet in self._codec.read(data) if packet.system_id == self._vehicle_id]
        positions = [position for packet in own if (position := true_geodetic(packet)) is not None]
        if positions and received_s > self.newest_s:
            self.newest_s = received_s
            x, y, z = enu_from_geodetic(*positions[-1], self._origin)
            self._write(f"{received_s:.6f},{x:.4f},{y:.4f},{z:.4f}\n")
        return bool(own)

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
    tasks: list[asyncio.Task[Any]] = [loop.create_task(ended.wait())]
    tasks += [loop.create_task(_record_one(one, wanted.origin, file.parent)) for one in wanted.vehicles]
    done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    for task in done:
        task.result()  # raises what ended it


async def _record_one(vehicle: TrueVehicle, origin: GeodeticOrigin, folder: Path) -> None:
    with truth_path(folder, vehicle.id).open("w", encoding="ascii", buffering=1) as rows:
        track = TrueTrack(vehicle.id, origin, rows.write)
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
