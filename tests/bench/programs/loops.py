"""Loops at 50 Hz without any work, to compare an agent's ticks with: in C, and with asyncio's timer.

    python -m tests.bench.programs.loops FILE

runs the asyncio loop until SIGTERM and writes a line for each cycle: due and actual time of CLOCK_MONOTONIC, seconds. The C
program writes the same.
"""

from __future__ import annotations

import asyncio
import subprocess
import sys
from itertools import count
from pathlib import Path
from typing import NamedTuple, TextIO

from companion.link.tick import PERIOD_S

C_SOURCE = r"""
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

/* Wakes every PERIOD_NS at absolute times; writes due and actual time in seconds. */
int main(int argc, char **argv) {
    FILE *out = argc == 2 ? fopen(argv[1], "w") : NULL;
    struct timespec due, now;
    if (!out) return 2;
    setvbuf(out, NULL, _IOLBF, 0);
    clock_gettime(CLOCK_MONOTONIC, &due);
    for (;;) {
        due.tv_nsec += PERIOD_NS;
        if (due.tv_nsec >= 1000000000L) { due.tv_nsec -= 1000000000L; due.tv_sec++; }
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL) == EINTR) {}
        clock_gettime(CLOCK_MONOTONIC, &now);
        fprintf(out, "%lld.%09ld %lld.%09ld\n", (long long)due.tv_sec, due.tv_nsec, (long long)now.tv_sec, now.tv_nsec);
    }
}
"""


class Cycle(NamedTuple):
    """One wake-up."""

    due_s: float
    woken_s: float


def build_c_loop(folder: Path) -> Path | None:
    """The program, built with gcc; None where there is no gcc."""
    source, program = folder / "loop.c", folder / "loop"
    source.write_text(C_SOURCE, encoding="ascii")
    command = ["gcc", "-O2", f"-DPERIOD_NS={round(PERIOD_S * 1e9)}L", "-D_GNU_SOURCE", "-o", str(program), str(source)]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return program


def cycles_of(file: Path) -> list[Cycle]:
    """All complete lines of a loop's file."""
    lines = file.read_text(encoding="ascii").split("\n")[:-1] if file.exists() else []
    return [Cycle(*map(float, line.split())) for line in lines]


async def _asyncio_loop(out: TextIO) -> None:
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    for number in count(1):
        due_s = began_s + number * PERIOD_S
        await asyncio.sleep(due_s - loop.time())
        out.write(f"{due_s:.9f} {loop.time():.9f}\n")


def main() -> None:
    with Path(sys.argv[1]).open("w", encoding="ascii", buffering=1) as out:
        asyncio.run(_asyncio_loop(out))


if __name__ == "__main__":
    main()
