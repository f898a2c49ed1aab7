"""What the kernel counts of a process: bytes of its TCP connections, CPU time, memory. Linux, with iproute2's `ss`."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import NamedTuple

HEADERS = 52  # bytes of IPv4 and TCP with time stamps in each segment
COUNTERS = ("bytes_sent", "segs_out", "bytes_received", "segs_in")


class Traffic(NamedTuple):
    """IP bytes and segments of all connections of a process up to now. Connections that have ended are left out."""

    sent_bytes: int
    sent: int
    received_bytes: int
    received: int


def traffic_of(pid: int) -> Traffic:
    shown = subprocess.run(["ss", "-tinpOH"], capture_output=True, text=True, check=True).stdout
    return traffic_in(shown, pid)


def traffic_in(shown: str, pid: int) -> Traffic:
    """From the output of `ss -tinpOH`, one line for each connection."""
    sums = dict.fromkeys(COUNTERS, 0)
    for line in shown.splitlines():
        if f"pid={pid}," in line:
            for name in COUNTERS:
                found = re.search(rf"\b{name}:(\d+)", line)
                sums[name] += int(found[1]) if found else 0
    sent, received = sums["segs_out"], sums["segs_in"]
    return Traffic(sums["bytes_sent"] + HEADERS * sent, sent, sums["bytes_received"] + HEADERS * received, received)


def cpu_s(pid: int) -> float:
    """Time that all threads of a process have run."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((task / "schedstat").read_text(encoding="ascii").split()[0]) for task in tasks) / 1e9
