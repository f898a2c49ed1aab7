"""Checks of the companion computer, on trees of files like those of real boards."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from common import ROOT
from companion.tools.host_board import Board, HostFinding, HostVerdict
from companion.tools.host_checks import (
    KEEP_PERFORMANCE,
    SWITCH_OFF,
    clock,
    disk,
    examine,
    governor,
    kernel,
    python,
    report,
    root_file_system,
    scheduling,
    serial_console,
    serial_port_of,
    supply_voltage,
    temperature,
    uart_speed,
    wifi_power_saving,
)

OK, UNKNOWN, WARNING, PROBLEM = HostVerdict.OK, HostVerdict.UNKNOWN, HostVerdict.WARNING, HostVerdict.PROBLEM
Make = Callable[..., Board]


PI_4 = {
    "proc/device-tree/model": "Raspberry Pi 4 Model B Rev 1.5\0",
    "proc/cmdline": "coherent_pool=1M 8250.nr_uarts=0 console=tty1 root=PARTUUID=5b2a-02 rootfstype=ext4 rootwait",
    "proc/mounts": "/dev/mmcblk0p2 / ext4 rw,noatime 0 0\nproc /proc proc rw,relatime 0 0",
    "proc/sys/kernel/osrelease": "6.6.51+rpt-rpi-v8",
    "sys/class/hwmon/hwmon0/name": "cpu_thermal",
    "sys/class/hwmon/hwmon1/name": "rpi_volt",
    "sys/class/hwmon/hwmon1/in0_lcrit_alarm": "0",
    "sys/class/thermal/thermal_zone0/temp": "48686",
    "sys/class/tty/ttyAMA0/uartclk": "48000000",
    "sys/class/net/wlan0/wireless/placeholder": "",
    "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "performance",
    "sys/devices/system/cpu/cpu1/cpufreq/scaling_governor": "performance",
    "run/systemd/timesync/synchronized": "",
}


LINKS = {"dev/serial0": "ttyAMA0", "sys/class/tty/ttyAMA0/device/driver": "../../bus/amba/drivers/uart-pl011"}


AGENT = "Nice=-15\nCPUSchedulingPolicy=0\nCPUSchedulingPriority=0\nCPUAffinity=\nTimerSlackNSec=1000\nId=companion@3.service"
OUTPUTS = {"power_save wlan0": "Power save: off", "get_throttled": "throttled=0x0", "agents": AGENT}


def board_tree(root: Path, changes: Mapping[str, str | None], links: Mapping[str, str] = LINKS) -> Path:
    """The files of a Raspberry Pi 4 that is ready, with some changed or, by None, missing."""
    for path, text in (PI_4 | dict(changes)).items():
        if text is not None:
            (root / path).parent.mkdir(parents=True, exist_ok=True)
            (root / path).write_text(text + "\n", encoding="utf-8")
    for path, target in links.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).symlink_to(target)
    return root


@pytest.fixture
def board(tmp_path: Path) -> Make:
    def make(
        changes: Mapping[str, str | None] = {},
        outputs: Mapping[str, str] = OUTPUTS,
        device: str = "/dev/ttyAMA0",
        speed_baud: int = 921_600,
        links: Mapping[str, str] = LINKS,
    ) -> Board:
        root = board_tree(tmp_path, changes, links)
        return Board(root, outputs, 20_000_000_000, (3, 11), device, speed_baud)

    return make


def test_a_raspberry_pi_that_is_ready_has_no_finding(board: Make) -> None:
    findings = examine(board())
    assert {finding.subject: finding.found for finding in findings if finding.verdict is not OK} == {}


def test_of_an_empty_root_nothing_is_known_and_nothing_fails(tmp_path: Path) -> None:
    findings = examine(Board(tmp_path, python=(3, 11)))
    assert {finding.verdict for finding in findings} == {OK, UNKNOWN}
    assert {finding.subject for finding in findings if finding.verdict is OK} == {"Wi-Fi power saving", "Python"}


CONSOLE = "console=serial0,115200 console=tty1 root=PARTUUID=5b2a-02"
GETTY = "etc/systemd/system/getty.target.wants/serial-getty@ttyAMA0.service"
POWER_SAVE = "power_save wlan0"
ALARM = "sys/class/hwmon/hwmon1/in0_lcrit_alarm"
FIRMWARE = "sys/devices/platform/soc/soc:firmware/get_throttled"
CORE_1 = "sys/devices/system/cpu/cpu1/cpufreq/scaling_governor"
NETWORK_MANAGER = "etc/NetworkManager/conf.d/powersave.conf"
CASES = [
    (serial_console, {"proc/cmdline": CONSOLE}, {}, PROBLEM, "on ttyAMA0"),
    (serial_console, {"proc/cmdline": CONSOLE}, {"device": ""}, WARNING, "on ttyAMA0"),
    (serial_console, {"proc/cmdline": CONSOLE}, {"device": "/dev/serial0"}, PROBLEM, "on ttyAMA0"),
    (serial_console, {"proc/cmdline": CONSOLE}, {"device": "/dev/ttyACM0"}, OK, "not on ttyACM0"),
    (serial_console, {"proc/cmdline": "console=ttyTCU0,115200"}, {"device": "/dev/ttyTHS1"}, OK, "not on ttyTHS1"),
    (serial_console, {GETTY: ""}, {}, PROBLEM, "on ttyAMA0"),
    (serial_console, {"proc/cmdline": None}, {}, UNKNOWN, "no kernel command line"),
    (uart_speed, {"sys/class/tty/ttyAMA0/uartclk": "3000000"}, {}, PROBLEM, "at most 187500 baud"),
    (uart_speed, {"sys/class/tty/ttyAMA0/uartclk": "3000000"}, {"speed_baud": 57_600}, OK, "57600 wanted"),
    (uart_speed, {}, {"links": {"sys/class/tty/ttyAMA0/device/driver": "bcm2835-aux-uart"}}, PROBLEM, "mini UART"),
    (uart_speed, {}, {"device": "/dev/ttyACM0"}, OK, "on USB"),
    (uart_speed, {"sys/class/tty/ttyAMA0/uartclk": None}, {}, UNKNOWN, "no uartclk"),
    (uart_speed, {}, {"device": ""}, UNKNOWN, "no vehicle file"),
    (supply_voltage, {ALARM: "1"}, {}, PROBLEM, "too low now"),
    (supply_voltage, {"sys/class/hwmon/hwmon1/name": "nvme", ALARM: "1"}, {}, OK, "high enough"),
    (supply_voltage, {}, {"outputs": {"get_throttled": "throttled=0x50005"}}, PROBLEM, "too low now"),
    (supply_voltage, {}, {"outputs": {"get_throttled": "throttled=0x50000"}}, WARNING, "was too low"),
    (supply_voltage, {FIRMWARE: "50000"}, {"outputs": {}}, WARNING, "was too low"),
    (supply_voltage, {FIRMWARE: "80000"}, {"outputs": {}}, OK, "high enough"),
    (supply_voltage, {ALARM: None}, {"outputs": {}}, UNKNOWN, "does not measure"),
    (temperature, {"sys/class/thermal/thermal_zone1/temp": "71500"}, {}, WARNING, "72 degrees"),
    (temperature, {"sys/class/thermal/thermal_zone1/temp": "80000"}, {}, PROBLEM, "80 degrees"),
    (temperature, {"sys/class/thermal/thermal_zone0/temp": "-256000"}, {}, UNKNOWN, "no sensor"),
    (governor, {CORE_1: "ondemand"}, {}, WARNING, "performance on 1 cores, ondemand on 1 cores"),
    (wifi_power_saving, {}, {"outputs": {POWER_SAVE: "Power save: on"}}, WARNING, "on for wlan0"),
    (wifi_power_saving, {}, {"outputs": {}}, UNKNOWN, "of wlan0"),
    (wifi_power_saving, {NETWORK_MANAGER: "[connection]\nwifi.powersave = 2"}, {"outputs": {}}, OK, "NetworkManager"),
    (wifi_power_saving, {NETWORK_MANAGER: "[connection]\nwifi.powersave=3"}, {"outputs": {}}, WARNING, "on by"),
    (
        clock,
        {"run/systemd/timesync/synchronized": None},
        {"outputs": {"timedatectl": "no"}},
        WARNING,
        "not synchronised",
    ),
    (clock, {"run/systemd/timesync/synchronized": None}, {"outputs": {"timedatectl": "yes"}}, OK, "synchronised"),
    (clock, {"run/systemd/timesync/synchronized": None}, {}, UNKNOWN, "no timedatectl"),
    (root_file_system, {"proc/mounts": "/dev/mmcblk0p2 / ext4 ro,noatime 0 0"}, {}, WARNING, "ext4, read-only"),
    (root_file_system, {"proc/mounts": "overlay / overlay rw,lowerdir=/ 0 0"}, {}, WARNING, "in memory"),
    (root_file_system, {"proc/mounts": "/dev/sda1 /boot ext4 ro 0 0"}, {}, UNKNOWN, "how it is mounted"),
    (kernel, {"proc/sys/kernel/osrelease": "4.9.337-tegra"}, {}, WARNING, "4.9.337-tegra"),
    (kernel, {"proc/sys/kernel/osrelease": "5.10.0"}, {}, OK, "5.10.0"),
]


@pytest.mark.parametrize(("check", "files", "settings", "verdict", "found"), CASES)
def test_a_check_judges_what_was_read(
    board: Make,
    check: Callable[[Board], HostFinding],
    files: Mapping[str, str | None],
    settings: Mapping[str, object],
    verdict: HostVerdict,
    found: str,
) -> None:
    finding = check(board(files, **settings))
    assert finding.verdict is verdict, finding
    assert found in finding.found
    assert bool(finding.remedy) == (verdict in (WARNING, PROBLEM)) or verdict is UNKNOWN


@pytest.mark.parametrize(
    ("free_bytes", "verdict"), [(50_000_000, PROBLEM), (500_000_000, WARNING), (5_000_000_000, OK), (None, UNKNOWN)]
)
def test_the_free_space_is_judged(tmp_path: Path, free_bytes: int | None, verdict: HostVerdict) -> None:
    assert disk(Board(tmp_path, free_bytes=free_bytes)).verdict is verdict


@pytest.mark.parametrize(("version", "verdict"), [((3, 10), PROBLEM), ((3, 11), OK), ((3, 13), OK)])
def test_python_is_judged(tmp_path: Path, version: tuple[int, int], verdict: HostVerdict) -> None:
    assert python(Board(tmp_path, python=version)).verdict is verdict


def test_the_report_has_the_board_a_line_per_check_and_a_summary(board: Make) -> None:
    made = board({ALARM: "1"}, outputs={"power_save wlan0": "Power save: on"})
    lines = list(report(made, examine(made)))
    assert lines[0] == "Raspberry Pi 4 Model B Rev 1.5"
    assert [line for line in lines if line.startswith("problem ")] == [
        line for line in lines if "supply voltage" in line
    ]
    assert len(lines) == 1 + len(examine(made)) + 2
    assert lines[-1] == "1 problem, 1 warning, 1 not known, 9 ok"


def test_foreign_text_cannot_control_the_terminal(board: Make) -> None:
    made = board({"proc/sys/kernel/osrelease": "6.1\x1b[2J"})
    assert all(line.isprintable() or not line for line in report(made, examine(made)))


@pytest.mark.parametrize(
    ("endpoint", "port"),
    [
        ("serial:/dev/ttyAMA0:921600", ("/dev/ttyAMA0", 921_600)),
        ("serial:/dev/serial/by-id/usb-3D:0:115200", ("/dev/serial/by-id/usb-3D:0", 115_200)),
        ("udpin:0.0.0.0:14540", ("", 0)),
        ("", ("", 0)),
    ],
)
def test_the_serial_port_comes_from_the_endpoint(endpoint: str, port: tuple[str, int]) -> None:
    assert serial_port_of(endpoint) == port


# ---------------------------------------------------------------- remedies


def test_the_remedies_name_headings_of_the_guide() -> None:
    headings = re.findall(r"^## (.+)$", (ROOT / "docs" / "installation.md").read_text(encoding="utf-8"), re.MULTILINE)
    anchors = {title.lower().replace(" ", "-") for title in headings}
    for remedy in (SWITCH_OFF, KEEP_PERFORMANCE):
        assert re.findall(r"docs/installation\.md#([\w-]+)", remedy)[0] in anchors


FIFO = AGENT.replace("Policy=0", "Policy=1").replace("Priority=0", "Priority=10").replace("Affinity=", "Affinity=3")


@pytest.mark.parametrize(
    ("agents", "runtime_us", "verdict", "found"),
    [
        (AGENT, "950000", OK, "companion@3: normal class, nice -15, any core, timer slack 1 us"),
        (AGENT.replace("Nice=-15", "Nice=0"), "950000", WARNING, "companion@3: normal class, nice 0"),
        (FIFO, "950000", OK, "companion@3: FIFO, priority 10, cores 3"),
        (FIFO, "-1", PROBLEM, "no limit of the kernel"),
        (f"{AGENT}\n\n{FIFO.replace('@3', '@4')}", "-1", PROBLEM, "companion@4: FIFO"),
        ("Id=companion@3.service\nNice=[not set]\nnothing", "950000", WARNING, "companion@3: normal class"),
        ("", "950000", UNKNOWN, "no agent of this computer is a service"),
    ],
)
def test_how_the_kernel_runs_the_agents(
    board: Make, agents: str, runtime_us: str, verdict: HostVerdict, found: str
) -> None:
    finding = scheduling(
        board({"proc/sys/kernel/sched_rt_runtime_us": runtime_us}, outputs=OUTPUTS | {"agents": agents})
    )
    assert finding.verdict is verdict
    assert found in finding.found
    assert bool(finding.remedy) is (verdict in (WARNING, PROBLEM))
