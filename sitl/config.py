"""What a stand-in vehicle is made of: the types of its YAML file."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, field

from companion.config.fleet import GeodeticOrigin
from companion.config.values import PositionM, Section, VehicleId
from companion.types import AutopilotKind

NonNegative = Annotated[float, Meta(ge=0, le=1000)]
Positive = Annotated[float, Meta(gt=0, le=1000)]


class Airframe(Section, frozen=True):
    """Rigid body of eq. 1-5. Without `hover_thrust_norm` it is as measured with the autopilot.

    `attitude: instant` is the paper's ideal (section 3.1: no tracking error of the angles).
    """

    mass_kg: Positive = 1.0
    inertia_kg_m2: tuple[Positive, Positive, Positive] = (0.021, 0.021, 0.042)
    hover_thrust_norm: Annotated[float, Meta(ge=0.1, le=0.9)] | None = None
    drag_n_per_m_s: NonNegative = 0.25
    motor_lag_s: Annotated[float, Meta(ge=0, le=1)] = 0.05
    attitude: Literal["rigid_body", "instant"] = "rigid_body"


class Sensors(Section, frozen=True):
    """The error of the autopilot's estimate against truth: slow drifts (sd, correlation time) and white noise."""

    position_sd_m: tuple[NonNegative, NonNegative, NonNegative] = (0.0, 0.0, 0.0)
    position_time_s: Positive = 20.0
    velocity_sd_m_s: NonNegative = 0.0
    velocity_time_s: Positive = 2.0
    velocity_white_sd_m_s: NonNegative = 0.0
    attitude_sd_deg: NonNegative = 0.0
    origin_sd_m: tuple[NonNegative, NonNegative, NonNegative] = (0.0, 0.0, 0.0)


SENSORS: dict[str, Sensors] = {
    "ideal": Sensors(),
    # A good estimator, whose noise parameters fit its sensors. Its attitude error must be small: the law has no integral
    # action, and an error of 0.3 degrees alone moves the last of four vehicles by 0.3 m under the paper's gains.
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
}


class Wind(Section, frozen=True):
    """Steady wind and gusts (first-order, seeded)."""

    mean_enu_m_s: PositionM = (0.0, 0.0, 0.0)
    gust_sd_m_s: NonNegative = 0.0
    gust_time_s: Positive = 2.0


# As measured: thrust in a hover, and when it can be armed after its start.
HOVER_THRUST_NORM: dict[AutopilotKind, float] = {AutopilotKind.PX4: 0.49, AutopilotKind.ARDUPILOT: 0.365}
ARMABLE_AFTER_S: dict[AutopilotKind, float] = {AutopilotKind.PX4: 4.0, AutopilotKind.ARDUPILOT: 42.0}


class EstimatorReset(Section, frozen=True):
    """From `at_s` after its start on, a vehicle's estimate of its position is off by this much more."""

    vehicle: VehicleId
    at_s: Annotated[float, Meta(ge=0, le=36_000)]
    shift_enu_m: PositionM


class BatteryLevel(Section, frozen=True):
    """From `at_s` after its start on, a vehicle's autopilot tells this charge; -1 is that it does not know."""

    vehicle: VehicleId
    at_s: Annotated[float, Meta(ge=0, le=36_000)]
    percent: Annotated[int, Meta(ge=-1, le=100)]


class StandIn(Section, frozen=True):
    """The stand-in vehicles of a scenario and the air round them.

    `autopilot` says whose manners they have; `parameters` overrides its parameters by name. Without `armable_after_s` they
    let themselves be armed as late as the real one.
    """

    autopilot: AutopilotKind = AutopilotKind.PX4
    armable_after_s: Annotated[float, Meta(ge=0, le=600)] | None = None
    airframe: Airframe = Airframe()
    sensors: Literal["ideal", "default", "px4_sih"] | Sensors = "default"
    wind: Wind = Wind()
    seed: Annotated[int, Meta(ge=0)] = 1
    estimator_resets: tuple[EstimatorReset, ...] = ()
    batteries: tuple[BatteryLevel, ...] = ()
    parameters: dict[str, float] = field(default_factory=dict)

    def sensor_model(self) -> Sensors:
        return SENSORS[self.sensors] if isinstance(self.sensors, str) else self.sensors

    @property
    def hover_thrust_norm(self) -> float:
        given = self.airframe.hover_thrust_norm
        return HOVER_THRUST_NORM[self.autopilot] if given is None else given

    @property
    def ready_after_s(self) -> float:
        return ARMABLE_AFTER_S[self.autopilot] if self.armable_after_s is None else self.armable_after_s


DelaySeconds = Annotated[float, Meta(ge=0, le=1)]


class Links(Section, frozen=True):
    """What the links are like in virtual time; the defaults are as measured between real processes on one machine.

    Telemetry from its sampling to the agent's tick, setpoints from there to the autopilot, and packets between agents:
    `peer_delay_s` and up to `peer_jitter_s` more, evenly spread; `peer_loss` of them, 0 to 1, never come. A packet waits
    for its receiver's next tick besides.
    """

    telemetry_delay_s: DelaySeconds = 0.0003
    setpoint_delay_s: DelaySeconds = 0.0005
    peer_delay_s: DelaySeconds = 0.001
    peer_jitter_s: DelaySeconds = 0.0
    peer_loss: Annotated[float, Meta(ge=0, le=1)] = 0.0


class AutopilotFile(Section, frozen=True):
    """The file of `sitl autopilot --config`: one stand-in vehicle. The world's ENU frame has its zero at `world_origin`.

    The autopilot's own origin lies about `origin_enu_m`, or about where it starts.
    """

    id: VehicleId = 1
    world_origin: GeodeticOrigin = GeodeticOrigin(latitude_deg=47.397742, longitude_deg=8.545594, altitude_amsl_m=488.0)
    start_enu_m: PositionM = (0.0, 0.0, 0.0)
    origin_enu_m: PositionM | None = None
    start_yaw_deg: Annotated[float, Meta(ge=-360, le=360)] = 0.0
    stand_in: StandIn = StandIn()
