"""Vehicles that do not belong to the fleet, as a receiver of ADS-B or a tracking system publishes them."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from companion.types.bounds import Position

MAX_TRAFFIC_SPEED_M_S = 350.0
TrafficSpeed = Annotated[float, Meta(ge=-MAX_TRAFFIC_SPEED_M_S, le=MAX_TRAFFIC_SPEED_M_S)]


class TrafficSample(Struct, frozen=True, gc=False, forbid_unknown_fields=True):
    """Position and velocity in the fleet frame, `age_s` old when sent.

    `error_m` is one standard deviation of the position. Samples have no counter: two receivers may report one aircraft, and the
    newest position is used.
    """

    position_enu_m: Position
    velocity_enu_m_s: tuple[TrafficSpeed, TrafficSpeed, TrafficSpeed]
    age_s: Annotated[float, Meta(ge=0, le=10)] = 0.0
    error_m: Annotated[float, Meta(ge=0, le=100)] = 0.0


class ReceivedTraffic(Struct, frozen=True, gc=False):
    """A sample with its name on the network, such as the ICAO address of an aircraft."""

    received_s: float
    name: str
    sample: TrafficSample
