"""`companion export`: the command line of the export of recordings."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.cli.options import fail

NAME = "export"
SUMMARY = "writes recorded flights as CSV files"
EXIT_DONE, EXIT_UNUSABLE, EXIT_INTERRUPTED = 0, 2, 130
DESCRIPTION = """\
Write the decisions (50 a second) and the statuses (5 a second, and those with an event) of recorded
flights as CSV files: vehicle-N_decision.csv and vehicle-N_status.csv for each vehicle, one row for
each record.
"""

MORE = """\
examples:
  companion export flights/2026-05-03
  companion export flights/2026-05-03 --out tables

FOLDER is searched for files *.mcap, also in folders inside; a single file is possible. Columns are
named after the fields of the recording, with units: position_east_m, late_us. Neighbours with
their weights and ages, and flags, are lists with spaces. A cell without a value is empty; so are
position, velocity and their age before the vehicle has a position.

The name of a file ends in .part until it is complete. After Ctrl-C or a full disk an incomplete
file is removed, and an older one of its name stays.

time_s is in seconds since the first record of the flight, unix_s the same as Unix time by the
clock of the first vehicle. The clocks of the vehicles are compared by the packets that they
received from each other, to some milliseconds; a vehicle for which that is not possible has the
time of its own clock, and a line on standard error says so.

exit codes:
  0    written; the files are listed
  2    the folder has no recording that can be used, or a file cannot be written
  130  ended by Ctrl-C; the listed files are complete
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="the folder with the recordings of a flight")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the CSV files, created if missing (default: FOLDER/csv)"
    )


def run(options: argparse.Namespace) -> int:
    """The exit code."""
    from companion.tools.export import ExportError, export

    folder: Path = options.folder
    beside = folder.parent if folder.is_file() else folder
    try:
        for written in export(folder, options.out or beside / "csv"):
            print(f"{written.path}: {written.rows} rows", flush=True)
    except ExportError as error:
        return fail(str(error), EXIT_UNUSABLE)
    except KeyboardInterrupt:
        return fail("interrupted", EXIT_INTERRUPTED)
    return EXIT_DONE
