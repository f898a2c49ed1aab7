"""Ports derived from vehicle ids, as the simulations of PX4 and ArduPilot derive them: instance i is id - 1.

`offset` moves all of them, so that two fleets can fly on one machine.
"""

from __future__ import annotations

from dataclasses import dataclass

LOOPBACK = "127.0.0.1"
GROUND_STATION_PORT = 14550  # where QGroundControl listens


@dataclass(frozen=True, slots=True)
class Ports:
    """UDP and TCP ports of one vehicle."""

    onboard: int  # the autopilot's, towards the companion
    companion: int  # the companion's: the autopilot sends there from the start
    ground_link: int  # the autopilot's, towards a ground station
    tcp: int  # the autopilot's, where it listens with ArduPilot's manners
    zenoh: int  # the agent's listener


def ports_of(vehicle_id: int, offset: int = 0) -> Ports:
    instance = vehicle_id - 1 + offset
    return Ports(
        onboard=14580 + instance,
        companion=14540 + instance,
        ground_link=18570 + instance,
        tcp=5760 + 10 * (vehicle_id - 1) + offset,
        zenoh=7447 + vehicle_id + offset,
    )
