"""`companion report`: the command line of the report on a flight."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.cli.options import fail

NAME = "report"
SUMMARY = "writes a page about a recorded flight, with figures and findings"
EXIT_UNUSABLE = 2
DESCRIPTION = """\
Write one HTML page about a flight from the recordings of its vehicles: what deserves attention and
what to do about it, tracks, distances, errors, the law, the leader, timing, health, commands and
their answers. The page needs no network and prints on A4.
"""

MORE = """\
examples:
  companion report flights/2026-11-23
  companion report flights/2026-11-23 --out report.html
  companion report flights/2026-11-23 --log vehicle-1_log-7.ulg vehicle-2_log-9.bin
  companion report flights/2026-11-23 --json | jq '.findings[] | {code, vehicle_id, time_s, text}'

FOLDER has the recordings (*.mcap) of all vehicles, in any folders inside it; copy them together.
Their clocks need not agree: the packets between the vehicles align them. Logs of the autopilots
(*.ulg of PX4, *.bin of ArduPilot; companion logs downloads them) are found in it, too; their
battery voltage, vibration, GPS quality, estimate and messages are shown beside. A log belongs to
the vehicle of its name (vehicle-ID_...), else to the one that moved as the log says.

Findings carry a code (companion explain CODE) and a severity: critical ones must be understood
before the next flight. All records are judged, also where figures show fewer points.

exit codes:
  0    written, without critical findings
  1    written, with critical findings
  2    nothing was written: a folder, a file or an argument cannot be used
  130  ended by Ctrl-C
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder with the recordings of one flight")
    parser.add_argument("--out", type=Path, metavar="FILE", help="the page (default: report.html in FOLDER)")
    parser.add_argument(
        "--log",
        type=Path,
        nargs="+",
        action="extend",
        default=[],
        metavar="FILE",
        help="logs of autopilots outside of FOLDER: ULog (.ulg) or DataFlash (.bin)",
    )
    parser.add_argument("--json", action="store_true", help="also print figures and findings as one JSON object")


def run(options: argparse.Namespace) -> int:
    """The exit code."""
    from companion import GROUND_INSTALL

    try:
        from companion.report.command import ReportError, ReportOptions, run_report
    except ImportError as error:
        return fail(f"companion report: {error.name} is not installed; {GROUND_INSTALL}", EXIT_UNUSABLE)
    try:
        return run_report(ReportOptions(options.folder, options.out, tuple(options.log), options.json))
    except ReportError as error:
        return fail(f"companion report: {error}", EXIT_UNUSABLE)
