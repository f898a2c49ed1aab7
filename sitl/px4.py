"""The stand-in autopilot with PX4's manners (v1.16), as they were measured: modes, arming, failsafes. No sockets, no clocks.

`step` advances virtual time; messages come in through `sitl.px4_commands` and go out through the links' schedules.
"""

from __future__ import annotations

from enum import Enum

from companion.frames import enu_from_geodetic, euler_from_quaternion, geodetic_from_enu
from companion.types import Vector3
from sitl.attitude_control import Setpoint
from sitl.config import AutopilotFile
from sitl.position_control import PositionControl
from sitl.px4_messages import LANDED_IN_AIR, LANDED_LANDING, LANDED_ON_GROUND, LANDED_TAKEOFF
from sitl.px4_parameters import Parameters
from sitl.quadrotor import MOTORS_OFF, Quadrotor

ARMABLE_AFTER_S = 4.0
IDLE_THRUST_NORM = 0.08
FAILSAFE_SINK_M_S = 0.85  # POSCTL without a pilot: sinks and drifts
GROUND_STATION_LOST_S = 5.0  # COM_DL_LOSS_T
HOLD_BEFORE_RETURN_S = 5.0  # COM_FAIL_ACT_T
STATE_STANDBY, STATE_ACTIVE, STATE_CRITICAL = 3, 4, 5  # MAV_STATE


class Mode(Enum):
    """PX4's flight modes by (main, sub) of custom_mode."""

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
        main, sub = self.value
        return int(main << 16 | sub << 24)


class Px4:
    """One vehicle. `dt_s` is the step of physics and control alike."""

    def __init__(self, file: AutopilotFile, dt_s: float) -> None:
        self.system_id = file.id
        self.dt_s = dt_s
        self.quad = Quadrotor(file, dt_s)
        self.parameters = Parameters(file.id, file.stand_in.parameters)
        self.time_s = 0.0
        self.mode = Mode.LOITER
        self.intended_mode = Mode.LOITER
        self.armed = False
        self.failsafe = False
        self.home: Vector3 = self._here_geodetic()
        self.setpoint = MOTORS_OFF
        self.takeoff_altitude_amsl_m: float | None = None
        self.texts: list[tuple[int, str]] = []  # (severity, text), taken by whoever sends them
        self.ground_station_s: float | None = None  # when its last heartbeat came
        self._hover_thrust_norm = file.stand_in.airframe.hover_thrust_norm
        self._control = PositionControl(self._hover_thrust_norm)
        self._offboard: Setpoint | None = None
        self._offboard_s = float("-inf")
        self._armed_s = 0.0
        self._flown = False
        self._landed_s: float | None = None
        self._return_s: float | None = None
        self._hold_here()

    # ------------------------------------------------------------ what it is like now

    @property
    def boot_ms(self) -> int:
        return round(self.time_s * 1000.0)

    @property
    def armable(self) -> bool:
        return self.time_s >= ARMABLE_AFTER_S

    @property
    def system_status(self) -> int:
        if self.failsafe:
            return STATE_CRITICAL
        return STATE_ACTIVE if self.armed else STATE_STANDBY

    @property
    def landed_state(self) -> int:
        if not self.armed or not self._flown:
            return LANDED_ON_GROUND
        if self.mode is Mode.TAKEOFF:
            return LANDED_TAKEOFF
        if self.mode is Mode.LAND and not self.quad.stands:
            return LANDED_LANDING
        return LANDED_ON_GROUND if self._landed_s is not None else LANDED_IN_AIR

    @property
    def streaming(self) -> bool:
        """Do setpoints come often enough? COM_OF_LOSS_T is the longest gap."""
        return self.time_s - self._offboard_s <= self.parameters["COM_OF_LOSS_T"]

    def wanted_euler_rad(self) -> Vector3:
        """Of the attitude setpoint just now, FLU in ENU."""
        return euler_from_quaternion(self.setpoint.quaternion)

    # ------------------------------------------------------------ what can be asked of it

    def offboard_setpoint(self, setpoint: Setpoint) -> None:
        self._offboard = setpoint
        self._offboard_s = self.time_s

    def say(self, severity: int, text: str) -> None:
        self.texts.append((severity, text))

    def set_mode(self, mode: Mode) -> bool:
        """A mode change on request. OFFBOARD is refused while armed without a stream."""
        if mode is Mode.OFFBOARD and self.armed and not self.streaming:
            return False
        self.intended_mode = mode
        self.failsafe = False
        self._return_s = None
        self._switch(mode)
        return True

    def arm(self) -> str | None:
        """Why not, or None."""
        if self.armed:
            return None
        if not self.armable:
            return "Resolve system health failures first"
        if self.mode is Mode.OFFBOARD and not self.streaming:
            return "Offboard control signal lost"
        if self.mode in (Mode.LAND, Mode.RTL, Mode.MISSION):
            return "Mode not suitable for takeoff"
        self.armed = True
        self._armed_s = self.time_s
        self._flown = False
        self._landed_s = None
        self.home = self._here_geodetic()
        self._hold_here()
        if self.mode is Mode.TAKEOFF:
            self._start_takeoff()
        return None

    def disarm(self, forced: bool) -> str | None:
        """Why not, or None."""
        if self.armed and not forced and self.landed_state != LANDED_ON_GROUND:
            return "not landed"
        self.armed = False
        self.failsafe = False
        return None

    # ------------------------------------------------------------ time

    def step(self) -> None:
        """Advance by dt_s: failsafes, the mode's control, physics, and what follows from touching the ground."""
        self.time_s += self.dt_s
        self._watch_stream()
        self._watch_ground_station()
        self.setpoint = self._control_setpoint() if self.armed else MOTORS_OFF
        self.quad.step(self.setpoint)
        self._watch_ground()

    def _watch_stream(self) -> None:
        if not self.armed:
            return
        if self.mode is Mode.OFFBOARD and not self.streaming:
            self.failsafe = True
            self.say(2, "Failsafe activated")
            self._switch({4: Mode.LAND, 5: Mode.LOITER}.get(int(self.parameters["COM_OBL_RC_ACT"]), Mode.POSCTL))
        elif self.intended_mode is Mode.OFFBOARD and self.mode is not Mode.OFFBOARD and self.streaming:
            # PX4 goes back into OFFBOARD by itself as soon as setpoints come again.
            self.failsafe = False
            self._switch(Mode.OFFBOARD)

    def _watch_ground_station(self) -> None:
        if self.parameters["NAV_DLL_ACT"] != 2 or self.ground_station_s is None or not self.armed:
            return
        lost = self.time_s - self.ground_station_s > GROUND_STATION_LOST_S
        if lost and self._return_s is None and self._flown:
            self._return_s = self.time_s + HOLD_BEFORE_RETURN_S
            self.failsafe = True
            self.intended_mode = Mode.LOITER
            self.say(2, "Failsafe activated")
            self._switch(Mode.LOITER)
        elif self._return_s is not None and self.time_s >= self._return_s and self.mode is Mode.LOITER:
            self.intended_mode = Mode.RTL
            self._switch(Mode.RTL)

    def _watch_ground(self) -> None:
        if not self.armed:
            return
        if not self.quad.stands:
            self._flown, self._landed_s = True, None
            return
        if not self._flown:
            if self.time_s - self._armed_s > self.parameters["COM_DISARM_PRFLT"] > 0:
                self.disarm(forced=True)
            return
        if self._landed_s is None:
            self._landed_s = self.time_s
        wants_down = self.setpoint.thrust_norm < 0.6 * self._hover_thrust_norm or self.mode is Mode.LAND
        if wants_down and self.time_s - self._landed_s > self.parameters["COM_DISARM_LAND"] > 0:
            self.disarm(forced=True)

    # ------------------------------------------------------------ flying by itself

    def _control_setpoint(self) -> Setpoint:
        if self.mode is Mode.OFFBOARD and self._offboard:
            return self._offboard
        if self.quad.stands and not self._flown and self.mode is not Mode.TAKEOFF:
            return Setpoint(self.quad.quaternion, IDLE_THRUST_NORM)
        position = self.quad.estimated_position_local_enu_m()
        if self.mode is Mode.TAKEOFF and self._control.arrived(position, 0.1):
            self.intended_mode = Mode.LOITER
            self._switch(Mode.LOITER)
        if self.mode is Mode.RTL and self._control.arrived(position, 0.5):
            self._switch(Mode.LAND)
        if self.mode in (Mode.LAND, Mode.POSCTL):
            self._sink(position)
        return self._control.setpoint(
            position, self.quad.estimated_velocity_enu_m_s(), self.quad.estimated_euler_rad(), self.dt_s
        )

    def _sink(self, position: Vector3) -> None:
        """Down where it is: landing, or POSCTL that nobody flies."""
        x, y, _ = self._control.goal
        self._control.goal = (x, y, position[2] - 2.0)

    def _switch(self, mode: Mode) -> None:
        if mode is self.mode:
            return
        came_from, self.mode = self.mode, mode
        if mode is Mode.OFFBOARD or (mode is Mode.LOITER and came_from is Mode.TAKEOFF):
            return  # after the climb it holds the height that was asked for, not where it happens to be
        self._hold_here()
        if mode is Mode.TAKEOFF:
            self._start_takeoff()
        elif mode is Mode.LAND:
            self._control.climb_speed_m_s = self.parameters["MPC_LAND_SPEED"]
        elif mode is Mode.POSCTL:
            self._control.climb_speed_m_s = FAILSAFE_SINK_M_S
        elif mode is Mode.RTL:
            self._start_return()

    def _hold_here(self) -> None:
        position = self.quad.estimated_position_local_enu_m()
        self._control.start(position, self.quad.estimated_euler_rad()[2])

    def _start_takeoff(self) -> None:
        x, y, z = self._control.goal
        wanted = self.takeoff_altitude_amsl_m
        top = z + self.parameters["MIS_TAKEOFF_ALT"] if wanted is None else wanted - self.quad.origin[2]
        self._control.climb_speed_m_s = self.parameters["MPC_TKO_SPEED"]
        self._control.goal = (x, y, max(top, z))

    def _start_return(self) -> None:
        """Straight home at the present height: the stand-in's fields are small."""
        x, y, _ = enu_from_geodetic(*self.home, self.quad.origin)
        self._control.goal = (x, y, self._control.goal[2])

    def _here_geodetic(self) -> Vector3:
        return geodetic_from_enu(self.quad.estimated_position_local_enu_m(), self.quad.origin)
