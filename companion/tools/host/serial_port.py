"""The UART to the autopilot: no console on it, and a driver that can do its speed."""

from __future__ import annotations

import re

from companion.tools.host.board import Board
from companion.tools.host.finding import HostFinding, ok, problem, unknown, warning

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
    consoles = [_resolved(board, name) for name in re.findall(r"\bconsole=([A-Za-z0-9]+)", command_line)]
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


def _resolved(board: Board, console: str) -> str:
    """serial0 and serial1 are names of the Raspberry Pi's firmware."""
    return board.target(f"dev/{console}") or console


def _logins(board: Board) -> list[str]:
    places = ("etc/systemd/system/getty.target.wants", "run/systemd/generator/getty.target.wants")
    return [path.rpartition("/")[2] for place in places for path in board.paths(f"{place}/serial-getty@*.service")]
