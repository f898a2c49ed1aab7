"""A fleet file: the settings that all vehicles of a fleet share. Its hash is part of every peer packet."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta
from msgspec.structs import replace

from companion.config.law import LawSection
from companion.config.values import Name, NetworkAddress, ObstacleSection, PointM, PositionM, Section, VehicleId
from companion.geometry.airspace import Airspace, Fence
from companion.types.flight import Role
from companion.types.values import Vector3


class GeodeticOrigin(Section, frozen=True):
    """The zero of the fleet frame (ENU), as WGS84 latitude and longitude.

    latitude_deg: WGS84 latitude
    longitude_deg: WGS84 longitude
    altitude_amsl_m: altitude above mean sea level
    """

    latitude_deg: Annotated[float, Meta(ge=-85, le=85)]
    longitude_deg: Annotated[float, Meta(ge=-180, le=180)]
    altitude_amsl_m: Annotated[float, Meta(ge=-500, le=9000)]

    def as_tuple(self) -> Vector3:
        """Latitude [deg], longitude [deg], altitude [m]."""
        return (self.latitude_deg, self.longitude_deg, self.altitude_amsl_m)


class FormationMember(Section, frozen=True):
    """A vehicle of the fleet with its slot.

    role: role at the start; at least one vehicle is `leader`
    slot_enu_m: d_i0 of eq. 12, the offset of the slot from the RFT
    may_lead: `true`: a follower that can be made leader; its vehicle file then holds the reference
    address: where the agent of the vehicle listens in the network of the fleet, like `192.168.1.11:7447`
    """

    id: VehicleId
    role: Role
    slot_enu_m: PositionM
    may_lead: bool = False
    address: NetworkAddress | None = None

    @property
    def can_lead(self) -> bool:
        """Whether the vehicle holds the RFT: leaders at the start, and those with `may_lead`."""
        return self.may_lead or self.role == Role.LEADER


class RangeNeighbours(Section, frozen=True, tag_field="kind", tag="range"):
    """Neighbours by distance.

    range_m: a vehicle within this distance becomes a neighbour
    hysteresis_m: a neighbour stays one until it is this much farther away than the range
    """

    range_m: Annotated[float, Meta(gt=0, le=10_000)]
    hysteresis_m: Annotated[float, Meta(ge=0, le=1_000)] = 0.0


class EdgeNeighbours(Section, frozen=True, tag_field="kind", tag="edges"):
    """Neighbours by a fixed list.

    edges: pairs of vehicle ids that are neighbours of each other, like `[[1, 2], [2, 3]]`
    """

    edges: tuple[tuple[VehicleId, VehicleId], ...]


class PeerLimits(Section, frozen=True):
    """Limits that received peer states must meet.

    max_age_s: an older peer state is not used; at most 0.3 s, as the separation filter predicts no longer by it
    leader_beacon_max_age_s: without a newer leader beacon for this time the leader is lost
    full_rate_up_to: in a fleet of up to so many vehicles each receives all others at 50 Hz; in a larger one, those far
        away in formation at 5 Hz
    max_speed_m_s: a peer state with a larger speed is rejected; also limits references
    """

    max_age_s: Annotated[float, Meta(gt=0.02, le=0.3)] = 0.3  # the last acceleration predicts a motion for no longer
    leader_beacon_max_age_s: Annotated[float, Meta(gt=0.02, le=10)] = 0.25  # two hops on it is missed within 0.3 s
    full_rate_up_to: Annotated[int, Meta(ge=1, le=250)] = 8
    max_speed_m_s: Annotated[float, Meta(gt=0, le=100)] = 25.0


class Envelope(Section, frozen=True):
    """Limits of speed, limits on every setpoint, and the fence: a box in the fleet frame, less what is outside a polygon.

    max_speed_m_s: largest horizontal speed of a vehicle; also limits references
    max_climb_m_s: largest climb rate
    max_descent_m_s: largest descent rate
    max_tilt_deg: largest commanded tilt
    max_tilt_rate_deg_s: largest change of the commanded tilt per second; at least max_tilt_deg in 0.5 s
    min_thrust_ratio: smallest thrust, as a share of hover thrust
    max_thrust_ratio: largest thrust, as a multiple of hover thrust
    max_thrust_rate_1_s: largest change of the thrust, in hover thrusts per second
    fence_min_enu_m: lowest x, y, z of the fence; z is its floor
    fence_max_enu_m: highest x, y, z of the fence; z is its ceiling
    fence_corners_enu_m: corners x, y of a polygon, in order: the part of the box inside it is the fence; may be concave
    clearance_m: distance that vehicles keep from the fence and from obstacles
    """

    max_speed_m_s: Annotated[float, Meta(ge=0.5, le=50)] = 12.0  # MPC_XY_VEL_MAX
    max_climb_m_s: Annotated[float, Meta(ge=0.5, le=20)] = 3.0  # MPC_Z_VEL_MAX_UP
    max_descent_m_s: Annotated[float, Meta(ge=0.5, le=20)] = 2.0
    max_tilt_deg: Annotated[float, Meta(gt=0, le=45)] = 25.0
    max_tilt_rate_deg_s: Annotated[float, Meta(gt=0, le=1000)] = 120.0  # 2.4 degrees from one setpoint to the next
    min_thrust_ratio: Annotated[float, Meta(gt=0, lt=1)] = 0.3
    max_thrust_ratio: Annotated[float, Meta(gt=1, le=4)] = 1.6
    max_thrust_rate_1_s: Annotated[float, Meta(gt=0, le=100)] = 10.0
    fence_min_enu_m: PositionM = (
        -100.0,
        -100.0,
        -5.0,
    )
    fence_max_enu_m: PositionM = (
        100.0,
        100.0,
        50.0,
    )
    fence_corners_enu_m: Annotated[tuple[PointM, ...], Meta(max_length=100)] = ()
    clearance_m: Annotated[float, Meta(ge=0, le=100)] = 0.5


class VisionSettings(Section, frozen=True):
    """Poses of a motion-capture system in place of GPS, which `companion mocap` publishes. Needs `origin: indoor`.

    place: place of the zero of the fleet frame; each autopilot gets it as its origin, before it is armed
    rate_hz: poses a second that are passed on to an autopilot, at most
    position_error_m: one sigma of a position
    angle_error_deg: one sigma of an angle
    """

    place: GeodeticOrigin
    rate_hz: Annotated[float, Meta(ge=10, le=200)] = 50.0
    position_error_m: Annotated[float, Meta(ge=0.0005, le=1)] = 0.01
    angle_error_deg: Annotated[float, Meta(ge=0.05, le=20)] = 1.0


Hour = Annotated[float, Meta(gt=0, le=3600)]  # a time in seconds
Charge = Annotated[float, Meta(gt=0, le=90)]


class FleetSettings(Section, frozen=True, kw_only=True):
    """Settings of a fleet beside its vehicles and their neighbours.

    altitude_source: zero of z: `origin`, the altitude of the origin; `takeoff`, the altitude where each vehicle was
        armed, for fleets that start from level ground
    ground_spread_m: largest difference in altitude on the ground with which vehicles take off
    separation_m: smallest distance between vehicles at take-off and between slots, also during a formation change
    slot_speed_m_s: largest speed of a slot in a formation change and in a turn
    hand_over_speed_m_s: largest speed added while the fleet changes from one reference to another
    hand_over_acceleration_m_s2: largest acceleration added while the fleet changes to another reference
    formation_heading: x axis of the slots: `fixed`, always east; `course`, the direction in which the RFT moves
    takeoff_height_m: height of the take-off above the ground
    successors: vehicles that may lead; the first of them in formation becomes leader when the leader is lost
    land_after_s: time in hold without a leader after which a vehicle lands; without a value it holds
    when_one_leaves: `keep_gap`: the slot of a vehicle that left stays free; `close_up`: the others fill it, which needs
        edges that stay connected without any one vehicle
    leave_below_percent: a vehicle whose battery stays below this charge leaves the formation and lands
    low_battery_action: what follows `leave_below_percent`; `return` becomes `land` where the way home is not free
    land_below_percent: a vehicle whose battery stays below this charge lands, also from a commanded hold
    leader_holds_after_s: time after which a leader in formation that receives no other vehicle goes into hold
    transport: protocol between the addresses; with identities `tcp` is TLS over TCP; `quic` needs identities
    multicast: group and port, like `239.255.77.1:7446`: states of the vehicles as UDP multicast, for radio links that
        lose packets; with identities each datagram is authenticated
    security: `none`: agents without an identity may use a network; all who reach it can command the fleet
    obstacles: static obstacles, which all vehicles avoid
    external_vision: poses of a motion-capture system in place of GPS
    """

    altitude_source: Literal["origin", "takeoff"] = "origin"
    ground_spread_m: Annotated[float, Meta(gt=0, le=1000)] = 1.0
    law: LawSection = LawSection()
    separation_m: Annotated[float, Meta(gt=0, le=1000)] = 1.0
    slot_speed_m_s: Annotated[float, Meta(gt=0, le=50)] = 1.0
    hand_over_speed_m_s: Annotated[float, Meta(gt=0, le=50)] = 2.0
    hand_over_acceleration_m_s2: Annotated[float, Meta(gt=0, le=20)] = 1.0
    formation_heading: Literal["fixed", "course"] = "fixed"
    takeoff_height_m: Annotated[float, Meta(ge=0.5, le=120)] = 2.5
    successors: tuple[VehicleId, ...] = ()
    land_after_s: Hour | None = None
    when_one_leaves: Literal["keep_gap", "close_up"] = "keep_gap"
    leave_below_percent: Charge | None = None
    low_battery_action: Literal["hold", "return", "land"] = "land"
    land_below_percent: Charge | None = None
    leader_holds_after_s: Annotated[float, Meta(gt=0, le=3600)] = 5.0
    transport: Literal["tcp", "quic"] = "tcp"
    multicast: NetworkAddress | None = None
    security: Literal["none"] | None = None
    peers: PeerLimits = PeerLimits()
    envelope: Envelope = Envelope()
    obstacles: Annotated[tuple[ObstacleSection, ...], Meta(max_length=100)] = ()
    external_vision: VisionSettings | None = None

    @property
    def airspace(self) -> Airspace:
        """Fence and obstacles, with the clearance."""
        envelope = self.envelope
        fence = Fence(envelope.fence_min_enu_m, envelope.fence_max_enu_m, envelope.fence_corners_enu_m)
        return Airspace(fence, tuple(obstacle.body for obstacle in self.obstacles), envelope.clearance_m)

    @property
    def slots_turn(self) -> bool:
        """Whether the slots turn about the RFT with its course."""
        return self.formation_heading == "course"


class FleetConfig(FleetSettings, frozen=True, kw_only=True):
    """Settings that all vehicles of a fleet share. Every vehicle needs the same file.

    name: name of the fleet on the network (a part of its Zenoh keys)
    origin: zero of the fleet frame; `indoor` where one motion-capture system gives all vehicles one frame
    vehicles: the vehicles with their roles and slots
    neighbours: the neighbours of each vehicle
    """

    name: Name
    origin: GeodeticOrigin | Literal["indoor"]
    vehicles: tuple[FormationMember, ...]
    neighbours: EdgeNeighbours | RangeNeighbours

    @property
    def place(self) -> GeodeticOrigin | None:
        """Where the zero of the fleet frame is on Earth; None where a fleet indoors does not say."""
        if self.origin != "indoor":
            return self.origin
        return self.external_vision.place if self.external_vision else None

    @property
    def has_distant_peers(self) -> bool:
        """Whether the fleet is so large that each vehicle receives some of the others at 5 Hz."""
        return len(self.vehicles) > self.peers.full_rate_up_to

    def formation_hash(self) -> int:
        """64 bits over all settings. Vehicles fly together only if theirs are the same."""
        import hashlib  # here, so that an agent can leave OpenSSL out of it first (cli/agent.py)

        agreed = replace(self, law=self.law.agreed())
        digest = hashlib.sha256(msgspec.json.encode(agreed, order="sorted")).digest()
        return int.from_bytes(digest[:8], "big")

    def member(self, vehicle_id: int) -> FormationMember | None:
        """The vehicle with this id; None if the fleet has none."""
        return next((m for m in self.vehicles if m.id == vehicle_id), None)
