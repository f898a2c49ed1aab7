"""A fleet file: the settings that all vehicles of a fleet share. Its hash is part of every peer packet."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

import msgspec
from msgspec import Meta
from msgspec.structs import replace

from companion.config.validation import Problem
from companion.config.values import Name, NetworkAddress, ObstacleSection, PointM, PositionM, Section, VehicleId, about
from companion.geometry.airspace import Airspace, Fence
from companion.types.flight import Role
from companion.types.values import Vector3

Gain = Annotated[float, Meta(gt=0, le=10)]
LawName = Literal["cooperative", "weighted", "average_22", "average_26"]
OF_ONE_LAW = ("exponent", "weight_ratio", "feedforward", "leader_uses_neighbours")  # keys with a default of each law
PAPER_LAWS: tuple[LawName, ...] = ("weighted", "average_22", "average_26")


class LawGains(Section, frozen=True):
    """Gains K = [k1, k2] of eq. 14. Without a value the law's own gain applies."""

    position_1_s2: Annotated[Gain | None, about("k1, on the position error")] = None
    velocity_1_s: Annotated[Gain | None, about("k2, on the velocity error")] = None


class AltitudeHoldGains(Section, frozen=True):
    """Gains of the altitude controller of a vehicle that holds its own altitude."""

    position_1_s2: Annotated[Gain, about("on the altitude error")] = 2.0
    velocity_1_s: Annotated[Gain, about("on the climb rate")] = 2.4


class Law(Section, frozen=True):
    """The formation law and its parameters. A parameter that is left out has the value of the named law."""

    name: Annotated[
        LawName,
        about(
            "`cooperative` is the law to fly; `weighted` is the paper's; `average_22` and `average_26` are those"
            " that the paper compares it with"
        ),
    ] = "cooperative"
    gains: LawGains = LawGains()
    exponent: (
        Annotated[float, about("alpha of the weights rho^p / p^alpha; 1 in the paper's Algorithm 2", ge=0, le=16)]
        | None
    ) = None
    weight_ratio: (
        Annotated[float, about("rho of the weights rho^p / p^alpha; 1 in the paper", ge=0.001, le=1)] | None
    ) = None
    feedforward: (
        Annotated[float, about("share of the neighbours' acceleration that is fed forward", ge=0, le=0.99)] | None
    ) = None
    leader_uses_neighbours: Annotated[
        bool | None, about("`false`: a leader tracks its reference without its neighbours")
    ] = None
    altitude: Annotated[
        Literal["formation", "hold"],
        about("`formation`: the law controls z too; `hold`: each vehicle holds the altitude it entered with"),
    ] = "formation"
    altitude_hold_gains: AltitudeHoldGains = AltitudeHoldGains()
    disturbance_bandwidth_1_s: Annotated[
        float,
        about("bandwidth of the observer for wind and hover thrust error; 0 switches it off", ge=0, le=5),
    ] = 4.0
    velocity_correction_1_s: Annotated[
        float,
        about(
            "bandwidth of the filter that makes the velocity agree with the position; 0 switches it off", ge=0, le=10
        ),
    ] = 2.0

    def with_name(self, name: LawName) -> Law:
        """Another law with these settings, for comparisons. The paper's three laws share their gains."""
        if name == self.name:
            return self
        same_gains = name in PAPER_LAWS and self.name in PAPER_LAWS
        gains = self.gains if same_gains else LawGains()
        return replace(self, name=name, gains=gains, **dict.fromkeys(OF_ONE_LAW))


def law_problems(law: Law, where: str) -> Iterator[Problem]:
    """Parameters that an average law does not have: with them it would be the weighted law with another exponent."""
    if law.name not in ("average_22", "average_26"):
        return
    for field in OF_ONE_LAW:
        if getattr(law, field) is not None:
            hint = "take it out, or fly weighted (its average is exponent: 0)"
            yield Problem(f"{where}.{field}", f"{law.name} takes no {field}; {hint}")


class GeodeticOrigin(Section, frozen=True):
    """The zero of the fleet frame (ENU), as WGS84 latitude and longitude."""

    latitude_deg: Annotated[float, about("WGS84 latitude", ge=-85, le=85)]
    longitude_deg: Annotated[float, about("WGS84 longitude", ge=-180, le=180)]
    altitude_amsl_m: Annotated[float, about("altitude above mean sea level", ge=-500, le=9000)]

    def as_tuple(self) -> Vector3:
        """Latitude [deg], longitude [deg], altitude [m]."""
        return (self.latitude_deg, self.longitude_deg, self.altitude_amsl_m)


class FormationMember(Section, frozen=True):
    """A vehicle of the fleet with its slot."""

    id: VehicleId
    role: Annotated[Role, about("role at the start; at least one vehicle is `leader`")]
    slot_enu_m: Annotated[PositionM, about("d_i0 of eq. 12, the offset of the slot from the RFT")]
    may_lead: Annotated[
        bool, about("`true`: a follower that can be made leader; its vehicle file then holds the reference")
    ] = False
    address: Annotated[
        NetworkAddress | None,
        about("where the agent of the vehicle listens in the network of the fleet, like `192.168.1.11:7447`"),
    ] = None

    @property
    def can_lead(self) -> bool:
        """Whether the vehicle holds the RFT: leaders at the start, and those with `may_lead`."""
        return self.may_lead or self.role == Role.LEADER


class RangeNeighbours(Section, frozen=True, tag_field="kind", tag="range"):
    """Neighbours by distance."""

    range_m: Annotated[float, about("a vehicle within this distance becomes a neighbour", gt=0, le=10_000)]
    hysteresis_m: Annotated[
        float,
        about("a neighbour stays one until it is this much farther away than the range", ge=0, le=1_000),
    ] = 0.0


class EdgeNeighbours(Section, frozen=True, tag_field="kind", tag="edges"):
    """Neighbours by a fixed list."""

    edges: Annotated[
        tuple[tuple[VehicleId, VehicleId], ...],
        about("pairs of vehicle ids that are neighbours of each other, like `[[1, 2], [2, 3]]`"),
    ]


class PeerLimits(Section, frozen=True):
    """Limits that received peer states must meet."""

    max_age_s: Annotated[float, about("an older peer state is not used", gt=0.02, le=5)] = 0.3
    leader_beacon_max_age_s: Annotated[
        float, about("without a newer leader beacon for this time the leader is lost", gt=0.02, le=10)
    ] = 0.25  # two hops on it is missed within 0.3 s
    full_rate_up_to: Annotated[
        int,
        about(
            "in a fleet of up to so many vehicles each receives all others at 50 Hz; in a larger one, those far"
            " away in formation at 5 Hz",
            ge=1,
            le=250,
        ),
    ] = 8
    max_speed_m_s: Annotated[
        float, about("a peer state with a larger speed is rejected; also limits references", gt=0, le=100)
    ] = 25.0


class Envelope(Section, frozen=True):
    """Limits of speed, limits on every setpoint, and the fence: a box in the fleet frame, less what is outside a polygon."""

    max_speed_m_s: Annotated[
        float, about("largest horizontal speed of a vehicle; also limits references", ge=0.5, le=50)
    ] = 12.0  # MPC_XY_VEL_MAX
    max_climb_m_s: Annotated[float, about("largest climb rate", ge=0.5, le=20)] = 3.0  # MPC_Z_VEL_MAX_UP
    max_descent_m_s: Annotated[float, about("largest descent rate", ge=0.5, le=20)] = 2.0
    max_tilt_deg: Annotated[float, about("largest commanded tilt", gt=0, le=45)] = 25.0
    max_tilt_rate_deg_s: Annotated[float, about("largest change of the commanded tilt per second", gt=0, le=1000)] = (
        120.0  # 2.4 degrees from one setpoint to the next
    )
    min_thrust_ratio: Annotated[float, about("smallest thrust, as a share of hover thrust", gt=0, lt=1)] = 0.3
    max_thrust_ratio: Annotated[float, about("largest thrust, as a multiple of hover thrust", gt=1, le=4)] = 1.6
    max_thrust_rate_1_s: Annotated[
        float, about("largest change of the thrust, in hover thrusts per second", gt=0, le=100)
    ] = 10.0
    fence_min_enu_m: Annotated[PositionM, about("lowest x, y, z of the fence; z is its floor")] = (
        -100.0,
        -100.0,
        -5.0,
    )
    fence_max_enu_m: Annotated[PositionM, about("highest x, y, z of the fence; z is its ceiling")] = (
        100.0,
        100.0,
        50.0,
    )
    fence_corners_enu_m: Annotated[
        tuple[PointM, ...],
        about(
            "corners x, y of a polygon, in order: the part of the box inside it is the fence; may be concave",
            max_length=100,
        ),
    ] = ()
    clearance_m: Annotated[
        float, about("distance that vehicles keep from the fence and from obstacles", ge=0, le=100)
    ] = 0.5


Hour = Annotated[float, Meta(gt=0, le=3600)]  # a time in seconds
Charge = Annotated[float, Meta(gt=0, le=90)]


class FleetSettings(Section, frozen=True, kw_only=True):
    """Settings of a fleet beside its vehicles and their neighbours."""

    altitude_source: Annotated[
        Literal["origin", "takeoff"],
        about(
            "zero of z: `origin`, the altitude of the origin; `takeoff`, the altitude where each vehicle was"
            " armed, for fleets that start from level ground"
        ),
    ] = "origin"
    ground_spread_m: Annotated[
        float,
        about("largest difference in altitude on the ground with which vehicles take off", gt=0, le=1000),
    ] = 1.0
    law: Law = Law()
    separation_m: Annotated[
        float,
        about(
            "smallest distance between vehicles at take-off and between slots, also during a formation change",
            gt=0,
            le=1000,
        ),
    ] = 1.0
    slot_speed_m_s: Annotated[
        float, about("largest speed of a slot in a formation change and in a turn", gt=0, le=50)
    ] = 1.0
    hand_over_speed_m_s: Annotated[
        float,
        about("largest speed added while the fleet changes from one reference to another", gt=0, le=50),
    ] = 2.0
    hand_over_acceleration_m_s2: Annotated[
        float, about("largest acceleration added while the fleet changes to another reference", gt=0, le=20)
    ] = 1.0
    formation_heading: Annotated[
        Literal["fixed", "course"],
        about("x axis of the slots: `fixed`, always east; `course`, the direction in which the RFT moves"),
    ] = "fixed"
    takeoff_height_m: Annotated[float, about("height of the take-off above the ground", ge=0.5, le=120)] = 2.5
    successors: Annotated[
        tuple[VehicleId, ...],
        about("vehicles that may lead; the first of them in formation becomes leader when the leader is lost"),
    ] = ()
    land_after_s: Annotated[
        Hour | None,
        about("time in hold without a leader after which a vehicle lands; without a value it holds"),
    ] = None
    when_one_leaves: Annotated[
        Literal["keep_gap", "close_up"],
        about(
            "`keep_gap`: the slot of a vehicle that left stays free; `close_up`: the others fill it, which needs"
            " edges that stay connected without any one vehicle"
        ),
    ] = "keep_gap"
    leave_below_percent: Annotated[
        Charge | None, about("a vehicle whose battery stays below this charge leaves the formation and lands")
    ] = None
    low_battery_action: Annotated[
        Literal["hold", "return", "land"],
        about("what follows `leave_below_percent`; `return` becomes `land` where the way home is not free"),
    ] = "land"
    land_below_percent: Annotated[
        Charge | None, about("a vehicle whose battery stays below this charge lands, also from a commanded hold")
    ] = None
    leader_holds_after_s: Annotated[
        float,
        about("time after which a leader in formation that receives no other vehicle goes into hold", gt=0, le=3600),
    ] = 5.0
    transport: Annotated[
        Literal["tcp", "quic"],
        about("protocol between the addresses; with identities `tcp` is TLS over TCP; `quic` needs identities"),
    ] = "tcp"
    multicast: Annotated[
        NetworkAddress | None,
        about(
            "group and port, like `239.255.77.1:7446`: states of the vehicles as UDP multicast, for radio links"
            " that lose packets; with identities each datagram is authenticated"
        ),
    ] = None
    security: Annotated[
        Literal["none"] | None,
        about("`none`: agents without an identity may use a network; all who reach it can command the fleet"),
    ] = None
    peers: PeerLimits = PeerLimits()
    envelope: Envelope = Envelope()
    obstacles: Annotated[
        tuple[ObstacleSection, ...], about("static obstacles, which all vehicles avoid", max_length=100)
    ] = ()

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
    """Settings that all vehicles of a fleet share. Every vehicle needs the same file."""

    name: Annotated[Name, about("name of the fleet on the network (a part of its Zenoh keys)")]
    origin: Annotated[
        GeodeticOrigin | Literal["indoor"],
        about("zero of the fleet frame; `indoor` where one motion-capture system gives all vehicles one frame"),
    ]
    vehicles: Annotated[tuple[FormationMember, ...], about("the vehicles with their roles and slots")]
    neighbours: Annotated[EdgeNeighbours | RangeNeighbours, about("the neighbours of each vehicle")]

    @property
    def has_distant_peers(self) -> bool:
        """Whether the fleet is so large that each vehicle receives some of the others at 5 Hz."""
        return len(self.vehicles) > self.peers.full_rate_up_to

    def formation_hash(self) -> int:
        """64 bits over all settings. Vehicles fly together only if theirs are the same."""
        import hashlib  # here, so that an agent can leave OpenSSL out of it first (cli/without_openssl.py)

        digest = hashlib.sha256(msgspec.json.encode(self, order="sorted")).digest()
        return int.from_bytes(digest[:8], "big")

    def member(self, vehicle_id: int) -> FormationMember | None:
        """The vehicle with this id; None if the fleet has none."""
        return next((m for m in self.vehicles if m.id == vehicle_id), None)
