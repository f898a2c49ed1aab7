"""All checks of the companion computer, and their report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import msgspec

from companion.config.vehicle import load_agent
from companion.tools.host.board import Board, this_board
from companion.tools.host.finding import HostFinding, HostVerdict
from companion.tools.host.network import clock, wifi_power_saving
from companion.tools.host.power import governor, supply_voltage, temperature
from companion.tools.host.serial_port import serial_console, uart_speed
from companion.tools.host.system import disk, kernel, python, root_file_system
from companion.types.printable import printable

FIT, UNFIT = 0, 1  # exit codes
CHECKS: tuple[Callable[[Board], HostFinding], ...] = (
    *(serial_console, uart_speed, supply_voltage, temperature, governor),
    *(wifi_power_saving, clock, disk, root_file_system, kernel, python),
)
WIDEST_FOUND = 44  # characters; a longer value shifts only its own line


def run_host(vehicle_file: Path | None, as_json: bool) -> int:
    """The exit code. Raises ConfigError for a vehicle file that cannot be used."""
    endpoint = load_agent(vehicle_file).vehicle.mavlink if vehicle_file else ""
    board = this_board(*serial_port_of(endpoint))
    findings = examine(board)
    if as_json:
        found = {"board": board.model, "findings": [asdict(finding) for finding in findings]}
        print(msgspec.json.format(msgspec.json.encode(found), indent=2).decode())
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
    subject_width = max(len(finding.subject) for finding in findings)
    found_width = min(WIDEST_FOUND, max(len(finding.found) for finding in findings))
    for finding in findings:
        line = (
            f"{finding.verdict:<9} {finding.subject:<{subject_width}}  {finding.found:<{found_width}}  {finding.remedy}"
        )
        yield printable(line.rstrip())
    counts = [f"{_count(findings, verdict)} {verdict}" for verdict in HostVerdict if _count(findings, verdict)]
    yield ""
    yield ", ".join(reversed(counts))


def _count(findings: Sequence[HostFinding], verdict: HostVerdict) -> int:
    return sum(finding.verdict is verdict for finding in findings)
