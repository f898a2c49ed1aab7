"""The common part of all stand-in autopilots: body, time, parameters, home, automatic flight. No sockets, no clocks.

`step` advances virtual time. A stand-in's ends of its links (`sitl.autopilots.link_end`) handle messages. Beside it stand the
incidents of a vehicle: estimator resets, battery charges, and a pilot who takes over.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import partial
from math import hypot, inf, nan
from typing import Any, ClassVar, Protocol

from companion.geometry.frames import enu_from_geodetic, euler_from_quaternion, geodetic_from_enu
from companion.types.autopilot import AutopilotKind
from companion.types.errors import CompanionError
from companion.types.values import ZERO3, Vector3
from sitl.autopilots.external_vision import ExternalVision, Pose
from sitl.autopilots.logs import StandInLogs
from sitl.autopilots.parameters import AutopilotData, StandInParameters
from sitl.vehicle.automatic_flight import AutomaticFlight, Course, GroundContact, Speeds
from sitl.vehicle.config import AutopilotFile, PositionLoss, ReportedFailsafe, StandIn
from sitl.vehicle.control import AttitudeSetpoint
from sitl.vehicle.quadrotor import MOTORS_OFF, Quadrotor

DT_S = 0.004  # physics and attitude control at 250 Hz
CONTROL_PERIOD_S = 0.02  # of position control, and of the checks of setpoint streams
IDLE_THRUST_NORM = 0.08
LOW_THRUST_RATIO = 0.6  # of hover thrust
CRITICAL, ERROR, WARNING, INFO = 2, 3, 4, 6  # MAV_SEVERITY
LANDED_ON_GROUND, LANDED_IN_AIR, LANDED_TAKEOFF, LANDED_LANDING = 1, 2, 3, 4
STATE_UNINIT, STATE_BOOT, STATE_STANDBY, STATE_ACTIVE, STATE_CRITICAL = 0, 1, 3, 4, 5  # MAV_STATE
FULL_BATTERY_PERCENT = 98


def known_or(given: float | None, default: float) -> float:
    """A value of a file that may be left to the autopilot type."""
    return default if given is None else given


class Incidents:
    """The incidents of one vehicle. `course` is that of the pilot, None until the pilot takes over."""

    def __init__(self, file: AutopilotFile) -> None:
        stand_in = file.stand_in
        self._resets = sorted((r for r in stand_in.estimator_resets if r.vehicle == file.id), key=lambda r: r.at_s)
        self._batteries = sorted((b for b in stand_in.batteries if b.vehicle == file.id), key=lambda b: b.at_s)
        self._flights = sorted((p for p in stand_in.pilots if p.vehicle == file.id), key=lambda p: p.at_s)
        self._homes = sorted((h for h in stand_in.homes if h.vehicle == file.id), key=lambda h: h.at_s)
        self._refusals = [r for r in stand_in.refusals if r.vehicle == file.id]
        self._losses = sorted((p for p in stand_in.position_losses if p.vehicle == file.id), key=lambda p: p.at_s)
        self._failsafes = sorted((f for f in stand_in.failsafes if f.vehicle == file.id), key=lambda f: f.at_s)
        self.rally_points_enu_m = [p.position_enu_m for p in stand_in.rally_points if p.vehicle == file.id]
        self.loss: PositionLoss | None = None  # under way
        self.failsafe: ReportedFailsafe | None = None  # the newest that has begun
        self.course: Course | None = None
        self.next_s = self._next_s()  # when the next reset or pilot is due

    def _next_s(self) -> float:
        if self.loss:
            return -inf  # its drift grows with every step
        due_s = [r.at_s for r in self._resets[:1]] + [p.at_s for p in self._flights[:1]]
        due_s += [h.at_s for h in self._homes[:1]]
        due_s += [p.at_s for p in self._losses[:1]] + [f.at_s for f in self._failsafes[:1]]
        return min(due_s, default=inf)

    def reset(self, now_s: float) -> Vector3 | None:
        """The shift of an estimator reset that is due, ENU in metres. To be called until it returns None."""
        if self._resets and self._resets[0].at_s <= now_s:
            shift_enu_m = self._resets.pop(0).shift_enu_m
            self.next_s = self._next_s()
            return shift_enu_m
        return None

    def home(self, now_s: float) -> Vector3 | None:
        """The home that a ground station sets now, ENU in the world frame."""
        if not self._homes or self._homes[0].at_s > now_s:
            return None
        home_enu_m = self._homes.pop(0).position_enu_m
        self.next_s = self._next_s()
        return home_enu_m

    def lose_position(self, now_s: float) -> None:
        """A loss of the position that is due begins or ends."""
        if self.loss and self.loss.until_s <= now_s:
            self.loss = None
        elif self._losses and self._losses[0].at_s <= now_s:
            self.loss = self._losses.pop(0)
        self.next_s = self._next_s()

    def failsafe_text(self, now_s: float) -> str:
        """The text of a failsafe that begins now, or an empty one."""
        if not self._failsafes or self._failsafes[0].at_s > now_s:
            return ""
        self.failsafe = self._failsafes.pop(0)
        self.next_s = self._next_s()
        return self.failsafe.text

    def pilot_takes_over(self, now_s: float) -> bool:
        """Whether a pilot takes over now, to fly `course`."""
        if not self._flights or self._flights[0].at_s > now_s:
            return False
        self.course = Course((nan, nan, nan), self._flights.pop(0).velocity_enu_m_s, nan, 0.0)
        self.next_s = self._next_s()
        return True

    def refuses(self, mode_name: str, now_s: float) -> bool:
        """Whether a change to this mode is refused now."""
        return any(refusal.at_s <= now_s and mode_name in refusal.modes for refusal in self._refusals)

    def battery_percent(self, now_s: float) -> int:
        """The reported charge, -1 if it is unknown."""
        reported = [level.percent for level in self._batteries if level.at_s <= now_s]
        return reported[-1] if reported else FULL_BATTERY_PERCENT


class AutopilotAbortedError(CompanionError):
    """The real autopilot's process would have aborted here; str() names the cause."""


class FlightMode(Protocol):
    """A flight mode of any autopilot type."""

    @property
    def name(self) -> str: ...

    @property
    def custom_mode(self) -> int:
        """custom_mode of HEARTBEAT."""

    @property
    def flags(self) -> int:
        """MAV_MODE_FLAG bits of HEARTBEAT that depend on the mode."""


class Autopilot(ABC):
    """A stand-in vehicle. `dt_s` is the step of physics and attitude control."""

    kind: ClassVar[AutopilotKind]
    data: ClassVar[AutopilotData]
    parameters_type: ClassVar[type[StandInParameters]] = StandInParameters
    flight_logs: StandInLogs
    mode: FlightMode
    intended_mode: FlightMode  # that it returns to by itself
    vision: ExternalVision | None = None  # in place of GPS

    def __init__(self, file: AutopilotFile, dt_s: float) -> None:
        stand_in = file.stand_in
        hover_thrust_norm = known_or(stand_in.airframe.hover_thrust_norm, self.data.hover_thrust_norm)
        self.system_id = file.id
        self.dt_s = dt_s
        self.quad = Quadrotor(file, self.data.loops, dt_s, hover_thrust_norm)
        by_vision = stand_in.positioning == "external_vision"
        overrides = self.data.external_vision.parameters | stand_in.parameters if by_vision else stand_in.parameters
        self.parameters = self.parameters_type(self.data, file.id, overrides)
        self.time_s = 0.0
        self._clock_ms_s = 1000.0 - 10.0 * stand_in.clock_slow_percent
        self.armed = False
        self.home: Vector3 = self.here_geodetic()
        self.setpoint = MOTORS_OFF
        self.texts: list[tuple[int, str]] = []  # (severity, text), to be sent on the links
        self.ground_station_s: float | None = None  # when its last heartbeat came
        self.origin_changes = 0
        self._steps = 0
        self._control_steps = max(1, round(CONTROL_PERIOD_S / dt_s))
        self._automatic = AutomaticFlight(self.quad, self.speeds, hover_thrust_norm, self.data.braking_m_s2)
        self._ground = GroundContact()
        self._incidents = Incidents(file)
        if by_vision:
            self.vision = self._vision(file)

    @classmethod
    def armable_after_s(cls, stand_in: StandIn) -> float:
        """Time from the start until arming is accepted."""
        return known_or(stand_in.armable_after_s, cls.data.armable_after_s)

    def _vision(self, file: AutopilotFile) -> ExternalVision:
        armable_after_s = self.armable_after_s(file.stand_in)
        say = partial(self.send_text, INFO)
        return ExternalVision(self.data.external_vision, file, self.quad, armable_after_s, self.reset_estimator, say)

    # ------------------------------------------------------------ state

    @property
    @abstractmethod
    def armable(self) -> bool:
        """Whether it can be armed in its present mode."""

    @property
    @abstractmethod
    def system_status(self) -> int:
        """MAV_STATE."""

    @property
    @abstractmethod
    def takes_off(self) -> bool:
        """Whether it climbs in a take-off that it was commanded."""

    @property
    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        if self._ground.landed:
            return LANDED_ON_GROUND
        if self.takes_off:
            return LANDED_TAKEOFF
        return LANDED_LANDING if self._automatic.landing else LANDED_IN_AIR

    @property
    def at_rest(self) -> bool:
        """Whether it rests on the ground without vibration."""
        return self._ground.landed and not self.armed

    @abstractmethod
    def speeds(self) -> Speeds:
        """Speeds and heights of automatic flight, from its parameters."""

    @property
    def has_position(self) -> bool:
        """Whether its estimator has a position."""
        return True

    @property
    def reports_position(self) -> bool:
        """Whether it sends its local position."""
        return self.has_position

    @property
    def loss(self) -> PositionLoss | None:
        """The loss of GPS or vision that is under way."""
        return self._incidents.loss

    @property
    def position_lost_s(self) -> float:
        """For how long it has dead-reckoned; 0 while it does not."""
        if self.vision is not None:
            return self.vision.lost_s(self.time_s)
        return self.time_s - self._incidents.loss.at_s if self._incidents.loss else 0.0

    @property
    def reports_globally(self) -> bool:
        """Whether it knows its place on Earth."""
        return self.vision is None or (self.vision.fixed and self.has_origin)

    def local_state(self) -> tuple[Vector3, Vector3]:
        """Position and velocity in the local ENU frame that it reports."""
        if self.vision is not None and not self.vision.fixed:
            return ZERO3, ZERO3
        return self.quad.estimated_position_local_enu_m(), self.quad.estimated_velocity_enu_m_s()

    @property
    def has_origin(self) -> bool:
        """Whether it has an origin and a home."""
        return self.vision is None or self.vision.origin_s < inf

    @property
    def commanded_thrust_norm(self) -> float:
        """The thrust that ATTITUDE_TARGET reports."""
        return self.setpoint.thrust_norm

    @property
    def battery_percent(self) -> int:
        """The reported charge, -1 if it is unknown."""
        return self._incidents.battery_percent(self.time_s)

    @property
    def _control_dt_s(self) -> float:
        return self._control_steps * self.dt_s

    @property
    def reported_status(self) -> int:
        """MAV_STATE of HEARTBEAT, critical while a failsafe is reported that only warns."""
        failsafe = self._incidents.failsafe
        return STATE_CRITICAL if failsafe and self.time_s < failsafe.until_s else self.system_status

    @property
    def boot_ms(self) -> int:
        """Its own clock."""
        return round(self.time_s * self._clock_ms_s)

    def wanted_euler_rad(self) -> Vector3:
        """Roll, pitch, yaw of the present attitude setpoint, FLU in ENU."""
        return euler_from_quaternion(self.setpoint.quaternion)

    def here_geodetic(self) -> Vector3:
        """Estimated latitude and longitude [deg] and altitude above sea level [m]."""
        return geodetic_from_enu(self.quad.estimated_position_local_enu_m(), self.quad.origin)

    @property
    def rally_points(self) -> list[Vector3]:
        """Those that it has stored; latitude and longitude [deg], altitude above sea level [m]."""
        return [geodetic_from_enu(place, self.quad.world_origin) for place in self._incidents.rally_points_enu_m]

    def return_place(self) -> Vector3:
        """Where a return ends: the nearest of home and rally points; latitude, longitude and altitude as of `home`."""
        x, y, _ = self.quad.estimated_position_local_enu_m()

        def away_m(place: Vector3) -> float:
            east, north, _ = enu_from_geodetic(*place, self.quad.origin)
            return hypot(east - x, north - y)

        return min((self.home, *self.rally_points), key=away_m)

    # ------------------------------------------------------------ requests

    @property
    def follows_setpoints(self) -> bool:
        """Whether it looks at external setpoints in its present mode."""
        return True

    @abstractmethod
    def take_setpoint(self, setpoint: AttitudeSetpoint | Course) -> None:
        """An external attitude and thrust, or a position or velocity."""

    @abstractmethod
    def stop(self) -> None:
        """The reaction to an external setpoint that cannot be followed."""

    def send_text(self, severity: int, text: str) -> None:
        self.texts.append((severity, text))

    def _start_motors(self, text: str) -> None:
        """Arm: home is here from now on."""
        self.armed = True
        self._ground.arm(self.time_s)
        self.home = self.here_geodetic()
        self._automatic.reset_integrals()
        self._enter(self.mode)
        self.send_text(INFO, text)

    def set_origin(self, origin_deg_deg_m: Vector3) -> None:
        """Move the origin of the local frame at once, or name its place; the vehicle does not move."""
        before = self.quad.origin
        if self.vision is not None:
            self.vision.set_origin(origin_deg_deg_m, self.time_s)
            self.home = self.here_geodetic()
        else:
            self.quad.set_origin(origin_deg_deg_m)
            self._automatic.origin_moved(enu_from_geodetic(*before, self.quad.origin))
        self.origin_changes += 1

    def take_pose(self, pose: Pose) -> None:
        """A pose of external vision."""
        if self.vision is not None and self.loss is None:
            self.vision.receive(pose, self.time_s, self.boot_ms / 1000.0)

    def reset_estimator(self, shift_enu_m: Vector3) -> None:
        """Shift the estimated position and the goals of automatic flight: the vehicle does not move."""
        self.quad.shift_estimate(shift_enu_m)
        self._automatic.origin_moved(shift_enu_m)

    # ------------------------------------------------------------ time

    def step(self) -> None:
        """Advance by dt_s: failsafes, control of the flight mode, physics, ground contact."""
        self._steps += 1
        self.time_s = self._steps * self.dt_s
        if self._incidents.next_s <= self.time_s:
            self._meet_incidents()
        control_is_due = self._steps % self._control_steps == 0
        if control_is_due:
            self._run_failsafes()
        if self.armed:
            self._control(control_is_due)
        else:
            self.setpoint = MOTORS_OFF
        if self.vision is None:
            self.quad.step(self.setpoint)
        else:
            self.vision.step(self.time_s, self.dt_s, self.armed)
            self.quad.step(self.vision.true_setpoint(self.setpoint))
        if self.armed:
            self._update_ground_contact()

    def _meet_incidents(self) -> None:
        """Estimator resets that are due, and a pilot who takes over."""
        while (shift_enu_m := self._incidents.reset(self.time_s)) is not None:
            self.reset_estimator(shift_enu_m)
        if (home_enu_m := self._incidents.home(self.time_s)) is not None:
            self.home = geodetic_from_enu(home_enu_m, self.quad.world_origin)
        self._incidents.lose_position(self.time_s)
        if self.vision is None:
            self._drift()
        if text := self._incidents.failsafe_text(self.time_s):
            self.send_text(WARNING, text)
        if self._incidents.pilot_takes_over(self.time_s) and self.armed and self._ground.flies:
            self._enter_pilot_mode()

    def _drift(self) -> None:
        """Dead reckoning without GPS."""
        if loss := self._incidents.loss:
            (x, y, z), lost_s = loss.drift_enu_m_s2, self.position_lost_s
            self.quad.drift_m_s = (x * lost_s, y * lost_s, z * lost_s)
            half_s2 = 0.5 * lost_s * lost_s
            self.quad.drift_m = (x * half_s2, y * half_s2, z * half_s2)
        else:
            self.quad.drift_m = self.quad.drift_m_s = ZERO3

    @abstractmethod
    def _enter(self, mode: Any) -> None:
        """Begin the task of a mode of this type, from here."""

    @abstractmethod
    def _enter_pilot_mode(self) -> None:
        """Enter the mode in which a pilot sets velocities; the pilot's course is flown while it lasts."""

    @abstractmethod
    def _run_failsafes(self) -> None:
        """Check setpoint streams and failsafes, every CONTROL_PERIOD_S."""

    @abstractmethod
    def _control(self, control_is_due: bool) -> None:
        """Set the setpoint of this step; the vehicle is armed."""

    @abstractmethod
    def _update_ground_contact(self) -> None:
        """Detect take-off and landing; disarm on the ground after the configured time."""

    def _thrust_is_low(self) -> bool:
        return self.setpoint.thrust_norm <= LOW_THRUST_RATIO * self._automatic.hover_thrust_norm
