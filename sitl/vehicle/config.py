"""Types of the simulated vehicle: airframe, sensors, wind, links, and the file of one stand-in."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from msgspec import Meta, convert, field, to_builtins

from companion.config.fleet import GeodeticOrigin
from companion.config.planned_flight import DEFAULT_ORIGIN
from companion.config.values import PositionM, Section, VehicleId, about, overlaid
from companion.types.autopilot import AutopilotKind
from sitl.vehicle.lies import Lie

NonNegative = Annotated[float, Meta(ge=0, le=1000)]
PerAxis = tuple[NonNegative, NonNegative, NonNegative]
Positive = Annotated[float, Meta(gt=0, le=1000)]
Port = Annotated[int, Meta(ge=1, le=65_535)]
FlightTime = Annotated[float, about("time since the start of the stand-in", ge=0, le=36_000)]


class Airframe(Section, frozen=True):
    """Rigid body of eq. 1-5.

    mass_kg: mass
    inertia_kg_m2: moments of inertia about the x, y and z axis
    hover_thrust_norm: hover thrust; without a value as measured: PX4 0.49, ArduCopter 0.365
    drag_n_per_m_s: linear drag
    motor_lag_s: time constant of the motors
    attitude: `rigid_body`: simulated attitude control; `instant`: ideal, as in section 3.1 of the paper
    """

    mass_kg: Positive = 1.0
    inertia_kg_m2: tuple[Positive, Positive, Positive] = (0.021, 0.021, 0.042)
    hover_thrust_norm: Annotated[float, Meta(ge=0.1, le=0.9)] | None = None
    drag_n_per_m_s: NonNegative = 0.25
    motor_lag_s: Annotated[float, Meta(ge=0, le=1)] = 0.05
    attitude: Literal["rigid_body", "instant"] = "rigid_body"


class Sensors(Section, frozen=True):
    """Errors of the autopilot's estimate: slow drifts (standard deviation, correlation time) and white noise.

    position_sd_m: drift of the position, per axis
    position_time_s: correlation time of the position drift
    velocity_sd_m_s: drift of the velocity
    velocity_time_s: correlation time of the velocity drift
    velocity_white_sd_m_s: white noise on the velocity
    attitude_sd_deg: drift of roll and pitch
    origin_sd_m: error of the vehicle's own origin, per axis
    """

    position_sd_m: PerAxis = (0.0, 0.0, 0.0)
    position_time_s: Positive = 20.0
    velocity_sd_m_s: NonNegative = 0.0
    velocity_time_s: Positive = 2.0
    velocity_white_sd_m_s: NonNegative = 0.0
    attitude_sd_deg: NonNegative = 0.0
    origin_sd_m: PerAxis = (0.0, 0.0, 0.0)


SENSORS: dict[str, Sensors] = {
    "ideal": Sensors(),
    # A good estimator, whose noise parameters fit its sensors. Its attitude error must be small: the law has no integral
    # action, and an error of 0.3 degrees alone moves the last of four vehicles by 0.3 m with the paper's gains.
    "default": Sensors(
        position_sd_m=(0.04, 0.04, 0.05),
        velocity_sd_m_s=0.03,
        velocity_white_sd_m_s=0.02,
        attitude_sd_deg=0.05,
        origin_sd_m=(0.3, 0.3, 0.8),
    ),
    # PX4's SIH with stock EKF2 parameters, as measured.
    "px4_sih": Sensors(
        position_sd_m=(0.11, 0.09, 0.16),
        velocity_sd_m_s=0.13,
        velocity_white_sd_m_s=0.03,
        attitude_sd_deg=0.6,
        origin_sd_m=(0.3, 0.3, 0.8),
    ),
    # As measured of ArduCopter's SITL in a hover: the position at rest, and a velocity beside it that varies over minutes.
    "ardupilot_sitl": Sensors(velocity_sd_m_s=0.025, velocity_time_s=100.0),
}


class Wind(Section, frozen=True):
    """Steady wind and gusts (first order, seeded).

    mean_enu_m_s: steady wind, the direction it blows to
    gust_sd_m_s: standard deviation of the gusts
    gust_time_s: correlation time of the gusts
    """

    mean_enu_m_s: PositionM = (0.0, 0.0, 0.0)
    gust_sd_m_s: NonNegative = 0.0
    gust_time_s: Positive = 2.0


class EstimatorReset(Section, frozen=True):
    """A step in the position estimate of one vehicle.

    shift_enu_m: the step, added to the estimate from then on
    """

    vehicle: VehicleId
    at_s: FlightTime
    shift_enu_m: PositionM


class BatteryLevel(Section, frozen=True):
    """The battery charge that one autopilot reports.

    percent: the charge from then on; -1: the autopilot does not know it
    """

    vehicle: VehicleId
    at_s: FlightTime
    percent: Annotated[int, Meta(ge=-1, le=100)]


class PilotedFlight(Section, frozen=True):
    """A pilot takes over one flying vehicle and flies it straight on, whatever is in the way.

    The mode is PX4's POSCTL or ArduCopter's LOITER. A mode change by command ends it.

    velocity_enu_m_s: velocity from then on
    """

    vehicle: VehicleId
    at_s: FlightTime
    velocity_enu_m_s: PositionM


class PositionLoss(Section, frozen=True):
    """GPS or external vision is lost, and the autopilot dead-reckons.

    As measured: PX4 for 4.65 s, then it lands if it holds; ArduCopter for 7 s, then it lands.

    until_s: when the aid is back
    drift_enu_m_s2: acceleration error of the dead reckoning
    receiver: what GPS_RAW_INT says: `silent`: no receiver, accuracies of 0; `jammed`: no fix, accuracies of 2^32 - 1 mm
    """

    vehicle: VehicleId
    at_s: FlightTime
    until_s: FlightTime = 36_000.0
    drift_enu_m_s2: PositionM = (0.05, 0.0, 0.0)
    receiver: Literal["silent", "jammed"] = "silent"


class ReportedFailsafe(Section, frozen=True):
    """A failsafe that one autopilot reports, and whose action is to warn (BATT_FS_LOW_ACT 0, COM_LOW_BAT_ACT 0).

    text: its STATUSTEXT
    until_s: until then HEARTBEAT says MAV_STATE_CRITICAL
    """

    vehicle: VehicleId
    at_s: FlightTime
    until_s: FlightTime = 36_000.0
    text: Annotated[str, Meta(min_length=1, max_length=50)] = "Battery Failsafe"


class HomeSet(Section, frozen=True):
    """A ground station sets the home of one autopilot (MAV_CMD_DO_SET_HOME); arming sets it again.

    position_enu_m: the home in the world frame
    """

    vehicle: VehicleId
    at_s: FlightTime
    position_enu_m: PositionM


class RallyPoint(Section, frozen=True):
    """A rally point in the storage of one autopilot: its return ends at the nearest of these and its home.

    position_enu_m: its place in the world frame
    """

    vehicle: VehicleId
    position_enu_m: PositionM


class Reseed(Section, frozen=True):
    """All random numbers of a flight in virtual time are those of another seed from then on: sensors, gusts and links.

    seed: text; errors and gusts go on from what they are
    """

    at_s: FlightTime
    seed: Annotated[str, Meta(min_length=1, max_length=200)]


class ModeRefusal(Section, frozen=True):
    """Mode changes that one flying autopilot refuses, as without a position.

    modes: names of its modes, as PX4's LOITER or ArduCopter's BRAKE
    """

    vehicle: VehicleId
    at_s: FlightTime
    modes: Annotated[tuple[str, ...], Meta(min_length=1)]


class CaptureFault(Section, frozen=True):
    """A time in which the motion-capture system shows one vehicle wrongly; for stand-ins with external vision.

    kind: `lost`: not tracked; `swapped`: this vehicle and the other have each other's poses; `flipped`: turned about its
        own z axis; `frozen`: as it was at the beginning; `late`: as it was 0.3 s before
    for_s: how long it lasts
    other: the other vehicle, of `swapped`
    turn_deg: the angle, of `flipped`
    """

    kind: Literal["lost", "swapped", "flipped", "frozen", "late"]
    vehicle: VehicleId
    at_s: FlightTime
    for_s: Annotated[float, Meta(gt=0, le=36_000)]
    other: VehicleId | None = None
    turn_deg: Literal[90, 180] = 180

    def contradictions(self) -> Iterator[tuple[str, str]]:
        """Keys that contradict others, each with the problem."""
        if (self.kind == "swapped") is (self.other is None):
            yield "other", "expected with swapped, and with no other kind"
        elif self.other == self.vehicle:
            yield "other", f"{self.other}: expected another vehicle"


class OwnStandIn(Section, frozen=True):
    """What may differ from vehicle to vehicle.

    autopilot: the autopilot whose behaviour is simulated
    armable_after_s: time from the start until arming is accepted; without a value as measured: PX4 4 s, ArduCopter 42 s
    positioning: `gps`, or `external_vision`: without GPS; VISION_POSITION_ESTIMATE or ODOMETRY on a link give the position
    sensors: errors of the estimate. `ideal`: none; `default`: a good estimator; `px4_sih`: PX4's SIH with stock EKF2
        parameters; `ardupilot_sitl`: ArduCopter's SITL
    clock_slow_percent: how much slower the autopilot's clock runs than this computer's: PX4's 1 to 2 %
    parameters: autopilot parameters by name, for those that the stand-in has
    """

    autopilot: AutopilotKind = AutopilotKind.PX4
    armable_after_s: Annotated[float, Meta(ge=0, le=600)] | None = None
    airframe: Airframe = Airframe()
    positioning: Literal["gps", "external_vision"] = "gps"
    sensors: Literal["ideal", "default", "px4_sih", "ardupilot_sitl"] | Sensors = "default"
    clock_slow_percent: Annotated[float, Meta(ge=-5, le=5)] = 0.0
    parameters: dict[str, float] = field(default_factory=dict)

    def sensor_model(self) -> Sensors:
        """The sensors by name, or as given."""
        return SENSORS[self.sensors] if isinstance(self.sensors, str) else self.sensors


class StandIn(OwnStandIn, frozen=True):
    """A simulated vehicle, and the wind.

    seed: seed of all random errors
    estimator_resets: steps in position estimates
    batteries: battery charges; without any, they are full
    pilots: vehicles that a pilot takes over
    refusals: mode changes that autopilots refuse from then on
    position_losses: vehicles that lose GPS or vision; poses that arrive meanwhile are not used
    failsafes: failsafes that autopilots report, and only warn
    homes: homes that a ground station sets
    rally_points: rally points of autopilots
    """

    wind: Wind = Wind()
    seed: Annotated[int, Meta(ge=0)] = 1
    estimator_resets: tuple[EstimatorReset, ...] = ()
    batteries: tuple[BatteryLevel, ...] = ()
    pilots: tuple[PilotedFlight, ...] = ()
    refusals: tuple[ModeRefusal, ...] = ()
    position_losses: tuple[PositionLoss, ...] = ()
    failsafes: tuple[ReportedFailsafe, ...] = ()
    homes: tuple[HomeSet, ...] = ()
    rally_points: tuple[RallyPoint, ...] = ()


class StandIns(StandIn, frozen=True):
    """The simulated vehicles of a scenario, and the wind.

    capture_faults: wrong poses of the motion-capture system
    reseeds: other random numbers from a time on, in virtual time (`sitl gauntlet --rare` writes them)
    vehicles: by id, the keys in which single vehicles differ: autopilot, armable_after_s, airframe, positioning,
        sensors, clock_slow_percent, parameters. All others are as for the whole fleet; parameters only of the same autopilot
    """

    capture_faults: tuple[CaptureFault, ...] = ()
    reseeds: Annotated[tuple[Reseed, ...], Meta(max_length=100)] = ()
    vehicles: dict[VehicleId, dict[str, Any]] = field(default_factory=dict)  # as written: only what differs

    def of(self, vehicle_id: int) -> StandIn:
        """That of one vehicle."""
        common = StandIn(**{name: getattr(self, name) for name in StandIn.__struct_fields__})
        own = self.vehicles.get(vehicle_id)
        if not own:
            return common
        plain = to_builtins(common)
        if own.get("autopilot", self.autopilot) != self.autopilot:
            plain["parameters"] = {}  # the other autopilot has not even their names
        return convert(overlaid(plain, own), StandIn)


DelaySeconds = Annotated[float, Meta(ge=0, le=1)]
Share = Annotated[float, Meta(ge=0, le=1)]


class Partition(Section, frozen=True):
    """A time in which packets between some vehicles and all others of the fleet are lost.

    vehicles: the vehicles on one side; all others are on the other
    lost: which packets of these vehicles are lost: `received` ones, `sent` ones, or `both`
    """

    vehicles: Annotated[tuple[VehicleId, ...], Meta(min_length=1)]
    from_s: FlightTime
    until_s: FlightTime
    lost: Literal["both", "received", "sent"] = "both"

    def separates(self, sender: int, receiver: int, now_s: float) -> bool:
        """Whether a packet that is sent now is lost."""
        if not self.from_s <= now_s < self.until_s or (sender in self.vehicles) is (receiver in self.vehicles):
            return False
        return self.lost == "both" or (self.lost == "sent") is (sender in self.vehicles)


class LateTelemetry(Section, frozen=True):
    """A time in which the telemetry of one vehicle arrives late, as from a full serial buffer. Its order stays.

    delay_s: from sampling to the tick of the agent
    """

    vehicle: VehicleId
    from_s: FlightTime
    until_s: FlightTime
    delay_s: DelaySeconds


class Links(Section, frozen=True):
    """Links of the vehicles. `peer_*` and `partitions` also hold for real processes, over a network emulated in user space.

    The defaults are as measured between real processes on one machine. A packet also waits for the next tick of its receiver.

    telemetry_delay_s: from sampling to the tick of the agent; `sitl run` only
    setpoint_delay_s: from the tick of the agent to the autopilot; `sitl run` only
    peer_delay_s: smallest delay between agents
    peer_jitter_s: largest addition to that delay, uniformly distributed; above 0.02 s packets are reordered
    peer_loss: share of the packets between agents that are lost
    peer_duplicates: share of the packets between agents that arrive twice
    peer_transport: how real processes exchange states: as UDP datagrams, by multicast on undisturbed links, or over
        Zenoh in TCP streams; `sitl run` always loses and delays single packets, as with datagrams
    partitions: times in which vehicles receive nothing from each other
    late_telemetry: times in which telemetry takes longer than `telemetry_delay_s`; `sitl run` only
    lies: times in which vehicles say false things of themselves; `sitl run` only
    """

    telemetry_delay_s: DelaySeconds = 0.0003
    setpoint_delay_s: DelaySeconds = 0.0005
    peer_delay_s: DelaySeconds = 0.001
    peer_jitter_s: DelaySeconds = 0.0
    peer_loss: Share = 0.0
    peer_duplicates: Share = 0.0
    peer_transport: Literal["tcp", "udp"] = "udp"
    partitions: tuple[Partition, ...] = ()
    late_telemetry: tuple[LateTelemetry, ...] = ()
    lies: tuple[Lie, ...] = ()

    @property
    def disturb_peers(self) -> bool:
        """Whether anything differs from an undisturbed network between the agents."""
        delayed = (self.peer_delay_s, self.peer_jitter_s) != (Links().peer_delay_s, 0.0)
        return delayed or self.peer_loss > 0.0 or self.peer_duplicates > 0.0 or bool(self.partitions)


class AutopilotFile(Section, frozen=True):
    """The file of `sitl autopilot --config`: one simulated vehicle.

    world_origin: zero of the world frame (ENU)
    start_enu_m: start in the world frame
    origin_enu_m: zero of the autopilot's own frame; without a value at the start
    start_yaw_deg: yaw at the start: 0 is east, counterclockwise
    truth_port: UDP port of this machine that receives the true pose at 125 Hz, for a motion-capture system
    """

    id: VehicleId = 1
    world_origin: GeodeticOrigin = DEFAULT_ORIGIN
    start_enu_m: PositionM = (0.0, 0.0, 0.0)
    origin_enu_m: PositionM | None = None
    start_yaw_deg: Annotated[float, Meta(ge=-360, le=360)] = 0.0
    stand_in: StandIn = StandIn()
    truth_port: Port | None = None
