"""How fast the live page shows 50 vehicles at 10 Hz: python -m tests.bench.live_page.

Real Zenoh, the real `companion monitor` and a headless Chromium, all on this machine. Needs Playwright and Debian's Chromium.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Page

CHROMIUM = Path("/usr/bin/chromium")
ARGUMENTS = [
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
]
VEHICLES, RATE_HZ = 50, 10.0
WIDTH_PX, HEIGHT_PX = 1440, 900
SETTLE_S, MEASURE_S = 5.0, 40.0
P95_LIMIT_MS, CPU_LIMIT_PERCENT, FIRST_LIMIT_S = 100.0, 25.0, 2.0
LOAD_PORT, PAGE_PORT = 7448, 8601
URL = re.compile(r"http://\S+")


@dataclass(frozen=True, slots=True)
class Measured:
    """Times from the arrival of a snapshot to the painted frame, ms; the server's share of a core."""

    p50_ms: float
    p95_ms: float
    frames: int
    first_picture_s: float
    cpu_percent: float


def main() -> int:
    """The exit code: 0 where all limits are kept."""
    with TemporaryDirectory(prefix="page-") as folder:
        measured = _measured(Path(folder))
    print(
        f"{VEHICLES} vehicles at {RATE_HZ:g} Hz, {measured.frames} frames painted in {MEASURE_S:g} s\n"
        f"page update: p50 {measured.p50_ms:.0f} ms, p95 {measured.p95_ms:.0f} ms, limit {P95_LIMIT_MS:g}"
        f" ({measured.p95_ms / P95_LIMIT_MS:.2f})\n"
        f"server: {measured.cpu_percent:.1f} % of a core, limit {CPU_LIMIT_PERCENT:g}"
        f" ({measured.cpu_percent / CPU_LIMIT_PERCENT:.2f})\n"
        f"first picture: {measured.first_picture_s:.2f} s after the page was opened, limit {FIRST_LIMIT_S:g}"
        f" ({measured.first_picture_s / FIRST_LIMIT_S:.2f})"
    )
    kept = measured.p95_ms <= P95_LIMIT_MS and measured.cpu_percent <= CPU_LIMIT_PERCENT
    return 0 if kept and measured.first_picture_s <= FIRST_LIMIT_S else 1


def _measured(folder: Path) -> Measured:
    from playwright.sync_api import sync_playwright

    fleet_file = folder / "fleet.yaml"
    load = ("tests.bench.monitor_load", "--vehicles", str(VEHICLES), "--rate", str(RATE_HZ), "--port", str(LOAD_PORT))
    show = ("companion", "monitor", "--connect", f"tcp/127.0.0.1:{LOAD_PORT}", "--fleet-file", str(fleet_file))
    with _running(*load, "--write-fleet", str(fleet_file)) as (loading, _):
        _first_line(loading)
        with _running(*show, "--listen", f"127.0.0.1:{PAGE_PORT}") as (output, server_id), sync_playwright() as tool:
            url = _url(output)
            browser = tool.chromium.launch(executable_path=str(CHROMIUM), args=ARGUMENTS)
            page = browser.new_page(viewport={"width": WIDTH_PX, "height": HEIGHT_PX})
            page.goto(url)
            while not page.evaluate("globalThis.companionMetrics?.count"):  # the page forbids to wait by eval
                time.sleep(0.05)
            first_s = page.evaluate("companionMetrics.firstPaintMs") / 1000.0
            time.sleep(SETTLE_S)
            measured = _steady(page, server_id, first_s)
            browser.close()
    return measured


def _steady(page: Page, server_id: int, first_s: float) -> Measured:
    page.evaluate("companionMetrics.restart()")
    cpu_s, began_s = _cpu_s(server_id), time.monotonic()
    time.sleep(MEASURE_S)
    cpu_percent = 100.0 * (_cpu_s(server_id) - cpu_s) / (time.monotonic() - began_s)
    p50, p95, count = page.evaluate("[companionMetrics.p50_ms, companionMetrics.p95_ms, companionMetrics.count]")
    return Measured(p50, p95, count, first_s, cpu_percent)


@contextmanager
def _running(*module: str) -> Iterator[tuple[IO[str], int]]:
    """Standard output and process id of `python -m MODULE ...`."""
    with subprocess.Popen([sys.executable, "-m", *module], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout, process.pid
        finally:
            process.terminate()


def _first_line(output: IO[str]) -> str:
    if not (line := output.readline()):
        raise SystemExit("a program ended before it was ready; see above")
    return line


def _url(output: IO[str]) -> str:
    while not (found := URL.search(_first_line(output))):
        pass
    return found[0]


def _cpu_s(process_id: int) -> float:
    """Processor time of a process with all its threads."""
    fields = Path(f"/proc/{process_id}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    sys.exit(main())
