"""The checks of a companion computer, and their report: `companion doctor --host`."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from companion.config.vehicle import load_agent
from companion.tools.host_board import (
    POWER_SAVE,
    Board,
    HostFinding,
    HostVerdict,
    ok,
    problem,
    this_board,
    unknown,
    warning,
)
from companion.tools.output import found_lines, json_text
from companion.types.values import printable

SUPPLY, TEMPERATURE, GOVERNOR = "supply voltage", "temperature", "CPU governor"
NOW, SINCE_START = 1 << 0, 1 << 16  # bits of the Raspberry Pi's firmware for undervoltage
WARM_C, HOT_C = 70.0, 80.0  # a Raspberry Pi slows down from 80 degrees on
COLDEST_C = -40.0  # below: a sensor that is off
BETTER_SUPPLY = "use a supply of 5 V and 3 A (Raspberry Pi 5: 5 A) on short, thick wires"
KEEP_PERFORMANCE = "set performance: docs/installation.md#governor"
WIFI, CLOCK = "Wi-Fi power saving", "clock"
SETTING = re.compile(r"^\s*wifi\.powersave\s*=\s*(\d)\s*$", re.MULTILINE)
OFF = "2"  # NetworkManager's number for disabled
SWITCH_OFF = "it delays packets by up to 0.1 s; switch it off: docs/installation.md#wi-fi-power-saving"
SCHEDULING = "scheduling"
POLICIES = {"0": "normal class", "1": "FIFO", "2": "round robin"}  # as systemd numbers them, from sched.h
LEAST_NICE = -10  # with less priority than this a compiler or an upgrade beside the agent makes its ticks late
UNLIMITED = -1
DISK, ROOT, KERNEL, PYTHON = "disk", "root file system", "kernel", "Python"
LITTLE_BYTES, LEAST_BYTES = 1_000_000_000, 100_000_000  # an upgrade needs 0.3 GB, the journal up to 0.2 GB
OLDEST_KERNEL = (5, 10)
OLDEST_PYTHON = (3, 11)
IN_MEMORY = ("overlay", "tmpfs", "aufs")
FIT, UNFIT = 0, 1  # exit codes
CONSOLE, SPEED = "serial console", "UART speed"
UARTS = re.compile(r"tty(?:S|AMA|THS|TCU)\d+")
CLOCKS_PER_BIT = 16  # a UART samples each bit so often
DEFAULT_BAUD = 921_600
MINI_UART = "bcm2835-aux-uart"
USB = ("ttyACM", "ttyUSB")


def serial_console(board: Board) -> HostFinding:
    """The kernel's console or a login on the autopilot's UART disturbs the autopilot and takes its bytes."""
    command_line = board.text("proc/cmdline")
    if command_line is None:
        return unknown(CONSOLE, "no kernel command line")
    consoles = [_resolve(board, name) for name in re.findall(r"\bconsole=([A-Za-z0-9]+)", command_line)]
    logins = [name.partition("@")[2].removesuffix(".service") for name in _logins(board)]
    used = [name for name in dict.fromkeys([*consoles, *logins]) if UARTS.fullmatch(name)]
    port = _port(board)
    if not used:
        return ok(CONSOLE, "none on a UART")
    if port and port not in used:
        return ok(CONSOLE, f"on {', '.join(used)}, not on {port}")
    found = f"on {', '.join(used)}"
    remedy = (
        "sudo raspi-config nonint do_serial_cons 1, then reboot"
        if board.is_raspberry_pi
        else f"remove console={used[0]} from the kernel command line; sudo systemctl mask --now serial-getty@{used[0]}"
    )
    return problem(CONSOLE, found, remedy) if port else warning(CONSOLE, found, f"if the autopilot is there: {remedy}")


def uart_speed(board: Board) -> HostFinding:
    """Whether the UART of the vehicle file can do the speed of the vehicle file."""
    port, wanted = _port(board), board.speed_baud or DEFAULT_BAUD
    if not port:
        return unknown(SPEED, "no vehicle file with a serial port", "give --config FILE")
    if port.startswith(USB):
        return ok(SPEED, f"{port} is on USB, which has no fixed speed")
    folder = f"sys/class/tty/{port}"
    if board.target(f"{folder}/device/driver") == MINI_UART:
        text = "the mini UART, whose speed follows the core clock"
        return problem(SPEED, f"{port}: {text}", "dtoverlay=disable-bt in config.txt and ttyAMA0, docs/installation.md")
    clock_hz = board.number(f"{folder}/uartclk")
    if not clock_hz:
        return unknown(SPEED, f"{port}: no uartclk")
    most_baud = clock_hz // CLOCKS_PER_BIT
    found = f"{port}: at most {most_baud} baud"
    if most_baud < wanted:
        return problem(SPEED, found, f"{wanted} is wanted: set a lower speed on both ends, or raise the UART's clock")
    return ok(SPEED, f"{found}, {wanted} wanted")


def _port(board: Board) -> str:
    """The kernel's name of the autopilot's port: links such as /dev/autopilot and /dev/serial0 are followed."""
    path = board.device.removeprefix("/")
    return (board.target(path) or path.rpartition("/")[2]) if path else ""


def _resolve(board: Board, console: str) -> str:
    """serial0 and serial1 are names of the Raspberry Pi's firmware."""
    return board.target(f"dev/{console}") or console


def _logins(board: Board) -> list[str]:
    places = ("etc/systemd/system/getty.target.wants", "run/systemd/generator/getty.target.wants")
    return [path.rpartition("/")[2] for place in places for path in board.paths(f"{place}/serial-getty@*.service")]


def supply_voltage(board: Board) -> HostFinding:
    """Undervoltage now, or since the start of the board."""
    bits = _firmware_bits(board)
    alarms = [
        board.number(path)
        for path in board.paths("sys/class/hwmon/*/in0_lcrit_alarm")
        if board.text(path.replace("in0_lcrit_alarm", "name")) == "rpi_volt"
    ]
    if bits is None and not alarms:
        return unknown(SUPPLY, "this board does not measure it")
    if (bits or 0) & NOW or any(alarms):
        return problem(SUPPLY, "too low now", BETTER_SUPPLY)
    if (bits or 0) & SINCE_START:
        return warning(SUPPLY, "was too low since the start", BETTER_SUPPLY)
    return ok(SUPPLY, "high enough")


def _firmware_bits(board: Board) -> int | None:
    files = [board.text(path) for path in board.paths("sys/devices/platform/soc*/*firmware*/get_throttled")]
    for text in [board.outputs.get("get_throttled"), *files]:
        if found := re.fullmatch(r"(?:throttled=0x|0x)?([0-9a-fA-F]+)", text or ""):
            return int(found[1], 16)
    return None


def temperature(board: Board) -> HostFinding:
    """The hottest of the board's sensors."""
    read = [board.number(path) for path in board.paths("sys/class/thermal/thermal_zone*/temp")]
    degrees = [value / 1000 for value in read if value is not None and value / 1000 > COLDEST_C]
    if not degrees:
        return unknown(TEMPERATURE, "no sensor")
    found = f"{max(degrees):.0f} degrees C"
    if max(degrees) >= HOT_C:
        return problem(TEMPERATURE, found, "the processor slows down: add a heat sink or a fan, keep it out of the sun")
    if max(degrees) >= WARM_C:
        return warning(TEMPERATURE, found, f"{HOT_C:.0f} slows the processor down: improve the cooling")
    return ok(TEMPERATURE, found)


def governor(board: Board) -> HostFinding:
    """A governor that lowers the clock rate makes ticks late after quiet moments."""
    found = [board.text(path) for path in board.paths("sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")]
    names = Counter(name for name in found if name)
    if not names:
        return unknown(GOVERNOR, "the clock rate is fixed or not shown")
    text = ", ".join(f"{name} on {count} cores" for name, count in names.items())
    return ok(GOVERNOR, text) if set(names) == {"performance"} else warning(GOVERNOR, text, KEEP_PERFORMANCE)


def scheduling(board: Board) -> HostFinding:
    """How the kernel runs each agent: the real-time policy of the unit, docs/installation.md#scheduling."""
    blocks = (board.outputs.get("agents") or "").split("\n\n")
    agents = [dict(line.split("=", 1) for line in block.splitlines() if "=" in line) for block in blocks]
    agents = [agent for agent in agents if agent.get("Id")]
    if not agents:
        return unknown(SCHEDULING, "no agent of this computer is a service")
    found = "; ".join(_scheduled(agent) for agent in agents)
    if all(agent.get("CPUSchedulingPolicy") in (None, "0") for agent in agents):
        late = any(_whole(agent.get("Nice")) > LEAST_NICE for agent in agents)
        remedy = "other processes delay its ticks: keep Nice=-15 of companion@.service"
        return warning(SCHEDULING, found, remedy) if late else ok(SCHEDULING, found)
    if board.number("proc/sys/kernel/sched_rt_runtime_us") == UNLIMITED:
        remedy = "a runaway loop would lock up the computer: sudo sysctl kernel.sched_rt_runtime_us=950000"
        return problem(SCHEDULING, f"{found}; no limit of the kernel", remedy)
    return ok(SCHEDULING, found)


def _scheduled(agent: Mapping[str, str]) -> str:
    policy = POLICIES.get(agent.get("CPUSchedulingPolicy", "0"), "another class")
    if policy == POLICIES["0"]:
        policy += f", nice {agent.get('Nice', '0')}"
    else:
        policy += f", priority {agent.get('CPUSchedulingPriority', '0')}"
    cores = f"cores {agent['CPUAffinity']}" if agent.get("CPUAffinity") else "any core"
    slack_us = _whole(agent.get("TimerSlackNSec")) / 1000
    return f"{agent['Id'].removesuffix('.service')}: {policy}, {cores}, timer slack {slack_us:g} us"


def _whole(value: str | None) -> int:
    return int(value) if value and re.fullmatch(r"-?\d{1,12}", value) else 0


def wifi_power_saving(board: Board) -> HostFinding:
    """What `iw` reports for each interface, else what NetworkManager is configured to do."""
    interfaces = [path.split("/")[3] for path in board.paths("sys/class/net/*/wireless")]
    if not interfaces:
        return ok(WIFI, "no Wi-Fi")
    reported = {name: board.outputs.get(POWER_SAVE + name, "") for name in interfaces}
    on = [name for name, text in reported.items() if text.endswith(": on")]
    if on:
        return warning(WIFI, f"on for {', '.join(on)}", SWITCH_OFF)
    if all(text.endswith(": off") for text in reported.values()):
        return ok(WIFI, f"off for {', '.join(interfaces)}")
    files = ("usr/lib/NetworkManager/conf.d/*.conf", "etc/NetworkManager/conf.d/*.conf")  # the last one counts
    settings = [found[1] for files_of in files for path in board.paths(files_of) if (found := _setting(board, path))]
    if settings:
        last = settings[-1]
        return ok(WIFI, "off by NetworkManager") if last == OFF else warning(WIFI, "on by NetworkManager", SWITCH_OFF)
    return unknown(WIFI, f"of {', '.join(interfaces)}", "sudo apt install iw")


def _setting(board: Board, path: str) -> re.Match[str] | None:
    return SETTING.search(board.text(path) or "")


def clock(board: Board) -> HostFinding:
    """Whether the clock is synchronised: signatures, certificates and log times need it, formation flight does not."""
    answer = board.outputs.get("timedatectl")
    if answer == "yes" or board.text("run/systemd/timesync/synchronized") is not None:
        return ok(CLOCK, "synchronised")
    if answer == "no":
        text = "MAVLink signing and certificates need it: connect to an NTP server, or fit a clock with a battery"
        return warning(CLOCK, "not synchronised", text)
    return unknown(CLOCK, "no timedatectl")


def disk(board: Board) -> HostFinding:
    """The free space of the root file system."""
    if board.free_bytes is None:
        return unknown(DISK, "the free space")
    found = f"{board.free_bytes / 1e9:.1f} GB free"
    if board.free_bytes < LEAST_BYTES:
        return problem(DISK, found, "remove files; sudo journalctl --vacuum-size=50M")
    if board.free_bytes < LITTLE_BYTES:
        return warning(DISK, found, "an upgrade of the package needs 0.3 GB beside the journal")
    return ok(DISK, found)


def root_file_system(board: Board) -> HostFinding:
    """Whether what is written stays: a card that is worn out becomes read-only, an overlay forgets."""
    mounts = [line.split() for line in (board.text("proc/mounts") or "").splitlines()]
    roots = [fields for fields in mounts if len(fields) >= 4 and fields[1] == "/"]
    if not roots:
        return unknown(ROOT, "how it is mounted")
    kind, options = roots[-1][2], roots[-1][3].split(",")
    if "ro" in options:
        text = "no log is kept and nothing can be installed: if this is not intended, check the card (dmesg)"
        return warning(ROOT, f"{kind}, read-only", text)
    if kind in IN_MEMORY:
        return warning(ROOT, f"{kind}, in memory", "what is written is lost with the supply: copy logs before")
    return ok(ROOT, f"{kind}, writable")


def kernel(board: Board) -> HostFinding:
    """The release of the kernel."""
    release = board.text("proc/sys/kernel/osrelease") or ""
    found = re.match(r"(\d+)\.(\d+)", release)
    if not found:
        return unknown(KERNEL, "its release")
    if (int(found[1]), int(found[2])) < OLDEST_KERNEL:
        wanted = ".".join(map(str, OLDEST_KERNEL))
        return warning(KERNEL, release, f"older than {wanted}, the oldest that Debian 11 has: upgrade the system")
    return ok(KERNEL, release)


def python(board: Board) -> HostFinding:
    """The version of Python that runs this check."""
    found = ".".join(map(str, board.python))
    if board.python < OLDEST_PYTHON:
        return problem(PYTHON, found, f"{'.'.join(map(str, OLDEST_PYTHON))} or newer is needed")
    return ok(PYTHON, found)


CHECKS: tuple[Callable[[Board], HostFinding], ...] = (
    *(serial_console, uart_speed, supply_voltage, temperature, governor, scheduling),
    *(wifi_power_saving, clock, disk, root_file_system, kernel, python),
)


def run_host(vehicle_file: Path | None, as_json: bool) -> int:
    """The exit code. Raises ConfigError for a vehicle file that cannot be used."""
    endpoint = load_agent(vehicle_file).vehicle.mavlink if vehicle_file else ""
    board = this_board(*serial_port_of(endpoint))
    findings = examine(board)
    if as_json:
        found = {"board": board.model, "findings": [asdict(finding) for finding in findings]}
        print(json_text(found))
    else:
        print("\n".join(report(board, findings)))
    return UNFIT if any(finding.verdict is HostVerdict.PROBLEM for finding in findings) else FIT


def serial_port_of(endpoint: str) -> tuple[str, int]:
    """Device and speed of a MAVLink endpoint like serial:/dev/ttyAMA0:921600; ("", 0) for another kind."""
    kind, _, rest = endpoint.partition(":")
    device, _, speed = rest.rpartition(":")
    return (device, int(speed)) if kind == "serial" and speed.isdigit() else ("", 0)


def examine(board: Board) -> tuple[HostFinding, ...]:
    """The findings of all checks."""
    return tuple([check(board) for check in CHECKS])


def report(board: Board, findings: Sequence[HostFinding]) -> Iterator[str]:
    """The board, one line per finding in columns, and a summary."""
    yield printable(board.model or "an unknown board")
    rows = [(finding.verdict, finding.subject, finding.found, finding.remedy) for finding in findings]
    yield from map(printable, found_lines(rows, verdict_width=9))
    counted = Counter(finding.verdict for finding in findings)
    counts = [f"{counted[verdict]} {verdict}" for verdict in HostVerdict if counted[verdict]]
    yield ""
    yield ", ".join(reversed(counts))
