"""The stand-in that behaves like ArduCopter 4.5 to 4.7, as measured: modes, arming, failsafes.

No sockets, no clocks. `sitl.autopilots.ardupilot.link` handles incoming messages.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import inf, isfinite
from pathlib import Path

from companion.geometry.frames import Quaternion, euler_from_quaternion, quaternion_from_euler
from companion.types.autopilot import AutopilotKind
from companion.types.values import Vector3
from sitl.autopilots.ardupilot.logs import LogService, dataflash_head, dataflash_row
from sitl.autopilots.ardupilot.modes import ARMABLE, NEED_A_POSITION, CopterMode, StartUp, VisionStartUp
from sitl.autopilots.autopilot import (
    CRITICAL,
    IDLE_THRUST_NORM,
    INFO,
    STATE_ACTIVE,
    STATE_BOOT,
    STATE_CRITICAL,
    STATE_STANDBY,
    WARNING,
    Autopilot,
)
from sitl.autopilots.logs import StandInLogs
from sitl.autopilots.parameters import load_data
from sitl.vehicle.automatic_flight import LEAST_COS_TILT, Course, Speeds, Task, cos_tilt
from sitl.vehicle.config import AutopilotFile
from sitl.vehicle.control import AttitudeSetpoint

THRUST_INSTEAD_OF_CLIMB_RATE = 8  # of GUID_OPTIONS
SPOOLED_UP_AFTER_S = 2.7  # from arming; before, it does not lift off
RUN_UP_S = 1.3  # of a take-off, from its command
TOUCHED_DOWN_THROTTLE_NORM = -0.16  # its vertical loop still descends while the motors stop
DISARMED_AFTER_LANDING_S = 0.6  # in LAND and RTL, after the landing is detected; 2.1 s after the touchdown
AT_HOME_M = 0.5  # within this distance a return is at home
LEAST_CONE_SLOPE = 0.5  # below it there is no cone
LOGS_AFTER_DISARMING_S = 15.0
DEAD_RECKONS_S, EKF_FAILSAFE_S = 7.0, 0.9  # after GPS or vision is lost; and after the position is lost


@dataclass(frozen=True, slots=True)
class SigningSetup:
    """Key and timestamp (10 us since 2015) of the last SETUP_SIGNING, and the time of its receipt."""

    key: bytes
    stamp: int
    set_s: float


class ArduCopter(Autopilot):
    """A stand-in ArduCopter. `dt_s` is the step of physics and attitude control."""

    kind = AutopilotKind.ARDUPILOT
    data = load_data(Path(__file__).parent)
    mode: CopterMode
    takes_off = False
    commanded_thrust_norm = 0.0  # before the compensation of the tilt

    def __init__(self, file: AutopilotFile, dt_s: float) -> None:
        super().__init__(file, dt_s)
        self.flight_logs = StandInLogs(dataflash_head, partial(dataflash_row, self), LOGS_AFTER_DISARMING_S)
        self.log_service = LogService()
        self.parameters.set("RALLY_TOTAL", len(self.rally_points))
        self.mode = self.intended_mode = CopterMode.STABILIZE
        ready_s = self.armable_after_s(file.stand_in)
        self.start = VisionStartUp(ready_s, vision=self.vision) if self.vision else StartUp(ready_s)
        self.failsafe = self.ekf_failsafe = False
        self.signing: SigningSetup | None = None
        self._lifts_off_s = 0.0
        self._followed: AttitudeSetpoint | Course | None = None  # in GUIDED; None holds
        self._followed_s = 0.0
        self._level: Quaternion | None = None  # since a stream of attitudes ended

    # ------------------------------------------------------------ state

    @property
    def armable(self) -> bool:
        return self.mode in ARMABLE and not self._obstacles()

    @property
    def has_position(self) -> bool:
        return self.start.has_position(self.time_s) and self.position_lost_s < DEAD_RECKONS_S

    @property
    def system_status(self) -> int:
        if not self.start.initialised(self.time_s):
            return STATE_BOOT
        if self.failsafe:
            return STATE_CRITICAL
        return STATE_STANDBY if self._ground.landed else STATE_ACTIVE

    @property
    def has_origin(self) -> bool:
        return self.start.has_origin(self.time_s)

    def speeds(self) -> Speeds:
        p = self.parameters
        down = p["WPNAV_SPEED_DN"] / 100.0
        low_m = p["LAND_ALT_LOW"] / 100.0
        final_m = p["RTL_ALT_FINAL"] / 100.0  # height at which it holds; 0 lands
        return Speeds(
            level_m_s=p["WPNAV_SPEED"] / 100.0,
            climb_m_s=p["WPNAV_SPEED_UP"] / 100.0,
            take_off_m_s=p["WPNAV_SPEED_UP"] / 100.0,
            land_m_s=p["LAND_SPEED"] / 100.0,
            descend_m_s=p["LAND_SPEED_HIGH"] / 100.0 or down,
            landing_slows_m=(low_m, low_m + 1.0),
            sink_m_s=(p["PILOT_SPEED_DN"] or p["PILOT_SPEED_UP"]) / 100.0,
            take_off_height_m=0.0,
            return_height_m=self._return_height_m,
            return_accepts_m=AT_HOME_M,
            return_wait_height_m=final_m or inf,
            return_wait_s=inf if final_m else p["RTL_LOIT_TIME"] / 1000.0,
        )

    def _return_height_m(self, distance_m: float) -> float:
        """Height above home: RTL_ALT, near home that of the cone."""
        highest_m, slope = self.parameters["RTL_ALT"] / 100.0, self.parameters["RTL_CONE_SLOPE"]
        return min(highest_m, distance_m * slope) if slope >= LEAST_CONE_SLOPE else highest_m

    def wanted_euler_rad(self) -> Vector3:
        return euler_from_quaternion(self.setpoint.quaternion if self.armed else self.quad.estimated_quaternion())

    def _obstacles(self) -> list[str]:
        needs_position = self.mode in NEED_A_POSITION
        return self.start.obstacles(self.time_s, needs_position, self.parameters["ARMING_CHECK"] != 0)

    # ------------------------------------------------------------ requests

    def set_mode(self, mode: CopterMode) -> str | None:
        """The reason of a refusal, or None. Disarmed, every mode is accepted."""
        if self.armed and mode is not self.mode:
            if mode is CopterMode.AUTO:
                return "Mode change to AUTO failed: init failed"  # there is no mission
            refused = self._incidents.refuses(mode.name, self.time_s)
            if refused or (mode in NEED_A_POSITION and not self.has_position):
                return f"Mode change to {mode.name} failed: requires position"
        if mode is not self.mode:
            self._enter(mode)
        return None

    def set_origin(self, origin_deg_deg_m: Vector3) -> None:
        super().set_origin(origin_deg_deg_m)
        for text in ("EKF3 IMU0 origin set", f"Field Elevation Set: {origin_deg_deg_m[2]:.0f}m"):
            self.send_text(INFO, text)

    @property
    def follows_setpoints(self) -> bool:
        return self.mode is CopterMode.GUIDED

    def take_setpoint(self, setpoint: AttitudeSetpoint | Course) -> None:
        """The next setpoint of GUIDED; in other modes it is ignored silently."""
        if self.mode is not CopterMode.GUIDED:
            return
        if type(setpoint) is not type(self._followed):
            self._stop()
        self._followed, self._followed_s, self._level = setpoint, self.time_s, None

    def stop(self) -> None:
        """Brake and hold in GUIDED: the reaction to an invalid setpoint."""
        if self.mode is CopterMode.GUIDED and (self._followed is not None or self.takes_off):
            self._stop()

    def take_off(self, height_m: float) -> bool:
        """NAV_TAKEOFF to a height above home, in GUIDED, armed and on the ground."""
        top_m = self.home[2] + height_m
        if (
            self.mode is not CopterMode.GUIDED
            or not self.armed
            or not self._ground.landed
            or top_m <= self.here_geodetic()[2]
        ):
            return False
        self._stop()
        self.takes_off = True
        self._lifts_off_s = max(self._lifts_off_s, self.time_s + RUN_UP_S)
        self._automatic.enter(Task.TAKE_OFF, self.home, top_m)
        return True

    def arm(self, forced: bool = False) -> list[str]:
        """The reasons of a refusal; empty if it is armed now."""
        if self.armed:
            return []
        if not self.start.initialised(self.time_s) or not forced:
            if reasons := self._obstacles():
                return reasons
            if self.mode not in ARMABLE:
                return [f"{self.mode.name} mode not armable"]
        self._lifts_off_s = self.time_s + SPOOLED_UP_AFTER_S
        self._start_motors("Arming motors")
        return []

    def disarm(self, forced: bool = False) -> bool:
        """Whether it is disarmed now. In the air only if forced."""
        if self.armed and not forced and not self._ground.landed:
            return False
        if self.armed:
            self.armed = False
            self.commanded_thrust_norm = 0.0
            self.takes_off = False
            self._followed = None
            self.send_text(INFO, "Disarming motors")
        return True

    # ------------------------------------------------------------ time

    def _run_failsafes(self) -> None:
        for text in self.start.announcements(self.time_s):
            self.send_text(INFO, text)
            if text == "ArduPilot Ready":  # earlier mode commands are lost
                self._enter(CopterMode.STABILIZE)
            elif "origin set" in text:
                self.home = self.here_geodetic()
                self.origin_changes += 1
        if self.armed:
            self._check_ground_station()
            self._check_estimator()
        elif self.start.prearm_is_due(self.time_s):
            for reason in self._obstacles():
                self.send_text(CRITICAL, f"PreArm: {reason}")

    def _check_estimator(self) -> None:
        lost = self.position_lost_s >= DEAD_RECKONS_S + EKF_FAILSAFE_S
        if lost and not self.ekf_failsafe:
            self.send_text(CRITICAL, "EKF variance")
            if self.mode in NEED_A_POSITION:
                self.send_text(CRITICAL, "EKF Failsafe: changed to LAND Mode")
                self._enter(CopterMode.LAND)
        self.ekf_failsafe = lost

    def _check_ground_station(self) -> None:
        heartbeat_s = self.ground_station_s
        mode = self.data.ground_station_lost.get(int(self.parameters["FS_GCS_ENABLE"]))
        if heartbeat_s is None or mode is None:  # a ground station must have connected before it can be lost
            return
        lost = self.time_s - heartbeat_s > self.parameters["FS_GCS_TIMEOUT"]
        if lost and not self.failsafe:
            self.send_text(WARNING, "GCS Failsafe")
            self._enter(CopterMode[mode])
        elif self.failsafe and not lost:
            self.send_text(WARNING, "GCS Failsafe Cleared")  # the mode is kept
        self.failsafe = lost

    def _control(self, control_is_due: bool) -> None:
        if self._waits_on_ground():
            self._thrust(AttitudeSetpoint(self.quad.estimated_quaternion(), IDLE_THRUST_NORM))
            if self.mode is CopterMode.LAND:
                self.commanded_thrust_norm = TOUCHED_DOWN_THROTTLE_NORM
        elif self.mode is CopterMode.STABILIZE:  # the throttle stick is at the bottom
            self._thrust(AttitudeSetpoint(quaternion_from_euler(0.0, 0.0, self.quad.estimated_euler_rad()[2]), 0.0))
        elif self.mode is CopterMode.GUIDED and isinstance(self._followed, AttitudeSetpoint):
            self._follow_attitude(self._followed, control_is_due)
        elif control_is_due:
            self._fly_automatically()

    def _waits_on_ground(self) -> bool:
        """On the ground until it is to lift off and the motors have spooled up."""
        if not self._ground.landed:
            return False
        return not self._is_to_lift_off() or self.time_s < self._lifts_off_s

    def _is_to_lift_off(self) -> bool:
        if self.takes_off or self.mode is not CopterMode.GUIDED:
            return self.takes_off
        if isinstance(self._followed, AttitudeSetpoint) and self._level is None:
            return self._followed.thrust_norm > (0.0 if self._takes_thrust() else 0.5)
        return False

    def _fly_automatically(self) -> None:
        if self.takes_off and self._automatic.taken_off():
            self.takes_off = False
        if self._incidents.course is not None and self.mode is CopterMode.LOITER:
            self._thrust(self._automatic.follow(self._incidents.course, self._control_dt_s))
            return
        followed = self._followed if self.mode is CopterMode.GUIDED else None
        if isinstance(followed, Course):
            if not isfinite(followed.position_m[0]) and self._silent_s() > self.parameters["GUID_TIMEOUT"]:
                self._stop()
            else:
                self._thrust(self._automatic.follow(followed, self._control_dt_s))
                return
        self._thrust(self._automatic.setpoint(self._control_dt_s))

    def _follow_attitude(self, followed: AttitudeSetpoint, control_is_due: bool) -> None:
        """Follow the last attitude and thrust until they are GUID_TIMEOUT old; then level at this height, drifting."""
        if self._level is None and self._silent_s() > self.parameters["GUID_TIMEOUT"]:
            self._level = quaternion_from_euler(0.0, 0.0, euler_from_quaternion(followed.quaternion)[2])
            self._restart_task()
        if self._level is not None:
            if control_is_due:
                self._thrust(self._automatic.climb(self._level, 0.0, self._control_dt_s))
        elif not self._takes_thrust():
            if control_is_due:
                self._thrust(self._automatic.climb(followed.quaternion, self._climb_m_s(followed), self._control_dt_s))
        else:
            self.commanded_thrust_norm = (
                min(max(followed.thrust_norm, 0.0), 1.0) if isfinite(followed.thrust_norm) else 0.0
            )
            boost = 1.0
            if followed.rates_rad_s is None and self.parameters["ATC_ANGLE_BOOST"]:
                boost = 1.0 / max(cos_tilt(followed.quaternion), LEAST_COS_TILT)
            thrust_norm = min(self.commanded_thrust_norm * boost, 1.0)
            turn = (followed.yaw_rate_rad_s, followed.rates_rad_s)
            self.setpoint = AttitudeSetpoint(followed.quaternion, thrust_norm, *turn)

    def _takes_thrust(self) -> bool:
        return bool(int(self.parameters["GUID_OPTIONS"]) & THRUST_INSTEAD_OF_CLIMB_RATE)

    def _climb_m_s(self, followed: AttitudeSetpoint) -> float:
        """Climb rate of a thrust without GUID_OPTIONS bit 3: 0.5 holds, 1 and 0 are the WPNAV climb and descent speeds."""
        share = 2.0 * (min(max(followed.thrust_norm, 0.0), 1.0) - 0.5) if isfinite(followed.thrust_norm) else 0.0
        return share * self.parameters["WPNAV_SPEED_UP" if share > 0.0 else "WPNAV_SPEED_DN"] / 100.0

    def _silent_s(self) -> float:
        return self.time_s - self._followed_s

    def _thrust(self, setpoint: AttitudeSetpoint) -> None:
        """Set a setpoint whose thrust already compensates the tilt."""
        self.setpoint = setpoint
        self.commanded_thrust_norm = setpoint.thrust_norm * max(cos_tilt(setpoint.quaternion), LEAST_COS_TILT)

    # ------------------------------------------------------------ ground and modes

    def _update_ground_contact(self) -> None:
        if self._ground.flies and self._ground.flown and not self.quad.on_ground:
            return  # no change
        self._ground.update(self.quad.on_ground, self._thrust_is_low(), self.time_s)
        landing = self._ground.flown and self.mode in (CopterMode.LAND, CopterMode.RTL)
        delay_s = DISARMED_AFTER_LANDING_S if landing else self.parameters["DISARM_DELAY"] or inf
        if self._ground.idle_s(self.time_s) > delay_s and not self._is_to_lift_off():
            self.disarm(forced=True)

    def _enter_pilot_mode(self) -> None:
        self._enter(CopterMode.LOITER)

    def _enter(self, mode: CopterMode) -> None:
        self.mode = self.intended_mode = mode
        self._stop()

    def _stop(self) -> None:
        self.takes_off = False
        self._followed = self._level = None
        self._restart_task()

    def _restart_task(self) -> None:
        home = self.return_place() if self.mode is CopterMode.RTL else self.home
        self._automatic.enter(self.mode.task, home, None)
