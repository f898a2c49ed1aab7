"""One case after the other: an agent's link among others, measured from outside in windows of time."""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import NamedTuple

from tests.bench.machine import Meanwhile
from tests.bench.page import write_between_marks
from tests.bench.processes import Program, cpu_s, module, use_of, wait_for
from tests.bench.programs.large_fleet import LinkResult

NUMBERS = (8, 16, 32, 64)
AT_FULL_RATE = 8
SETTLES_S, WINDOW_S, REPEATS = 1.0, 4.0, 3
HEADERS = 52  # bytes of IPv4 and TCP with time stamps in each segment
COUNTERS = ("bytes_sent", "segs_out", "bytes_received", "segs_in")
MARKS = "large fleet"  # of its page
HEAD = (
    "| others | at 50 Hz | through | packets received [1/s] | received [kB/s] | sent [kB/s] | CPU of the link"
    " | CPU of the router | memory [MB] | age at 50 Hz: p50, p99 [ms] | oldest at 5 Hz [ms] | to 50 Hz: p50, worst [ms] |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|"
)


class Case(NamedTuple):
    """How many other vehicles there are, how many of them are received at full rate, and whether through a router."""

    number: int
    full: int
    routed: bool


class LinkCounters(NamedTuple):
    """Counters up to now."""

    at_s: float
    traffic: Traffic
    cpu_s: float
    router_cpu_s: float


@dataclass(frozen=True, slots=True)
class CaseFigures:
    """A case with its figures: the medians of its windows, and what the agent measured itself."""

    case: Case
    received_kb_s: float
    sent_kb_s: float
    cpu: float
    router_cpu: float
    memory_mb: float
    result: LinkResult

    def line(self) -> str:
        """Of the table."""
        case, result = self.case, self.result
        cells = (
            f"{case.number}",
            "all" if case.full == case.number else f"{case.full}",
            "router" if case.routed else "own connections",
            f"{result.packets_per_s:,.0f}",
            f"{self.received_kb_s:,.0f}",
            f"{self.sent_kb_s:,.0f}",
            f"{self.cpu:.1%}",
            f"{self.router_cpu:.1%}" if case.routed else "",
            f"{self.memory_mb:.0f}",
            f"{result.full_p50_ms:.1f}, {result.full_p99_ms:.1f}",
            "" if result.slow_worst_ms is None else f"{result.slow_worst_ms:.0f}",
            "" if result.switch_p50_ms is None else f"{result.switch_p50_ms:.0f}, {result.switch_worst_ms:.0f}",
        )
        return f"| {' | '.join(cells)} |"


def cases(numbers: Sequence[int]) -> list[Case]:
    """Each number without and with a router, all at full rate and AT_FULL_RATE of them."""
    return [
        Case(number, full, routed)
        for routed in (False, True)
        for number in numbers
        for full in sorted({number, min(number, AT_FULL_RATE)}, reverse=True)
    ]


def measure_all(numbers: Sequence[int], first_port: int) -> Iterator[CaseFigures]:
    """A row for each case, as soon as it is measured. Raises RuntimeError where the vehicles do not hear each other."""
    for place, case in enumerate(cases(numbers)):
        yield measure(case, first_port + place)


def measure(case: Case, port: int) -> CaseFigures:
    """Raises RuntimeError where the agent does not hear all others."""
    endpoint, numbers = f"tcp/127.0.0.1:{port}", (str(case.number), str(case.full))
    with ExitStack() as stack:
        router = _program(stack, "router", endpoint) if case.routed else None
        if router:
            wait_for([router], "ready")
        mode, where = ("client", "connect") if case.routed else ("peer", "listen")
        agent = _program(stack, "agent", mode, where, endpoint, *numbers)
        _program(stack, "others", mode, endpoint, *numbers)
        wait_for([agent], "heard")
        time.sleep(SETTLES_S)
        agent.begin()
        samples = [_sample(agent, router)]
        for _ in range(REPEATS):
            time.sleep(WINDOW_S)
            samples.append(_sample(agent, router))
        memory_mb = use_of(agent.pid).memory_mb
        agent.end_input()
        result = agent.result(LinkResult)
    return row(case, samples, memory_mb, result)


def row(case: Case, samples: Sequence[LinkCounters], memory_mb: float, result: LinkResult) -> CaseFigures:
    """The medians of the windows between these samples."""
    lasted_s = [b.at_s - a.at_s for a, b in pairwise(samples)]

    def rate(counters: Sequence[float]) -> float:
        grown = [after - before for before, after in pairwise(counters)]
        return median(growth / seconds for growth, seconds in zip(grown, lasted_s, strict=True))

    return CaseFigures(
        case=case,
        received_kb_s=rate([sample.traffic.received_bytes for sample in samples]) / 1e3,
        sent_kb_s=rate([sample.traffic.sent_bytes for sample in samples]) / 1e3,
        cpu=rate([sample.cpu_s for sample in samples]),
        router_cpu=rate([sample.router_cpu_s for sample in samples]),
        memory_mb=memory_mb,
        result=result,
    )


def table(rows: Sequence[CaseFigures]) -> str:
    """In Markdown."""
    return "\n".join([HEAD, *(one.line() for one in rows)])


def _sample(agent: Program, router: Program | None) -> LinkCounters:
    at_s = time.monotonic()
    return LinkCounters(at_s, traffic_of(agent.pid), cpu_s(agent.pid), cpu_s(router.pid) if router else 0.0)


def _program(stack: ExitStack, role: str, *arguments: str) -> Program:
    return Program(stack, module("tests.bench.programs.large_fleet", role, *arguments))


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


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.large_fleet",
        description="CPU and bytes of one agent's Zenoh link among others that publish at 50 Hz, all received at that rate or"
        " eight of them and the rest at 5 Hz, with connections of its own and through a Zenoh router. Linux, with iproute2.",
    )
    parser.add_argument(
        "--others", type=int, nargs="+", default=NUMBERS, metavar="N", help="publishers (default 8 16 32 64)"
    )
    parser.add_argument("--port", type=int, default=17600, metavar="PORT", help="first of one for each case (17600)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the table between the marks of this page")
    options = parser.parse_args()
    if not all(1 <= number <= 200 for number in options.others):
        parser.error("expected 1 to 200 publishers")
    rows, meanwhile = [], Meanwhile()
    try:
        for row in measure_all(options.others, options.port):
            print(row.line(), flush=True)
            rows.append(row)
    except RuntimeError as error:
        print(f"large fleet: {error}", file=sys.stderr)
        return 1
    elsewhere = f"Meanwhile other processes used {meanwhile.others_cores():.1f} cores."
    print(elsewhere)
    if options.page:
        write_between_marks(options.page, MARKS, f"{table(rows)}\n\n{elsewhere}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
