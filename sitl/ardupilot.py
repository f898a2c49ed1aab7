"""The stand-in autopilot with ArduCopter's manners (4.5 to 4.7), as they were measured: modes, arming, failsafes.

No sockets, no clocks. Messages come in through `sitl.ardupilot_commands`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite

from companion.frames import Quaternion, euler_from_quaternion, quaternion_from_euler
from companion.types import AutopilotKind, Vector3
from sitl.ardupilot_modes import ARMABLE, GROUND_STATION_LOSS, NEED_A_POSITION, Mode
from sitl.ardupilot_parameters import ArduPilotParameters
from sitl.ardupilot_start import Start
from sitl.attitude_control import Loops, Setpoint
from sitl.autopilot import CRITICAL, IDLE_THRUST_NORM, INFO, WARNING, Autopilot
from sitl.config import AutopilotFile
from sitl.dataflash import DataFlash
from sitl.flight_logs import FlightLogs
from sitl.messages import LANDED_IN_AIR, LANDED_LANDING, LANDED_ON_GROUND, LANDED_TAKEOFF
from sitl.own_flight import LEAST_COS_TILT, Speeds, Task, cos_tilt
from sitl.setpoints import Course

# A roll step of 10 degrees passes 10, 50 and 90 % at 70, 170 and 382 ms without overshoot; a yaw step of 60 degrees passes
# 90 % at 0.94 s.
ARDUPILOT_LOOPS = Loops(
    tilt_gain_1_s=5.5,
    yaw_gain_1_s=2.2,
    rate_gain_1_s=28.0,
    yaw_rate_gain_1_s=9.0,
    delay_s=0.004,
    max_rate_rad_s=3.84,
    max_yaw_rate_rad_s=1.9,
)
THRUST_IS_THRUST = 8  # of GUID_OPTIONS
BRAKING_M_S2 = 0.55
SPOOLED_UP_AFTER_S = 2.7  # from arming: before that nothing lifts it off
RUN_UP_S = 1.3  # of a take-off, from its command
TOUCHED_DOWN_THROTTLE_NORM = -0.16  # its vertical loop still wants down while the motors stop
DISARMED_AFTER_LANDING_S = 0.6  # in LAND and RTL, from the landing's being known; 2.1 s from the touch
AT_HOME_M = 0.5  # where a return counts as come home
LEAST_CONE_SLOPE = 0.5  # a flatter one is no cone
LOGS_AFTER_DISARMING_S = 15.0
STATE_BOOT, STATE_STANDBY, STATE_ACTIVE, STATE_CRITICAL = 1, 3, 4, 5  # MAV_STATE


@dataclass(frozen=True, slots=True)
class Signing:
    """What SETUP_SIGNING has brought, and when: the key, and the stamp of that moment (10 us since 2015)."""

    key: bytes
    stamp: int
    set_s: float


@dataclass(slots=True)
class LogService:
    """Which link's request for logs is being served; and whether it was said that none is while it is armed."""

    link: object | None = None
    refusal_told: bool = False


class ArduCopter(Autopilot):
    """One vehicle. `dt_s` is the step of physics and attitude control."""

    kind = AutopilotKind.ARDUPILOT
    parameters: ArduPilotParameters

    def __init__(self, file: AutopilotFile, dt_s: float) -> None:
        parameters = ArduPilotParameters(file.id, file.stand_in.parameters)
        super().__init__(file, dt_s, ARDUPILOT_LOOPS, parameters, BRAKING_M_S2)
        self.flight_logs = FlightLogs(DataFlash(self), LOGS_AFTER_DISARMING_S)
        self.log_service = LogService()
        self.mode = Mode.STABILIZE
        self.start = Start(file.stand_in.ready_after_s)
        self.throttle_norm = 0.0  # commanded, before the tilt is made up for
        self.failsafe = False
        self.signing: Signing | None = None
        self._taking_off = False
        self._lifts_off_s = 0.0
        self._followed: Setpoint | Course | None = None  # in GUIDED; None holds
        self._followed_s = 0.0
        self._level: Quaternion | None = None  # since a stream of attitudes ended

    # ------------------------------------------------------------ what it is like now

    @property
    def flight_mode(self) -> Mode:
        return self.mode

    @property
    def armable(self) -> bool:
        return self.mode in ARMABLE and not self._obstacles()

    @property
    def has_position(self) -> bool:
        return self.start.has_position(self.time_s)

    @property
    def system_status(self) -> int:
        if not self.start.initialised(self.time_s):
            return STATE_BOOT
        if self.failsafe:
            return STATE_CRITICAL
        return STATE_STANDBY if self._ground.landed else STATE_ACTIVE

    @property
    def landed_state(self) -> int:
        if self._ground.landed:
            return LANDED_ON_GROUND
        if self._taking_off:
            return LANDED_TAKEOFF
        return LANDED_LANDING if self._own.landing else LANDED_IN_AIR

    def speeds(self) -> Speeds:
        p = self.parameters
        down = p["WPNAV_SPEED_DN"] / 100.0
        low_m = p["LAND_ALT_LOW"] / 100.0
        final_m = p["RTL_ALT_FINAL"] / 100.0  # where it stays; 0 lands
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
        """Above home: RTL_ALT, or nearer to home the cone's."""
        highest_m, slope = self.parameters["RTL_ALT"] / 100.0, self.parameters["RTL_CONE_SLOPE"]
        return min(highest_m, distance_m * slope) if slope >= LEAST_CONE_SLOPE else highest_m

    def wanted_euler_rad(self) -> Vector3:
        return euler_from_quaternion(self.setpoint.quaternion if self.armed else self.quad.estimated_quaternion())

    def _obstacles(self) -> list[str]:
        needs_position = self.mode in NEED_A_POSITION
        return self.start.obstacles(self.time_s, needs_position, self.parameters["ARMING_CHECK"] != 0)

    # ------------------------------------------------------------ what can be asked of it

    def set_mode(self, mode: Mode) -> str | None:
        """Why not, or None. Disarmed it takes every mode, whether it could fly it or not."""
        if self.armed and mode is not self.mode:
            if mode is Mode.AUTO:
                return "Mode change to AUTO failed: init failed"  # there is no mission
            if mode in NEED_A_POSITION and not self.has_position:
                return f"Mode change to {mode.name} failed: requires position"
        if mode is not self.mode:
            self._enter(mode)
        return None

    def take_setpoint(self, setpoint: Setpoint | Course) -> None:
        """Of what GUIDED follows; in other modes it is silently ignored."""
        if self.mode is not Mode.GUIDED:
            return
        if type(setpoint) is not type(self._followed):
            self._stop()
        self._followed, self._followed_s, self._level = setpoint, self.time_s, None

    def stop(self) -> None:
        """What a setpoint without sense does to a vehicle in GUIDED: it brakes and holds."""
        if self.mode is Mode.GUIDED and (self._followed is not None or self._taking_off):
            self._stop()

    def take_off(self, height_m: float) -> bool:
        """NAV_TAKEOFF to a height above home, in GUIDED, armed and on the ground."""
        top_m = self.home[2] + height_m
        if (
            self.mode is not Mode.GUIDED
            or not self.armed
            or not self._ground.landed
            or top_m <= self.here_geodetic()[2]
        ):
            return False
        self._stop()
        self._taking_off = True
        self._lifts_off_s = max(self._lifts_off_s, self.time_s + RUN_UP_S)
        self._own.enter(Task.TAKE_OFF, self.home, top_m)
        return True

    def arm(self, forced: bool = False) -> list[str]:
        """Why not: nothing where it is armed now."""
        if self.armed:
            return []
        if not self.start.initialised(self.time_s) or not forced:
            if reasons := self._obstacles():
                return reasons
            if self.mode not in ARMABLE:
                return [f"{self.mode.name} mode not armable"]
        self.armed = True
        self._lifts_off_s = self.time_s + SPOOLED_UP_AFTER_S
        self._ground.arm(self.time_s)
        self.home = self.here_geodetic()
        self._own.forget_wind()
        self._enter(self.mode)
        self.say(INFO, "Arming motors")
        return []

    def disarm(self, forced: bool = False) -> bool:
        """Not in the air, unless forced."""
        if self.armed and not forced and not self._ground.landed:
            return False
        if self.armed:
            self.armed = False
            self.throttle_norm = 0.0
            self._taking_off = False
            self._followed = None
            self.say(INFO, "Disarming motors")
        return True

    # ------------------------------------------------------------ time

    def _look_after(self) -> None:
        for text in self.start.announcements(self.time_s):
            self.say(INFO, text)
            if text == "ArduPilot Ready":  # what mode was asked for before is forgotten
                self._enter(Mode.STABILIZE)
            elif "origin set" in text:
                self.home = self.here_geodetic()
                self.origin_changes += 1
        if self.armed:
            self._look_after_ground_station()
        elif self.start.prearm_is_due(self.time_s):
            for reason in self._obstacles():
                self.say(CRITICAL, f"PreArm: {reason}")

    def _look_after_ground_station(self) -> None:
        heard_s = self.ground_station_s
        mode = GROUND_STATION_LOSS.get(int(self.parameters["FS_GCS_ENABLE"]))
        if heard_s is None or mode is None:  # one that was never heard cannot be lost
            return
        lost = self.time_s - heard_s > self.parameters["FS_GCS_TIMEOUT"]
        if lost and not self.failsafe:
            self.say(WARNING, "GCS Failsafe")
            self._enter(mode)
        elif self.failsafe and not lost:
            self.say(WARNING, "GCS Failsafe Cleared")  # and the mode stays
        self.failsafe = lost

    def _control(self, control_is_due: bool) -> None:
        if self._waits_on_ground():
            self._thrust(Setpoint(self.quad.estimated_quaternion(), IDLE_THRUST_NORM))
            if self.mode is Mode.LAND:
                self.throttle_norm = TOUCHED_DOWN_THROTTLE_NORM
        elif self.mode is Mode.STABILIZE:  # the throttle stick is at the bottom
            self._thrust(Setpoint(quaternion_from_euler(0.0, 0.0, self.quad.estimated_euler_rad()[2]), 0.0))
        elif self.mode is Mode.GUIDED and isinstance(self._followed, Setpoint):
            self._follow_attitude(self._followed, control_is_due)
        elif control_is_due:
            self._fly_by_itself()

    def _waits_on_ground(self) -> bool:
        """It stands there until something makes it take off and the motors have run up."""
        if not self._ground.landed:
            return False
        return not self._wants_up() or self.time_s < self._lifts_off_s

    def _wants_up(self) -> bool:
        if self._taking_off or self.mode is not Mode.GUIDED:
            return self._taking_off
        if isinstance(self._followed, Setpoint) and self._level is None:
            return self._followed.thrust_norm > (0.0 if self._thrust_is_thrust() else 0.5)
        return False

    def _fly_by_itself(self) -> None:
        if self._taking_off and self._own.taken_off():
            self._taking_off = False
        followed = self._followed if self.mode is Mode.GUIDED else None
        if isinstance(followed, Course):
            if not isfinite(followed.position_m[0]) and self._silent_s() > self.parameters["GUID_TIMEOUT"]:
                self._stop()
            else:
                self._thrust(self._own.follow(followed, self._control_dt_s))
                return
        self._thrust(self._own.setpoint(self._control_dt_s))

    def _follow_attitude(self, followed: Setpoint, control_is_due: bool) -> None:
        """The last attitude and thrust, until they are GUID_TIMEOUT old: then level, at this height, wherever it drifts."""
        if self._level is None and self._silent_s() > self.parameters["GUID_TIMEOUT"]:
            self._level = quaternion_from_euler(0.0, 0.0, euler_from_quaternion(followed.quaternion)[2])
            self._own_from_here()
        if self._level is not None:
            if control_is_due:
                self._thrust(self._own.climb(self._level, 0.0, self._control_dt_s))
        elif not self._thrust_is_thrust():
            if control_is_due:
                self._thrust(self._own.climb(followed.quaternion, self._climb_m_s(followed), self._control_dt_s))
        else:
            self.throttle_norm = min(max(followed.thrust_norm, 0.0), 1.0) if isfinite(followed.thrust_norm) else 0.0
            boost = 1.0
            if followed.rates_rad_s is None and self.parameters["ATC_ANGLE_BOOST"]:
                boost = 1.0 / max(cos_tilt(followed.quaternion), LEAST_COS_TILT)
            self.setpoint = Setpoint(
                followed.quaternion, min(self.throttle_norm * boost, 1.0), followed.yaw_rate_rad_s, followed.rates_rad_s
            )

    def _thrust_is_thrust(self) -> bool:
        return bool(int(self.parameters["GUID_OPTIONS"]) & THRUST_IS_THRUST)

    def _climb_m_s(self, followed: Setpoint) -> float:
        """Without GUID_OPTIONS bit 3 a thrust of 0.5 holds the height, 1 climbs and 0 sinks as fast as WPNAV has it."""
        share = 2.0 * (min(max(followed.thrust_norm, 0.0), 1.0) - 0.5) if isfinite(followed.thrust_norm) else 0.0
        return share * self.parameters["WPNAV_SPEED_UP" if share > 0.0 else "WPNAV_SPEED_DN"] / 100.0

    def _silent_s(self) -> float:
        return self.time_s - self._followed_s

    def _thrust(self, setpoint: Setpoint) -> None:
        """A setpoint of its own, whose thrust makes up for the tilt already."""
        self.setpoint = setpoint
        self.throttle_norm = setpoint.thrust_norm * max(cos_tilt(setpoint.quaternion), LEAST_COS_TILT)

    # ------------------------------------------------------------ ground and modes

    def _watch_ground(self) -> None:
        self._ground.watch(self.quad.stands, self._thrust_is_little(), self.time_s)
        landing = self._ground.flown and self.mode in (Mode.LAND, Mode.RTL)
        delay_s = DISARMED_AFTER_LANDING_S if landing else self.parameters["DISARM_DELAY"] or inf
        if self._ground.idle_s(self.time_s) > delay_s and not self._wants_up():
            self.disarm(forced=True)

    def _enter(self, mode: Mode) -> None:
        self.mode = mode
        self._stop()

    def _stop(self) -> None:
        self._taking_off = False
        self._followed = self._level = None
        self._own_from_here()

    def _own_from_here(self) -> None:
        self._own.enter(self.mode.task, self.home, None)
