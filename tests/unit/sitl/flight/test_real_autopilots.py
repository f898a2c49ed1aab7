"""Real autopilots: which one flies which vehicle, where its program is, how it is started, and where it is reached."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from common import ROOT
from companion.config.file import ConfigError
from companion.types.autopilot import AutopilotKind
from sitl.flight.real_autopilots import REAL, RealFleet, find_program, kinds_of_vehicles
from sitl.flight.real_start import true_positions_of
from sitl.flight.scenario import Scenario, load_scenario

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
SCENARIOS = ROOT / "config" / "scenarios"


def program(folder: Path, name: str) -> Path:
    path = folder / "bin" / name
    path.parent.mkdir(exist_ok=True)
    path.touch(mode=0o755)
    (folder / "etc" / "init.d-posix").mkdir(parents=True, exist_ok=True)
    (folder / "etc" / "init.d-posix" / "rcS").touch()  # which PX4 needs
    return path


@pytest.fixture
def programs(tmp_path: Path) -> list[Path]:
    return [program(tmp_path, "px4"), program(tmp_path, "arducopter")]


def scenario(name: str, *overrides: str) -> Scenario:
    return load_scenario(SCENARIOS / f"{name}.yaml", overrides)


def test_a_scenario_may_name_the_autopilot_of_single_vehicles() -> None:
    assert kinds_of_vehicles(scenario("mixed_platoon"), PX4) == {1: PX4, 2: PX4, 3: ARDUPILOT, 4: ARDUPILOT}
    assert kinds_of_vehicles(scenario("mixed_platoon"), ARDUPILOT) == dict.fromkeys((1, 2, 3, 4), ARDUPILOT)
    assert kinds_of_vehicles(scenario("platoon"), ARDUPILOT) == dict.fromkeys((1, 2, 3, 4), ARDUPILOT)


def test_px4_is_started_at_its_place_with_its_parameters_and_links(tmp_path: Path, programs: list[Path]) -> None:
    fleet = RealFleet.of(scenario("exchange", "stand_in.parameters.RTL_RETURN_ALT=12"), PX4, programs[:1])
    launch = REAL[PX4].launch(fleet.started(3, tmp_path, port_offset=100))
    assert launch.command == [str(programs[0]), "-i", "2", "-d", str(tmp_path / "etc")]
    environment = dict(launch.environment)
    assert environment.pop("PATH").startswith(f"{tmp_path}:/")  # where PX4's start script finds the file below
    assert environment == {
        "PX4_SIM_MODEL": "sihsim_quadx",
        "PX4_HOME_LAT": "47.3977150",  # 3 m south of the origin: a longitude alone is not enough
        "PX4_HOME_LON": "8.5455543",
        "PX4_HOME_ALT": "488.00",
        "PX4_PARAM_EKF2_ACC_NOISE": "1",
        "PX4_PARAM_EKF2_GYR_NOISE": "0.08",
        "PX4_PARAM_EKF2_GPS_P_NOISE": "0.25",
        "PX4_PARAM_EKF2_GPS_V_NOISE": "0.1",
        "PX4_PARAM_COM_OBL_RC_ACT": "5",
        "PX4_PARAM_RTL_RETURN_ALT": "12",
    }
    assert launch.files["px4-rc.mavlink"].splitlines() == [
        "mavlink start -x -u 18672 -r 4000000 -f",
        "mavlink start -x -u 14682 -r 4000000 -f -m onboard -o 14642",
        "mavlink start -x -u 19552 -r 400000 -m custom -o 19512",
        "mavlink stream -r 50 -s HIL_STATE_QUATERNION -u 19552",
    ]


def test_an_installed_px4_has_its_scripts_beside_the_file_that_its_name_links_to(tmp_path: Path) -> None:
    real, link = program(tmp_path, "px4"), tmp_path / "elsewhere" / "px4"
    link.parent.mkdir()
    link.symlink_to(real)
    launch = REAL[PX4].launch(RealFleet.of(scenario("exchange"), PX4, [link]).started(1, tmp_path, 0))
    assert launch.command[0] == str(real) and launch.command[-1] == str(tmp_path / "etc")


def test_arducopter_is_started_at_its_place_with_its_parameters_and_ports(tmp_path: Path, programs: list[Path]) -> None:
    fleet = RealFleet.of(scenario("exchange"), ARDUPILOT, programs[1:])
    launch = REAL[ARDUPILOT].launch(fleet.started(2, tmp_path, port_offset=100))
    assert " ".join(launch.command) == (
        f"{programs[1]} --model quad --instance 1 --sysid 2 --home 47.3977150,8.5455940,488.00,0"
        " --base-port 5870 --serial0 tcp:0 --rc-in-port 5611 --defaults formation.parm"
    )
    parameters = launch.files["formation.parm"].splitlines()
    assert {"GUID_OPTIONS 8", "GUID_TIMEOUT 1", "FRAME_CLASS 1", "INS_ACCOFFS_X 0.001"} <= set(parameters)


def test_agents_and_true_positions_have_links_of_their_own(programs: list[Path]) -> None:
    fleet = RealFleet.of(scenario("mixed_platoon"), PX4, programs)
    reached, true = fleet.reached(0), true_positions_of(fleet, 0)
    assert [reached[i].mavlink for i in (1, 2, 3, 4)] == [
        "udpin:127.0.0.1:14540", "udpin:127.0.0.1:14541", "tcp:127.0.0.1:5782", "tcp:127.0.0.1:5792"
    ]  # fmt: skip
    assert [one.endpoint for one in true.vehicles] == [
        "udpin:127.0.0.1:19410", "udpin:127.0.0.1:19411", "tcp:127.0.0.1:5783", "tcp:127.0.0.1:5793"
    ]  # fmt: skip
    assert [(reached[i].autopilot, reached[i].drag_1_s) for i in (1, 4)] == [(PX4, 1.0), (ARDUPILOT, 0.25)]


def test_px4s_are_started_apart_by_ever_longer_pauses(programs: list[Path]) -> None:
    pauses_s = RealFleet.of(scenario("platoon"), PX4, programs[:1]).pauses_s()
    assert [pauses_s[i] for i in (1, 2, 3, 4)] == pytest.approx([0.0, 10.1, 10.7, 11.3])
    mixed = RealFleet.of(scenario("mixed_platoon"), PX4, programs).pauses_s()
    assert [mixed[i] for i in (1, 2, 3, 4)] == pytest.approx([0.0, 10.1, 0.0, 0.0])


def test_a_program_is_looked_for_where_it_is_given_then_in_path_then_where_it_is_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = tmp_path / "home"
    (home / "PX4-Autopilot" / "build" / "px4_sitl_sih").mkdir(parents=True)
    built = program(home / "PX4-Autopilot" / "build" / "px4_sitl_sih", "px4")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("PATH", "/nowhere")
    assert find_program(PX4, []) == built
    installed = program(tmp_path, "px4")
    monkeypatch.setattr(shutil, "which", lambda name: str(installed.with_name(name)))
    assert find_program(PX4, []) == installed
    given = program(tmp_path, "px4-1.16")
    assert find_program(PX4, [program(tmp_path, "arducopter"), given]) == given


def test_a_missing_program_is_one_line_that_says_where_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(ConfigError) as caught:
        RealFleet.of(scenario("platoon"), PX4, [])
    (line,) = caught.value.lines
    assert line.startswith("--external: no px4 in PATH or built in the home folder; give its place with --binary")
    assert "docs.px4.io/main/en/simulation/px4_sitl_prebuilt_packages" in line
    with pytest.raises(ConfigError, match=r"--external: no arducopter .*\./waf copter"):
        RealFleet.of(scenario("platoon"), ARDUPILOT, [])


def test_a_wrong_binary_is_refused(tmp_path: Path, programs: list[Path]) -> None:
    with pytest.raises(ConfigError, match=r"^--binary: .*/px4_gone is no file; give the path of PX4's program$"):
        RealFleet.of(scenario("platoon"), PX4, [tmp_path / "px4_gone"])
    with pytest.raises(ConfigError, match=r"^--binary: .*/arducopter: expected a file whose name begins with px4$"):
        RealFleet.of(scenario("platoon"), PX4, programs)
    programs[1].chmod(0o644)
    with pytest.raises(
        ConfigError, match=r"^--binary: (.*)/arducopter cannot be executed; .* chmod \+x \1/arducopter$"
    ):
        RealFleet.of(scenario("platoon"), ARDUPILOT, programs[1:])
    (tmp_path / "etc" / "init.d-posix" / "rcS").unlink()
    with pytest.raises(ConfigError, match=r"^--binary: .*/px4 has no \.\./etc/init\.d-posix/rcS"):
        RealFleet.of(scenario("platoon"), PX4, programs[:1])


def test_indoors_they_fly_by_external_vision_and_the_cameras_see_their_true_poses(
    tmp_path: Path, programs: list[Path]
) -> None:
    px4, ardupilot = (RealFleet.of(scenario("lab_platoon"), kind, programs[n : n + 1]) for n, kind in enumerate(REAL))
    assert true_positions_of(px4, 100).truth_port == 21_612
    assert true_positions_of(RealFleet.of(scenario("platoon"), PX4, programs[:1]), 100).truth_port is None
    parameters = px4.started(1, tmp_path, 0).parameters
    assert [parameters[name] for name in ("EKF2_EV_CTRL", "EKF2_GPS_CTRL", "EKF2_EVP_NOISE")] == [11, 0, 0.01]
    parameters = ardupilot.started(1, tmp_path, 0).parameters
    assert [parameters[name] for name in ("VISO_TYPE", "EK3_SRC1_POSXY", "GPS1_TYPE")] == [1, 6, 0]


def test_a_px4_in_path_without_its_scripts_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = tmp_path / "px4"
    alone.touch(mode=0o755)
    monkeypatch.setattr(shutil, "which", lambda _name: str(alone))
    with pytest.raises(ConfigError, match=r"^--external: .*/px4 has no \.\./etc/init\.d-posix/rcS"):
        RealFleet.of(scenario("platoon"), PX4, [])
