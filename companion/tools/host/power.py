"""Supply, temperature and clock rate of the processor."""

from __future__ import annotations

import re
from collections import Counter

from companion.tools.host.board import Board
from companion.tools.host.finding import HostFinding, ok, problem, unknown, warning

SUPPLY, TEMPERATURE, GOVERNOR = "supply voltage", "temperature", "CPU governor"
NOW, SINCE_START = 1 << 0, 1 << 16  # bits of the Raspberry Pi's firmware for undervoltage
WARM_C, HOT_C = 70.0, 80.0  # a Raspberry Pi slows down from 80 degrees on
COLDEST_C = -40.0  # below: a sensor that is off
BETTER_SUPPLY = "use a supply of 5 V and 3 A (Raspberry Pi 5: 5 A) on short, thick wires"
KEEP_PERFORMANCE = "set performance: docs/installation.md#governor"


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
