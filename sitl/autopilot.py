"""What every stand-in autopilot is, whatever its manners: a body, a clock, parameters and a home. No sockets, no clocks.

`step` advances virtual time. What comes in and goes out is the business of `sitl.link_end`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Protocol

from companion.frames import enu_from_geodetic, euler_from_quaternion, geodetic_from_enu
from companion.types import AutopilotKind, Vector3
from sitl.attitude_control import Loops, Setpoint
from sitl.config import AutopilotFile
from sitl.flight_logs import FlightLogs
from sitl.ground_contact import GroundContact
from sitl.own_flight import OwnFlight, Speeds
from sitl.parameters import Parameters
from sitl.quadrotor import MOTORS_OFF, Quadrotor

DT_S = 0.004  # physics and attitude control at 250 Hz
CONTROL_PERIOD_S = 0.02  # of its own position control, and of looking after setpoint streams
IDLE_THRUST_NORM = 0.08
LITTLE_THRUST = 0.6  # of hover thrust
FULL_BATTERY_PERCENT = 98
CRITICAL, ERROR, WARNING, INFO = 2, 3, 4, 6  # MAV_SEVERITY


class AutopilotAbortedError(Exception):
    """The real program would have ended itself here; str() says over what."""


class FlightMode(Protocol):
    """A mode of any autopilot."""

    @property
    def name(self) -> str: ...

    @property
    def custom_mode(self) -> int:
        """As HEARTBEAT carries it."""


class Autopilot(ABC):
    """One vehicle. `dt_s` is the step of physics and attitude control."""

    kind: ClassVar[AutopilotKind]
    flight_logs: FlightLogs

    def __init__(
        self, file: AutopilotFile, dt_s: float, loops: Loops, parameters: Parameters, braking_m_s2: float
    ) -> None:
        self.system_id = file.id
        self.dt_s = dt_s
        self.quad = Quadrotor(file, loops, dt_s)
        self.parameters = parameters
        self.time_s = 0.0
        self.armed = False
        self.home: Vector3 = self.here_geodetic()
        self.setpoint = MOTORS_OFF
        self.texts: list[tuple[int, str]] = []  # (severity, text), taken by whoever sends them
        self.ground_station_s: float | None = None  # when its last heartbeat came
        self.origin_changes = 0
        self._steps = 0
        self._control_steps = max(1, round(CONTROL_PERIOD_S / dt_s))
        self._own = OwnFlight(self.quad, self.speeds, file.stand_in.hover_thrust_norm, braking_m_s2)
        self._ground = GroundContact()
        self._resets = sorted(
            (reset for reset in file.stand_in.estimator_resets if reset.vehicle == file.id),
            key=lambda reset: reset.at_s,
        )
        self._batteries = sorted(
            (level for level in file.stand_in.batteries if level.vehicle == file.id), key=lambda level: level.at_s
        )

    # ------------------------------------------------------------ what it is like now

    @property
    @abstractmethod
    def flight_mode(self) -> FlightMode: ...

    @property
    @abstractmethod
    def armable(self) -> bool:
        """May it be armed in the mode that it is in?"""

    @property
    @abstractmethod
    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""

    @abstractmethod
    def speeds(self) -> Speeds:
        """Of its own flight, out of its parameters."""

    @property
    def has_position(self) -> bool:
        """Does its estimator know yet where it is?"""
        return True

    @property
    def battery_percent(self) -> int:
        """As it tells it, -1 where it does not know."""
        told = [level.percent for level in self._batteries if level.at_s <= self.time_s]
        return told[-1] if told else FULL_BATTERY_PERCENT

    @property
    def _control_dt_s(self) -> float:
        return self._control_steps * self.dt_s

    @property
    def boot_ms(self) -> int:
        return round(self.time_s * 1000.0)

    def wanted_euler_rad(self) -> Vector3:
        """Of the attitude setpoint just now, FLU in ENU."""
        return euler_from_quaternion(self.setpoint.quaternion)

    def here_geodetic(self) -> Vector3:
        """Degrees and metres above sea level, by its estimate."""
        return geodetic_from_enu(self.quad.estimated_position_local_enu_m(), self.quad.origin)

    # ------------------------------------------------------------ what can be asked of it

    @abstractmethod
    def take_setpoint(self, setpoint: Setpoint) -> None:
        """An attitude and a thrust that came from outside."""

    def say(self, severity: int, text: str) -> None:
        self.texts.append((severity, text))

    def set_origin(self, origin_deg_deg_m: Vector3) -> None:
        """The local frame begins there at once; nothing moves in the world."""
        before = self.quad.origin
        self.quad.set_origin(origin_deg_deg_m)
        self._own.origin_moved(enu_from_geodetic(*before, self.quad.origin))
        self.origin_changes += 1

    def reset_estimator(self, shift_enu_m: Vector3) -> None:
        """The estimate jumps, and its own flight with it: nothing moves in the world."""
        self.quad.shift_estimate(shift_enu_m)
        self._own.origin_moved(shift_enu_m)

    # ------------------------------------------------------------ time

    def step(self) -> None:
        """Advance by dt_s: failsafes, the mode's control, physics, and what follows from touching the ground."""
        self._steps += 1
        self.time_s = self._steps * self.dt_s
        while self._resets and self._resets[0].at_s <= self.time_s:
            self.reset_estimator(self._resets.pop(0).shift_enu_m)
        control_is_due = self._steps % self._control_steps == 0
        if control_is_due:
            self._look_after()
        if self.armed:
            self._control(control_is_due)
        else:
            self.setpoint = MOTORS_OFF
        self.quad.step(self.setpoint)
        if self.armed:
            self._watch_ground()

    @abstractmethod
    def _look_after(self) -> None:
        """Streams and failsafes, every CONTROL_PERIOD_S."""

    @abstractmethod
    def _control(self, control_is_due: bool) -> None:
        """Decide on the setpoint of this step of an armed vehicle."""

    @abstractmethod
    def _watch_ground(self) -> None:
        """What follows from taking off, landing and standing."""

    def _thrust_is_little(self) -> bool:
        return self.setpoint.thrust_norm <= LITTLE_THRUST * self._own.hover_thrust_norm
