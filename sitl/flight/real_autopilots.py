"""Real autopilots in their own simulations, PX4 in SIH and ArduCopter in SITL: where they are and how one is started.

`REAL` has what differs between the two types. Ports are those of their defaults, so a ground station finds them.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from companion.config.file import ConfigError
from companion.geometry.frames import geodetic_from_enu
from companion.types.autopilot import AutopilotKind
from companion.types.values import Vector3
from sitl.autopilots.types import AUTOPILOT_TYPES
from sitl.flight.external import ReachedVehicle
from sitl.flight.files import ids_of
from sitl.flight.scenario import Scenario
from sitl.links.ports import LOOPBACK, Ports, ports_of

PX4_AIRFRAME = "sihsim_quadx"
RC_PORT = 5501  # ArduCopter's, for a simulated remote control
# Links of PX4, in the place of its own script of this name: those of agent and ground station as it has them, at our ports, and
# the true positions 50 times a second.
PX4_LINKS = "px4-rc.mavlink"
PX4_LINKS_TEXT = """\
mavlink start -x -u {ports.ground_link} -r 4000000 -f
mavlink start -x -u {ports.onboard} -r 4000000 -f -m onboard -o {ports.companion}
mavlink start -x -u {own} -r 400000 -m custom -o {ports.true_position}
mavlink stream -r 50 -s HIL_STATE_QUATERNION -u {own}
"""


@dataclass(frozen=True, slots=True)
class Started:
    """One autopilot to be started: its program, the folder for its files, its place and its parameters."""

    program: Path
    folder: Path
    vehicle_id: int
    place_deg_deg_m: Vector3
    parameters: Mapping[str, float]
    port_offset: int

    @property
    def ports(self) -> Ports:
        return ports_of(self.vehicle_id, self.port_offset)


@dataclass(frozen=True, slots=True)
class Launch:
    """A command line, what it adds to the environment, and files for its folder by name."""

    command: Sequence[str]
    environment: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class RealAutopilot:
    """What is to be known of one type.

    places: where it is built, below the home folder, and installed, with wildcards
    needs: a file without which it does not start, from the folder of the program
    parameters: besides those that `companion doctor` sets
    vision_parameters: further ones for a vehicle that flies by external vision, besides those of the stand-in
    apart_s: pause between two starts. SIH begins its random numbers with the same seed: without pauses all err alike
    """

    name: str
    program: str
    places: tuple[str, ...]
    get_it: str
    needs: str
    hover_thrust_norm: float
    drag_1_s: float
    endpoint: Callable[[Ports], str]
    true_endpoint: Callable[[Ports], str]
    parameters: Mapping[str, float]
    vision_parameters: Mapping[str, float] = field(default_factory=dict)
    apart_s: float
    launch: Callable[[Started], Launch]


def _px4(one: Started) -> Launch:
    latitude_deg, longitude_deg, altitude_m = one.place_deg_deg_m
    environment = (
        {
            "PX4_SIM_MODEL": PX4_AIRFRAME,
            "PX4_HOME_LAT": f"{latitude_deg:.7f}",
            "PX4_HOME_LON": f"{longitude_deg:.7f}",
            "PX4_HOME_ALT": f"{altitude_m:.2f}",
            "PATH": f"{one.folder}{os.pathsep}{os.environ.get('PATH', os.defpath)}",  # its start script finds PX4_LINKS there
        }
        | {f"PX4_PARAM_{name}": f"{value:g}" for name, value in one.parameters.items()}
    )
    program = one.program.resolve()  # an installed one is a link to the folder that has its scripts
    command = [str(program), "-i", str(one.vehicle_id - 1), "-d", str(program.parent.parent / "etc")]
    links = PX4_LINKS_TEXT.format(ports=one.ports, own=one.ports.true_source)
    return Launch(command, environment, {PX4_LINKS: links})


# What SITL needs in the place of a calibration: of its two inertial sensors, and of its three compasses; and its motors.
ARDUCOPTER = (
    {"FRAME_CLASS": 1, "FRAME_TYPE": 0, "MOT_THST_HOVER": 0.365, "MOT_BAT_VOLT_MIN": 9.6, "MOT_BAT_VOLT_MAX": 12.8}
    | {f"INS_ACC{n}OFFS_{axis}": 0.001 for n in ("", "2") for axis in "XYZ"}
    | {f"INS_ACC{n}SCAL_{axis}": 1.001 for n in ("", "2") for axis in "XYZ"}
    | {f"COMPASS_OFS{n}_{axis}": value for n in ("", "2", "3") for axis, value in (("X", 5), ("Y", 13), ("Z", -18))}
)


def _arducopter(one: Started) -> Launch:
    latitude_deg, longitude_deg, altitude_m = one.place_deg_deg_m
    instance = one.vehicle_id - 1
    command = [
        *(str(one.program.resolve()), "--model", "quad", "--instance", str(instance), "--sysid", str(one.vehicle_id)),
        *("--home", f"{latitude_deg:.7f},{longitude_deg:.7f},{altitude_m:.2f},0"),
        *("--base-port", str(one.ports.tcp), "--serial0", "tcp:0"),
        *("--rc-in-port", str(RC_PORT + 10 * instance + one.port_offset)),
        *("--defaults", "formation.parm"),
    ]
    lines = [f"{name} {value:g}\n" for name, value in one.parameters.items()]
    return Launch(command, files={"formation.parm": "".join(lines)})


REAL: dict[AutopilotKind, RealAutopilot] = {
    AutopilotKind.PX4: RealAutopilot(
        name="PX4",
        program="px4",
        places=("PX4-Autopilot/build/px4_sitl_*/bin/px4", "/opt/px4/bin/px4"),
        get_it="or install a pre-built package, docs.px4.io/main/en/simulation/px4_sitl_prebuilt_packages, or build it:"
        " make px4_sitl",
        needs="../etc/init.d-posix/rcS",
        hover_thrust_norm=0.5,
        drag_1_s=1.0,
        endpoint=lambda ports: f"udpin:{LOOPBACK}:{ports.companion}",
        true_endpoint=lambda ports: f"udpin:{LOOPBACK}:{ports.true_position}",
        # SIH's sensors are noisier than EKF2 assumes: with the defaults its estimates err by twice as much
        parameters={
            "EKF2_ACC_NOISE": 1.0,
            "EKF2_GYR_NOISE": 0.08,
            "EKF2_GPS_P_NOISE": 0.25,
            "EKF2_GPS_V_NOISE": 0.1,
        },
        # no GPS whose delay of 0.11 s must be bridged with noisy accelerations: velocity errs by 0.08 in place of 0.12 m/s
        vision_parameters={
            "EKF2_EVP_NOISE": 0.01,
            "EKF2_EVA_NOISE": 0.05,
            "EKF2_DELAY_MAX": 50.0,
            "EKF2_TAU_POS": 0.1,
            "EKF2_TAU_VEL": 0.1,
        },
        apart_s=10.1,
        launch=_px4,
    ),
    AutopilotKind.ARDUPILOT: RealAutopilot(
        name="ArduCopter",
        program="arducopter",
        places=("ardupilot/build/sitl/bin/arducopter",),
        get_it="or build it: ardupilot.org/dev/docs/building-setup-linux.html, ./waf configure --board sitl && ./waf copter",
        needs="",
        hover_thrust_norm=0.365,
        drag_1_s=0.25,
        endpoint=lambda ports: f"tcp:{LOOPBACK}:{ports.tcp_agent}",
        true_endpoint=lambda ports: f"tcp:{LOOPBACK}:{ports.tcp_true_position}",
        parameters=ARDUCOPTER,
        apart_s=0.0,
        launch=_arducopter,
    ),
}
LONGER_S = 0.6  # each pause is longer than the one before, so that no two vehicles err alike, one later than the other


def kinds_of_vehicles(scenario: Scenario, default: AutopilotKind) -> dict[int, AutopilotKind]:
    """By id: the type that the scenario names for a single vehicle, else `default`."""
    own = scenario.stand_in.vehicles
    return {i: AutopilotKind(own.get(i, {}).get("autopilot", default)) for i in ids_of(scenario)}


def find_program(kind: AutopilotKind, given: Sequence[Path]) -> Path:
    """The one of these that has its name, else the installed or built one. Raises ConfigError."""
    real = REAL[kind]
    installed = shutil.which(real.program)
    built = (path for place in real.places for path in sorted(Path("/").glob(str(Path.home() / place)[1:])))
    found = [path for path in given if path.name.startswith(real.program)] or (
        [Path(installed)] if installed else built
    )
    if (program := next(iter(found), None)) is None:
        problem = f"no {real.program} in PATH or built in the home folder; give its place with --binary, {real.get_it}"
        raise ConfigError("--external", "", problem)
    if problem := _unusable(program, real):
        raise ConfigError("--binary" if program in given else "--external", "", f"{program} {problem}")
    return program


def _unusable(path: Path, real: RealAutopilot) -> str:
    """Why the file cannot be started, and what to do; "" where it can be tried."""
    if not path.is_file():
        return f"is no file; give the path of {real.name}'s program"
    if not os.access(path, os.X_OK):
        return f"cannot be executed; is it {real.name}'s program? If so: chmod +x {path}"
    if not (path.resolve().parent / real.needs).exists():
        return f"has no {real.needs} from its folder; give the program where {real.name} was built or installed"
    return ""


def _check_given(given: Sequence[Path], kinds: Collection[AutopilotKind]) -> None:
    """Each of the given programs must be one that the fleet uses. Raises ConfigError."""
    names = [REAL[kind].program for kind in sorted(kinds)]
    for path in given:
        if not path.name.startswith(tuple(names)):
            raise ConfigError("--binary", "", f"{path}: expected a file whose name begins with {' or '.join(names)}")


@dataclass(frozen=True, slots=True)
class RealFleet:
    """The real autopilots of one scenario."""

    scenario: Scenario
    kinds: Mapping[int, AutopilotKind]
    programs: Mapping[AutopilotKind, Path]

    @classmethod
    def of(cls, scenario: Scenario, default: AutopilotKind, given: Sequence[Path]) -> RealFleet:
        """Raises ConfigError where a program is missing."""
        kinds = kinds_of_vehicles(scenario, default)
        _check_given(given, set(kinds.values()))
        return cls(scenario, kinds, {kind: find_program(kind, given) for kind in sorted(set(kinds.values()))})

    def reached(self, port_offset: int) -> dict[int, ReachedVehicle]:
        """How the agents reach them, by id."""
        return {
            i: ReachedVehicle(
                id=i,
                mavlink=REAL[kind].endpoint(ports_of(i, port_offset)),
                autopilot=kind,
                hover_thrust_norm=REAL[kind].hover_thrust_norm,
                drag_1_s=REAL[kind].drag_1_s,
            )
            for i, kind in self.kinds.items()
        }

    def started(self, vehicle_id: int, folder: Path, port_offset: int) -> Started:
        """One of them. A scenario's `stand_in.parameters` are those of an autopilot of the same type."""
        kind, stand_in, origin = (
            self.kinds[vehicle_id],
            self.scenario.stand_in_of(vehicle_id),
            self.scenario.fleet.place,
        )
        assert origin is not None  # scenario_from accepts no other
        own = stand_in.parameters if stand_in.autopilot is kind else {}
        real, data = REAL[kind], AUTOPILOT_TYPES[kind].data
        by_vision = stand_in.positioning == "external_vision"
        vision = {**real.vision_parameters, **data.external_vision.parameters} if by_vision else {}
        parameters = {**real.parameters, **data.set_up, **vision, **own}
        place = geodetic_from_enu(self.scenario.starts_enu_m[vehicle_id], origin.as_tuple())
        return Started(self.programs[kind], folder, vehicle_id, place, parameters, port_offset)

    def pauses_s(self) -> dict[int, float]:
        """Time to wait before each is started."""
        before: dict[AutopilotKind, int] = {}
        pauses_s = {}
        for vehicle_id, kind in self.kinds.items():
            number, apart_s = before.get(kind, 0), REAL[kind].apart_s
            pauses_s[vehicle_id] = apart_s + LONGER_S * (number - 1) if number and apart_s else 0.0
            before[kind] = number + 1
        return pauses_s
