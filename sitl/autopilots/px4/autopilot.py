"""The stand-in that behaves like PX4 v1.16, as measured: modes, arming, failsafes. No sockets, no clocks."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import partial
from math import inf, radians, tan
from pathlib import Path

from companion.mavlink.codec import mavlink
from companion.types.autopilot import AutopilotKind
from companion.types.values import Vector3
from sitl.autopilots.autopilot import (
    CRITICAL,
    IDLE_THRUST_NORM,
    INFO,
    STATE_ACTIVE,
    STATE_CRITICAL,
    STATE_STANDBY,
    STATE_UNINIT,
    Autopilot,
)
from sitl.autopilots.external_vision import ExternalVision
from sitl.autopilots.logs import StandInLogs
from sitl.autopilots.parameters import BytewiseParameters, load_data
from sitl.autopilots.px4.logs import ulog_head, ulog_row
from sitl.vehicle.automatic_flight import Course, Speeds, Task
from sitl.vehicle.config import AutopilotFile
from sitl.vehicle.control import AttitudeSetpoint


class Px4Mode(Enum):
    """A flight mode as (main, sub) of custom_mode."""

    MANUAL = (1, 0)
    ALTCTL = (2, 0)
    POSCTL = (3, 0)
    TAKEOFF = (4, 2)
    LOITER = (4, 3)
    MISSION = (4, 4)
    RTL = (4, 5)
    LAND = (4, 6)
    ACRO = (5, 0)
    OFFBOARD = (6, 0)
    STABILIZED = (7, 0)

    @property
    def custom_mode(self) -> int:
        """The main mode in its third byte, the sub mode in its fourth."""
        main, sub = self.value
        return int(main << 16 | sub << 24)

    @property
    def flags(self) -> int:
        if self in NEED_A_PILOT:
            return mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        main, _ = self.value
        is_auto = main == 4
        return mavlink.MAV_MODE_FLAG_AUTO_ENABLED | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED if is_auto else 0

    @property
    def task(self) -> Task:
        return Task.SINK if self in NEED_A_PILOT else _TASKS.get(self, Task.HOLD)


OFFBOARD = Px4Mode.OFFBOARD  # member lookup of an enum is slow, and every step needs it
# There is no remote control, so these cannot fly the vehicle.
NEED_A_PILOT = frozenset({Px4Mode.MANUAL, Px4Mode.ALTCTL, Px4Mode.POSCTL, Px4Mode.ACRO, Px4Mode.STABILIZED})
_TASKS = {Px4Mode.TAKEOFF: Task.TAKE_OFF, Px4Mode.LAND: Task.LAND, Px4Mode.RTL: Task.RETURN}
NEED_AN_ORIGIN = frozenset({Px4Mode.LOITER, Px4Mode.RTL})
NEED_A_POSITION = frozenset({Px4Mode.TAKEOFF, Px4Mode.LOITER, Px4Mode.RTL})
PREVENT_ARMING = frozenset({Px4Mode.LAND, Px4Mode.RTL})

FAILSAFE_PERIOD_S = 0.1  # the check for lost streams; so the largest delay of a failsafe
STREAM_LOST_GRACE_S = 0.01  # with the period, a lost stream is detected after 1.01 to 1.12 s
STREAM_BACK_AFTER_S = 0.03  # a stream that returns counts after this time
UNSTABLE = "Preflight Fail: horizontal position unstable"
NOT_HEALTHY = "Resolve system health failures first"
DEAD_RECKONS_S = 4.65  # after GPS or vision is lost
SETTLED_AFTER_S = 3.9  # the position by vision, after its first fix with an origin
RETURNS_AFTER_S = 1.5  # to hold, when vision is back
SINK_M_S = 0.85  # of a manual mode without a pilot; 0.7 to 1.0 was measured
LANDING_SLOWS_M = (5.0, 10.0)  # MPC_LAND_ALT2 and MPC_LAND_ALT1 above home


@dataclass(slots=True)
class OffboardStream:
    """The setpoint stream of OFFBOARD: the newest setpoint, its time, and the start of the stream without a gap."""

    newest: AttitudeSetpoint | Course | None = None
    newest_s: float = -inf
    since_s: float = -inf


class Px4(Autopilot):
    """A stand-in PX4. `dt_s` is the step of physics and attitude control."""

    kind = AutopilotKind.PX4
    data = load_data(Path(__file__).parent)
    parameters_type = BytewiseParameters
    mode: Px4Mode
    intended_mode: Px4Mode

    def __init__(self, file: AutopilotFile, dt_s: float) -> None:
        super().__init__(file, dt_s)
        self.flight_logs = StandInLogs(partial(ulog_head, self), partial(ulog_row, self), after_disarming_s=0.0)
        self.mode = self.intended_mode = Px4Mode.LOITER
        self.failsafe = False
        self.takeoff_altitude_amsl_m: float | None = None
        self._armable_after_s = self.armable_after_s(file.stand_in)
        self._failsafe_steps = max(1, round(FAILSAFE_PERIOD_S / dt_s))
        self._mode_after_disarming = Px4Mode.LOITER
        self._stream = OffboardStream()
        self._ground_station_failsafe_s: float | None = None
        self._ground_station_loss_known = False

    # ------------------------------------------------------------ state

    @property
    def armable(self) -> bool:
        if self.time_s < self._armable_after_s or self.mode in PREVENT_ARMING | NEED_A_PILOT | {Px4Mode.MISSION}:
            return False
        if self.mode is Px4Mode.OFFBOARD and not self.streaming:
            return False
        if self.vision is not None and not self._vision_suffices:
            return False
        return not (self.parameters["NAV_DLL_ACT"] > 0 and self.ground_station_lost)

    @property
    def system_status(self) -> int:
        if self.failsafe:
            return STATE_CRITICAL
        if self.armed:
            return STATE_ACTIVE
        return STATE_STANDBY if self.armable else STATE_UNINIT

    @property
    def takes_off(self) -> bool:
        return self.mode is Px4Mode.TAKEOFF

    @property
    def has_position(self) -> bool:
        return self.position_lost_s < DEAD_RECKONS_S and (self.vision is None or self.vision.fixed)

    @property
    def _vision_suffices(self) -> bool:
        placed = self.has_origin or self.mode not in NEED_AN_ORIGIN
        return placed and self.has_position and not self._is_unstable

    @property
    def _is_unstable(self) -> bool:
        if self.vision is None or not self.has_origin:
            return False
        return self.time_s - max(self.vision.fixed_s, self.vision.origin_s) < SETTLED_AFTER_S

    @property
    def reports_position(self) -> bool:
        return True  # also without one, for ever

    @property
    def streaming(self) -> bool:
        """Whether the newest setpoint is at most COM_OF_LOSS_T old."""
        return self.time_s - self._stream.newest_s <= self.parameters["COM_OF_LOSS_T"]

    @property
    def ground_station_lost(self) -> bool:
        newest_s = self.ground_station_s
        return newest_s is None or self.time_s - newest_s > self.parameters["COM_DL_LOSS_T"]

    def speeds(self) -> Speeds:
        p = self.parameters
        delay_s = p["RTL_LAND_DELAY"]
        return Speeds(
            level_m_s=p["MPC_XY_CRUISE"],
            climb_m_s=p["MPC_Z_V_AUTO_UP"],
            take_off_m_s=p["MPC_TKO_SPEED"],
            land_m_s=p["MPC_LAND_SPEED"],
            descend_m_s=p["MPC_Z_V_AUTO_DN"],
            landing_slows_m=LANDING_SLOWS_M,
            sink_m_s=SINK_M_S,
            take_off_height_m=p["MIS_TAKEOFF_ALT"],
            return_height_m=self._return_height_m,
            return_accepts_m=p["NAV_ACC_RAD"],
            return_wait_height_m=p["RTL_DESCEND_ALT"] if delay_s else inf,
            return_wait_s=delay_s if delay_s >= 0.0 else inf,
        )

    def _return_height_m(self, distance_m: float) -> float:
        """Height above home: RTL_RETURN_ALT, near home that of the cone, at home just enough to land at rest."""
        p = self.parameters
        highest_m, accepts_m, cone_deg = p["RTL_RETURN_ALT"], p["NAV_ACC_RAD"], p["RTL_CONE_ANG"]
        if cone_deg <= 0:
            return highest_m
        if distance_m <= accepts_m:
            return min(2.0 * distance_m, highest_m)
        if distance_m > p["RTL_MIN_DIST"]:
            return highest_m
        return min(max(distance_m / tan(radians(min(max(cone_deg, 1.0), 89.0))), 2.0 * accepts_m), highest_m)

    # ------------------------------------------------------------ requests

    def take_setpoint(self, setpoint: AttitudeSetpoint | Course) -> None:
        """The next setpoint of the OFFBOARD stream."""
        stream = self._stream
        if not self.streaming:
            stream.since_s = self.time_s
        if isinstance(setpoint, Course) and not isinstance(stream.newest, Course) and self.mode is Px4Mode.OFFBOARD:
            self._enter(Px4Mode.OFFBOARD)
        stream.newest, stream.newest_s = setpoint, self.time_s

    def stop(self) -> None:
        """None: it goes on with the setpoint before, while the stream counts as lost."""

    def set_mode(self, mode: Px4Mode, takeoff_altitude_amsl_m: float | None = None) -> bool:
        """A mode change on request. Disarmed, every mode is accepted; armed, the mode must be able to fly the vehicle."""
        lost = mode in NEED_A_POSITION and not self.has_position
        can_fly = (
            not lost
            and mode not in NEED_A_PILOT | {Px4Mode.MISSION}
            and (mode is not Px4Mode.OFFBOARD or self.streaming)
        )
        if self.armed and (not can_fly or self._incidents.refuses(mode.name, self.time_s)):
            return False
        if self.armed and mode in NEED_AN_ORIGIN and not self.has_origin:
            return True  # acknowledged, and not done
        if mode is not self.mode or takeoff_altitude_amsl_m is not None:
            self.takeoff_altitude_amsl_m = takeoff_altitude_amsl_m
        self.intended_mode = mode
        if mode not in PREVENT_ARMING:
            self._mode_after_disarming = mode
        self.failsafe = False
        self._ground_station_failsafe_s = None
        self._switch(mode)
        return True

    def take_off(self, altitude_amsl_m: float | None) -> bool:
        """NAV_TAKEOFF, also during a take-off: the new altitude replaces the old one."""
        again = self.mode is Px4Mode.TAKEOFF
        self.set_mode(Px4Mode.TAKEOFF, altitude_amsl_m)
        if again:
            self._enter(Px4Mode.TAKEOFF)
        if self.has_origin and altitude_amsl_m is not None and altitude_amsl_m < self.here_geodetic()[2]:
            self.send_text(CRITICAL, "Already higher than takeoff altitude")  # it holds its present height
        return True

    def go_to(self, position_local_enu_m: Vector3, yaw_rad: float | None) -> bool:
        """DO_REPOSITION: hold at this position."""
        if not self.armed or self._ground.landed:
            return False
        self.set_mode(Px4Mode.LOITER)
        self._automatic.go_to(position_local_enu_m, yaw_rad)
        return True

    def arm(self, forced: bool = False) -> str | None:
        """The reason of a refusal, or None."""
        if self.armed:
            return None
        if not forced and not self.armable:
            if self._is_unstable:
                self.send_text(CRITICAL, UNSTABLE)
            return NOT_HEALTHY
        self._start_motors("Armed by external command")
        return None

    def disarm(self, forced: bool, reason: str = "external command") -> str | None:
        """The reason of a refusal, or None."""
        if not self.armed:
            return None
        if not forced and not self._ground.landed:
            return "not landed"
        self.armed = False
        self.failsafe = False
        self._ground_station_failsafe_s = None
        self.intended_mode = self._mode_after_disarming
        self._switch(self._mode_after_disarming)
        self.send_text(INFO, f"Disarmed by {reason}")
        return None

    # ------------------------------------------------------------ time

    def _control(self, control_is_due: bool) -> None:
        newest = self._stream.newest
        if self.mode is OFFBOARD and isinstance(newest, AttitudeSetpoint):
            self.setpoint = newest
        elif not control_is_due:
            return
        elif self.mode is OFFBOARD and isinstance(newest, Course):
            self.setpoint = self._automatic.follow(newest, self._control_dt_s)
        elif self.mode is Px4Mode.POSCTL and self._incidents.course is not None:
            self.setpoint = self._automatic.follow(self._incidents.course, self._control_dt_s)
        else:
            if self._ground.landed and self.mode is not Px4Mode.TAKEOFF:
                self.setpoint = AttitudeSetpoint(self.quad.estimated_quaternion(), IDLE_THRUST_NORM)
                return
            if self.mode is Px4Mode.TAKEOFF and self.has_origin and self._automatic.taken_off():
                # It holds the commanded height, not the present one.
                self.mode = Px4Mode.LOITER
                if self.intended_mode is Px4Mode.TAKEOFF:
                    self.intended_mode = self._mode_after_disarming = Px4Mode.LOITER
            self.setpoint = self._automatic.setpoint(self._control_dt_s)

    # ------------------------------------------------------------ failsafes

    def _run_failsafes(self) -> None:
        if not self.armed:
            return
        check_is_due = self._steps % self._failsafe_steps == 0
        if self._ground_station_failsafe_s is not None:
            self._go_on_without_ground_station(self._ground_station_failsafe_s)
        elif check_is_due and self._ground_station_is_newly_lost():
            self._ground_station_failsafe_s = self.time_s
            hold_s = self.parameters["COM_FAIL_ACT_T"]  # the pilot may take over in this time
            self._activate_failsafe("LOITER", f": entering Hold for {hold_s:.0f} seconds")
        elif not self.has_position and self.mode in NEED_A_POSITION:
            self._activate_failsafe("LAND")
        elif self.vision is not None and self._vision_is_back(self.vision):
            self.failsafe, self.intended_mode = False, Px4Mode.LOITER
            self._switch(Px4Mode.LOITER)
        elif self.mode is OFFBOARD:
            gap_s = self.time_s - self._stream.newest_s
            if check_is_due and gap_s > self.parameters["COM_OF_LOSS_T"] + STREAM_LOST_GRACE_S:
                self._activate_failsafe(self.data.setpoints_lost.get(int(self.parameters["COM_OBL_RC_ACT"]), "POSCTL"))
        elif self.intended_mode is OFFBOARD and self._stream_is_back():
            # PX4 re-enters OFFBOARD without a command when setpoints come again.
            self.failsafe = False
            self._switch(OFFBOARD)

    def _stream_is_back(self) -> bool:
        return self.streaming and self.time_s - self._stream.since_s >= STREAM_BACK_AFTER_S

    def _vision_is_back(self, vision: ExternalVision) -> bool:
        """Whether it landed because vision was lost, and has had it again for long enough."""
        landed_for_it = self.failsafe and self.mode is Px4Mode.LAND and self.intended_mode in NEED_A_POSITION
        if not landed_for_it or not self.has_position or not self.has_origin:
            return False
        return not self.position_lost_s and self.time_s - vision.back_s >= RETURNS_AFTER_S

    def _ground_station_is_newly_lost(self) -> bool:
        lost = self.ground_station_lost and int(self.parameters["NAV_DLL_ACT"]) in self.data.ground_station_lost
        newly = lost and not self._ground_station_loss_known and self.mode is not Px4Mode.LAND
        self._ground_station_loss_known = lost
        return newly

    def _go_on_without_ground_station(self, since_s: float) -> None:
        """Latched: only a mode change ends it, neither the ground station's return nor a setpoint stream."""
        if self.mode is Px4Mode.LOITER and self.time_s - since_s >= self.parameters["COM_FAIL_ACT_T"]:
            self._fly_failsafe(self.data.ground_station_lost.get(int(self.parameters["NAV_DLL_ACT"]), "LOITER"))

    def _activate_failsafe(self, mode: str | None, how: str = "") -> None:
        self.failsafe = True
        self.send_text(CRITICAL, f"Failsafe activated{how}")
        self._fly_failsafe(mode)

    def _fly_failsafe(self, mode: str | None) -> None:
        if mode is None:
            self.disarm(forced=True, reason="failsafe")
        else:
            refused = Px4Mode[mode] in NEED_AN_ORIGIN and not self.has_origin
            self._switch(Px4Mode.LAND if refused else Px4Mode[mode])

    # ------------------------------------------------------------ ground and modes

    def _update_ground_contact(self) -> None:
        if self._ground.flies and not self.quad.on_ground:
            return  # no change
        before = self._ground.landed
        self._ground.update(self.quad.on_ground, self._thrust_is_low(), self.time_s)
        if self._ground.landed is not before:
            self.send_text(INFO, "Landing detected" if self._ground.landed else "Takeoff detected")
        idle_s = self._ground.idle_s(self.time_s)
        if self._ground.flown and idle_s > self.parameters["COM_DISARM_LAND"] > 0:
            self.disarm(forced=True, reason="landing")
        elif not self._ground.flown and idle_s > self.parameters["COM_DISARM_PRFLT"] > 0:
            self.disarm(forced=True, reason="auto preflight disarming")

    def _enter_pilot_mode(self) -> None:
        self.intended_mode, self.failsafe, self._ground_station_failsafe_s = Px4Mode.POSCTL, False, None
        self._switch(Px4Mode.POSCTL)

    def _switch(self, mode: Px4Mode) -> None:
        if mode is not self.mode:
            self.mode = mode
            self._enter(mode)

    def _enter(self, mode: Px4Mode) -> None:
        if mode is Px4Mode.TAKEOFF and self.armed and not self.has_origin:
            self.takeoff_altitude_amsl_m = None  # it has no altitude
            self.send_text(INFO, f"Using default takeoff altitude: {self.parameters['MIS_TAKEOFF_ALT']:.1f} m")
        home = self.return_place() if mode is Px4Mode.RTL else self.home
        self._automatic.enter(mode.task, home, self.takeoff_altitude_amsl_m)
