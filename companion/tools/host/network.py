"""Wi-Fi power saving, and the clock."""

from __future__ import annotations

import re

from companion.tools.host.board import POWER_SAVE, Board
from companion.tools.host.finding import HostFinding, ok, unknown, warning

WIFI, CLOCK = "Wi-Fi power saving", "clock"
SETTING = re.compile(r"^\s*wifi\.powersave\s*=\s*(\d)\s*$", re.MULTILINE)
OFF = "2"  # NetworkManager's number for disabled
SWITCH_OFF = "it delays packets by up to 0.1 s; switch it off: docs/installation.md#wi-fi-power-saving"


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
