"""Perception: telemetry -> the vehicle's state in the fleet frame. Implausible samples are counted and ignored."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from math import hypot, inf, isfinite
from typing import Any

from msgspec import Struct

from companion.core.estimation.accuracy import POSE_GAP_S, PositionAccuracy
from companion.core.estimation.corrections import RELEASE_M_S, PositionReset, VelocityCorrection
from companion.core.estimation.fleet_frame import FleetFrame
from companion.types.autopilot import (
    AttitudeSample,
    AutopilotRequest,
    EstimatorSample,
    GlobalPositionSample,
    GroundSample,
    HeartbeatSample,
    HomeSample,
    LandedSample,
    LandedState,
    ModeSample,
    OriginSample,
    PoseSample,
    PositionSample,
    RallySample,
    RequestOrigin,
    SetOrigin,
    SystemSample,
    Telemetry,
    TextSample,
    ThrustSample,
    VehicleState,
)
from companion.types.flight import COOPERATING, FLAG_TEXTS, Flight, HealthFlag
from companion.types.notices import Code, Notice
from companion.types.rejections import count_rejection
from companion.types.values import ZERO3, Vector3

ORIGIN_REPEAT_S = 1.0
ORIGIN_REFRESH_S = 5.0  # PX4 sends a changed origin once, and that one datagram may be lost
ORIGIN_SOON_S = 0.1  # when the position jumped: a new origin may be why


class Perception(Struct, frozen=True, gc=False):
    """The own vehicle in this tick. `rejected` counts samples by reason."""

    vehicle: VehicleState
    rejected: Mapping[str, int]
    requests: tuple[AutopilotRequest, ...] = ()
    events: tuple[Notice, ...] = ()


MAX_LOCAL_M = 100_000.0  # the 32-bit floats of LOCAL_POSITION_NED lose centimetres well below this
MAX_SPEED_M_S = 100.0
REBOOT_S = 1.0  # time_boot_ms decreasing by more is a reboot, by less a reordered datagram
HOME_KNOWN_FOR_S = 5.0  # PX4's own rate of HOME_POSITION is 0.5 Hz; one packet may be lost
RALLY_POINTS = "rally points are stored in the autopilot, and it returns to the nearest place"
EVENT_PERIOD_S = 1.0  # repeated jumps are reported no more often
LATE_PERIOD_S = 5.0  # so are late positions
FAILSAFE_STAYS_S = 5.0  # HEARTBEAT comes once a second, a text once


class VehicleTracker:
    """Newest state of the own vehicle.

    With a geodetic fleet origin there is no position until the autopilot's own origin is known. With `height_from_takeoff`, z
    is the height above the point where the vehicle was last disarmed on the ground; a vehicle first seen in flight has a
    position only where a GroundSample of this flight comes with the first telemetry.
    """

    def __init__(
        self,
        fleet_origin: Vector3 | None,
        height_from_takeoff: bool = False,
        velocity_correction: VelocityCorrection | None = None,
        vision_origin: SetOrigin | None = None,
    ) -> None:
        """`vision_origin`: the autopilot has no GPS, gets poses, and an origin where it has none."""
        self._frame = FleetFrame(fleet_origin)
        self._position_reset = PositionReset()
        self._velocity_correction = velocity_correction
        self._ground_up_m: float | None = None if height_from_takeoff else 0.0
        self._follows_ground = height_from_takeoff
        self._kept: GroundSample | None = None  # from before this agent, until it is believed or not
        self._position: PositionSample | None = None
        self._accuracy = PositionAccuracy(uses_gps=fleet_origin is not None)
        self._failsafe_text = ""  # as reported last
        self._jump_s = self._late_reported_s = self._origin_asked_s = float("-inf")
        self._home: HomeSample | None = None  # the newest, also while the frame is unknown
        self._rally_points = ""
        self._healthy_by_status = self._healthy_by_system = True  # ESTIMATOR_STATUS, SYS_STATUS
        self.rejected: Counter[str] = Counter()
        self._events: list[Notice] = []  # raised while the current telemetry message is processed
        self._fields: dict[str, Any] = {"frame_known": self._frame_known()}  # newest value of every field
        self._vision_origin, self._has_asked = vision_origin, False  # last time, for the autopilot's own origin
        if vision_origin is not None:
            self._fields["pose_time_s"] = -inf
        self.state = VehicleState(**self._fields)
        self._folds: dict[type[Telemetry], Callable[[Any], None]] = {
            PositionSample: self._fold_position,
            AttitudeSample: self._fold_attitude,
            ModeSample: self._fold_mode,
            HeartbeatSample: self._fold_heartbeat,
            LandedSample: self._fold_landed,
            ThrustSample: self._fold_thrust,
            OriginSample: self._fold_origin,
            HomeSample: self._fold_home,
            RallySample: self._fold_rally_points,
            GlobalPositionSample: self._fold_global_position,
            EstimatorSample: self._fold_error,
            SystemSample: self._fold_system,
            TextSample: self._fold_text,
            GroundSample: self._fold_ground,
            PoseSample: self._fold_pose,
        }

    @property
    def takeoff(self) -> GroundSample | None:
        """What an agent that starts again in this flight needs; None on the ground, and where it needs nothing."""
        position, ground_up_m = self._position, self._ground_up_m
        if not self._follows_ground or position is None or ground_up_m is None or not self.state.armed:
            return None
        return GroundSample(position.received_s, ground_up_m, _booted_s(position), 0.0)

    def step(
        self, now_s: float, telemetry: Iterable[Telemetry], before: Flight, returns_elsewhere: str = ""
    ) -> Perception:
        """`before` is the flight of the last tick: only while it cooperates does a position that jumps follow slowly.

        At other times neither this vehicle nor a neighbour controls by the position, and the next one is used unchanged.
        `returns_elsewhere`: why the autopilot's return may not end at its home, by its parameters; "" where it does.
        """
        if before.phase not in COOPERATING:
            self._position_reset.restart()
        self._fields["returns_elsewhere"] = self._rally_points or returns_elsewhere
        if self._home is not None and now_s - self._home.received_s > HOME_KNOWN_FOR_S:
            self._home = self._fields["home_enu_m"] = None
        vehicle, events = self.fold(telemetry)
        requests: tuple[AutopilotRequest, ...] = ()
        if vehicle.autopilot is not None:
            period_s = ORIGIN_REPEAT_S if vehicle.altitude_amsl_m is None else ORIGIN_REFRESH_S
            if now_s - vehicle.jump_time_s < ORIGIN_REPEAT_S:
                period_s = ORIGIN_SOON_S
            if now_s - self._origin_asked_s >= period_s:
                self._origin_asked_s = now_s
                requests = (self._about_origin(now_s, vehicle),)
        return Perception(vehicle, self.rejected, requests, events)

    def _about_origin(self, now_s: float, vehicle: VehicleState) -> RequestOrigin | SetOrigin:
        """On the ground an autopilot that gets poses and tells no origin when asked is given one, and is asked again."""
        waits = vehicle.altitude_amsl_m is None and not vehicle.armed and now_s - vehicle.pose_time_s <= POSE_GAP_S
        sets = self._vision_origin if waits and self._has_asked else None
        self._has_asked = sets is None
        return sets or RequestOrigin()

    def fold(self, telemetry: Iterable[Telemetry]) -> tuple[VehicleState, tuple[Notice, ...]]:
        """State after these samples, and the events. An implausible sample is counted in `rejected` and changes nothing."""
        for sample in telemetry:
            fold = self._folds.get(type(sample))
            if fold is not None:
                fold(sample)
        # One new state per tick: one per sample would cost more than the formation law.
        self.state = VehicleState(**self._fields)
        if not self._events:
            return self.state, ()
        events, self._events = tuple(self._events), []
        return self.state, events

    def _fold_position(self, sample: PositionSample) -> None:
        step_s = sample.boot_time_s - self._position.boot_time_s if self._position else 0.0
        if self._position and -REBOOT_S < step_s <= 0.0:
            self.rejected = count_rejection(self.rejected, Code.POSITION_OUT_OF_ORDER)
            return
        if not _within(sample.position_local_enu_m, MAX_LOCAL_M) or not _within(sample.velocity_enu_m_s, MAX_SPEED_M_S):
            self.rejected = count_rejection(self.rejected, Code.POSITION_IMPLAUSIBLE)
            return
        if step_s <= -REBOOT_S:
            self._forget_origin()
        self._position = sample
        if sample.received_s > self._accuracy.holds_until_s:
            self._assume_error(sample.received_s)
        if sample.late_s and sample.received_s - self._late_reported_s > LATE_PERIOD_S:
            self._late_reported_s = sample.received_s
            self._events.append(Notice(Code.TELEMETRY_LATE, f"positions arrive {sample.late_s:.2f} s late"))
        offset_m = self._frame.offset_enu_m
        if offset_m is None:
            return
        east, north, up = sample.position_local_enu_m
        if self._follows_ground and (self._ground_up_m is None or not self._fields["armed"]):
            self._follow_ground(sample, up + offset_m[2])
        own_altitude_m = self._frame.own_altitude_amsl_m
        self._fields["frame_known"] = self._ground_up_m is not None
        self._fields["altitude_amsl_m"] = None if own_altitude_m is None else own_altitude_m + up
        if self._ground_up_m is None:
            return
        position_enu_m = (east + offset_m[0], north + offset_m[1], up + offset_m[2] - self._ground_up_m)
        used_enu_m, jump_m = self._position_reset.follow(sample.boot_time_s, position_enu_m, sample.velocity_enu_m_s)
        if jump_m:
            self._fields.update(jump_time_s=sample.received_s)
            if sample.received_s - self._jump_s > EVENT_PERIOD_S:
                text = f"the autopilot's position jumped by {jump_m:.1f} m: followed at {RELEASE_M_S} m/s"
                self._events.append(Notice(Code.POSITION_RESET, text))
            self._jump_s = sample.received_s
        fields, held_back_m = self._fields, self._position_reset.held_back_m
        fields["position_enu_m"] = used_enu_m
        velocity_enu_m_s = sample.velocity_enu_m_s
        if self._velocity_correction is not None:
            # By the reported position: a jump that is released slowly is no velocity.
            velocity_enu_m_s = self._velocity_correction.follow(sample.boot_time_s, position_enu_m, velocity_enu_m_s)
        fields["velocity_enu_m_s"] = velocity_enu_m_s
        fields["position_time_s"] = sample.received_s - sample.late_s
        if not fields.get("armed", True) and self._on_ground():
            fields["ground_position_enu_m"] = used_enu_m
        fields["held_back_m"] = 0.0 if held_back_m is ZERO3 else hypot(*held_back_m)

    def _on_ground(self) -> bool:
        """Whether the autopilot reports disarmed, and not in flight."""
        fields = self._fields
        disarmed = "heartbeat_time_s" in fields and not fields["armed"]
        return disarmed and fields.get("landed", LandedState.UNDEFINED) in (
            LandedState.UNDEFINED,
            LandedState.ON_GROUND,
        )

    def _follow_ground(self, sample: PositionSample, up_m: float) -> None:
        """The height that z counts from: of the ground below a disarmed vehicle, else as kept from its take-off."""
        fields = self._fields
        if "heartbeat_time_s" not in fields:
            return
        if self._on_ground():
            self._ground_up_m, self._kept = up_m, None
        elif (kept := self._kept) is not None:
            self._kept = None
            if abs(_booted_s(sample) - kept.booted_s) <= kept.within_s:
                self._ground_up_m = kept.ground_up_m
                text = (
                    f"started again in the air: z counts from its take-off, {kept.ground_up_m:.1f} m above the origin"
                )
                self._events.append(Notice(Code.GROUND_KEPT, text))
        unknown = self._ground_up_m is None and fields["armed"] and fields.get("landed") is not LandedState.ON_GROUND
        if unknown and not fields.get("ground_unknown"):
            self._events.append(Notice(Code.GROUND_UNKNOWN, FLAG_TEXTS[HealthFlag.GROUND_UNKNOWN]))
        fields["ground_unknown"] = unknown

    def _fold_ground(self, sample: GroundSample) -> None:
        self._kept = sample

    def _fold_pose(self, sample: PoseSample) -> None:
        if sample.fault:
            self._fields.update(pose_refused_s=sample.received_s, pose_fault=sample.fault)
        elif self._vision_origin is not None:
            self._fields["pose_time_s"] = sample.measured_s
            self._accuracy.receive_pose(sample.measured_s)
            self._assume_error(sample.received_s)

    def _frame_known(self) -> bool:
        return self._frame.offset_enu_m is not None and self._ground_up_m is not None

    def _forget_origin(self) -> None:
        """Discard origin and position reset after a reboot of the autopilot."""
        self._frame.forget()
        self._accuracy.restart()
        self._position_reset.restart()
        self._home = self._fields["home_enu_m"] = None
        if self._velocity_correction is not None:
            self._velocity_correction.restart()
        if self._follows_ground:
            self._ground_up_m = self._kept = None
        self._fields.update(altitude_amsl_m=None, frame_known=self._frame_known(), frame_contradicted=False)
        if not self._frame_known():
            self._fields.pop("position_time_s", None)

    def _fold_mode(self, sample: ModeSample) -> None:
        if sample.name != self._fields.get("mode_name") and not self._failsafe_text:
            self._fields["failsafe_s"] = -inf  # a new mode may end it; the next HEARTBEAT tells
        self._fields.update(mode=sample.mode, mode_name=sample.name, mode_time_s=sample.received_s)

    def _fold_heartbeat(self, sample: HeartbeatSample) -> None:
        self._fields.update(
            autopilot=sample.autopilot,
            armed=sample.armed,
            heartbeat_time_s=sample.received_s,
            interleaves=sample.interleaves,
        )
        if not sample.armed:
            self._kept = None  # that flight is over
        if sample.critical:
            self._report_failsafe(sample.received_s, "")
        elif not self._failsafe_text:
            self._fields["failsafe_s"] = -inf

    def _fold_text(self, sample: TextSample) -> None:
        if sample.failsafe:
            self._report_failsafe(sample.received_s, sample.text)

    def _report_failsafe(self, received_s: float, text: str) -> None:
        """One of the autopilot itself. On the ground it is a failing check. HEARTBEAT, which names no cause, repeats it."""
        if not self._fields.get("armed", False):
            return
        lasts = received_s - self._fields.get("failsafe_s", -inf) < FAILSAFE_STAYS_S
        self._fields["failsafe_s"] = received_s
        if not lasts or (text and text != self._failsafe_text):
            self._failsafe_text = text  # what a text has begun lasts for its time, whatever HEARTBEAT says
            self._events.append(Notice(Code.FAILSAFE_ACTIVE, f"the autopilot: {text or 'MAV_STATE_CRITICAL'}"))

    def _fold_landed(self, sample: LandedSample) -> None:
        self._fields.update(landed=sample.landed, landed_time_s=sample.received_s)

    def _fold_attitude(self, sample: AttitudeSample) -> None:
        if not (isfinite(sample.roll_rad) and isfinite(sample.pitch_rad) and isfinite(sample.yaw_rad)):
            self.rejected = count_rejection(self.rejected, Code.ATTITUDE_INVALID)
            return
        fields = self._fields
        fields["roll_rad"], fields["pitch_rad"], fields["yaw_rad"] = sample.roll_rad, sample.pitch_rad, sample.yaw_rad
        fields["attitude_time_s"] = sample.received_s

    def _fold_thrust(self, sample: ThrustSample) -> None:
        if not 0.0 <= sample.thrust_norm <= 1.0:
            self.rejected = count_rejection(self.rejected, Code.THRUST_IMPLAUSIBLE)
            return
        self._fields["thrust_norm"], self._fields["thrust_time_s"] = sample.thrust_norm, sample.received_s

    def _fold_origin(self, sample: OriginSample) -> None:
        before = self._frame.offset_enu_m
        if not self._frame.use_origin(sample):
            self.rejected = count_rejection(self.rejected, Code.ORIGIN_IMPLAUSIBLE)
            return
        if self._home is not None:
            self._fold_home(self._home)
        self._origin_updated(before)

    def _fold_home(self, sample: HomeSample) -> None:
        """An implausible home is unknown: the autopilot may fly there all the same."""
        place = self._frame.place(sample.latitude_deg, sample.longitude_deg)
        if place is None and self._frame.geodetic_origin is not None:
            self.rejected = count_rejection(self.rejected, Code.HOME_IMPLAUSIBLE)
        self._home, self._fields["home_enu_m"] = sample, place

    def _fold_rally_points(self, sample: RallySample) -> None:
        self._rally_points = self._fields["returns_elsewhere"] = RALLY_POINTS if sample.has_rally_points else ""

    def _fold_global_position(self, sample: GlobalPositionSample) -> None:
        before = self._frame.offset_enu_m
        if self._position and not self._frame.use_global_position(sample, self._position):
            self.rejected = count_rejection(self.rejected, Code.GLOBAL_POSITION_IMPLAUSIBLE)
            return
        self._origin_updated(before)

    def _origin_updated(self, before: Vector3 | None) -> None:
        """Drop the last position on the ground, as it refers to the old origin. In flight the used position continues."""
        if self._frame.offset_enu_m != before and not self._fields.get("armed", False):
            self._fields.pop("position_time_s", None)
        self._fields.update(frame_known=self._frame_known(), frame_contradicted=self._frame.contradicted)

    def _fold_error(self, sample: EstimatorSample) -> None:
        self._accuracy.receive(sample)
        self._assume_error(sample.received_s)
        self._healthy_by_status = sample.healthy
        self._fields["estimator_healthy"] = sample.healthy and self._healthy_by_system

    def _assume_error(self, now_s: float) -> None:
        self._fields["position_error"], self._fields["position_unaided"] = self._accuracy.at(now_s)

    def _fold_system(self, sample: SystemSample) -> None:
        self._healthy_by_system = sample.estimator_healthy
        self._fields["battery_percent"] = sample.battery_percent
        self._fields["estimator_healthy"] = sample.estimator_healthy and self._healthy_by_status


def _booted_s(sample: PositionSample) -> float:
    """When the autopilot started, by the clock of the sample's arrival."""
    return sample.received_s - sample.late_s - sample.boot_time_s


def _within(vector: Vector3, limit: float) -> bool:
    """Whether every component is at most `limit` in size. False for NaN."""
    x, y, z = vector
    return -limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit
